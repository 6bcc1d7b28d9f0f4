"""Tables of what comes with the package: suites, task families, airframes, places, policies, reasoners."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from cognitivedrone.errors import PolicyError, RenderError
from cognitivedrone.policies import POLICIES
from cognitivedrone.reasoners import NONE, REASONERS
from cognitivedrone.registry import load, usage
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.sim.drawing import renderers
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.tasks import ABOUT, FAMILIES, SUITES, load_suite
from cognitivedrone.text.printable import visible
from cognitivedrone.world import places


def catalogue() -> RenderableType:
    """The names that other commands take: lists that stay readable from 60 columns on."""
    sections = [_section("Suites (--suite)", map(_suite, SUITES))]
    families: dict[str, list[str]] = {}
    for family, category in FAMILIES.items():
        families.setdefault(category, []).append(family)
    sections += [
        _section("Task families, by category", (_entry(name, ", ".join(all_)) for name, all_ in families.items())),
        _section("Policies (--policy NAME:VALUE,option=value)", _plugins("policy", POLICIES)),
        _section(
            "Reasoners (--reasoner NAME:VALUE,option=value)",
            [*_plugins("reasoner", REASONERS), _entry(NONE, "No reasoner: the policy gets the raw instruction.")],
        ),
        _section(
            "Policies and reasoners of your own",
            [
                _entry("MODULE:ATTRIBUTE", "A class or function of your own; its folder is on PYTHONPATH."),
                _entry("MODULE:ATTRIBUTE:VALUE,option=value", "The same with arguments."),
            ],
        ),
    ]
    shown = {"training": "Models are trained in these.", "kept": "No model is trained in these."}
    sections.append(
        _section(
            "Places (--place)", (_entry(name, about, ", ".join(places.names(name))) for name, about in shown.items())
        )
    )
    return Group(*sections, f"Airframes (--airframe): {', '.join(AIRFRAMES)}", "", _renderer())


def _renderer() -> str:
    """What draws here, and why."""
    try:
        name = renderer_name()
        return visible(f"Renderer ({renderers.CHOICE}=cpu|gpu): {name} ({renderers.why(name)})")
    except RenderError as error:
        return f"Renderer: none. {error}"


def _section(title: str, entries: Iterable[RenderableType]) -> RenderableType:
    return Group(Text(title, "underline"), *(Padding(entry, (0, 0, 0, 2), expand=False) for entry in entries), "")


def _suite(name: str) -> RenderableType:
    suite = load_suite(name)
    n_tasks, n_tracks = suite.n_tasks, len(suite.tracks)
    size = f"{n_tasks} tasks"
    if name.endswith(":train"):
        size = "unlimited tasks"
    elif n_tracks != n_tasks:
        size += f" in {n_tracks} episodes"
    return _entry(f"{name:<17} {size}, hash {suite.digest[:12]}", ABOUT[name])


def _plugins(kind: str, table: Mapping[str, str]) -> Iterator[RenderableType]:
    """Every plug-in with its argument, in brackets if it is optional, what it does, and its options."""
    for name in table:
        try:
            factory = load(kind, name, table)
        except PolicyError as error:
            yield _entry(name, str(error))
            continue
        written = usage(name, factory)
        about = [" ".join((inspect.getdoc(factory) or "").partition("\n\n")[0].split())]
        if options := _OPTION.findall(written):
            about.append(f"options: {', '.join(options)}")
        yield _entry(_OPTION.sub("", written), *about)


_OPTION = re.compile(r"\[,(\w+=[^\]]+)\]")


def _entry(written: str, *about: str) -> RenderableType:
    lines = (Padding(Text(line, overflow="fold"), (0, 0, 0, 4), expand=False) for line in about)
    return Group(Text(written, "bold", overflow="fold"), *lines)
