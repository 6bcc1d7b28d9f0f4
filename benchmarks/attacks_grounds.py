"""Attacks by parameter files, serial ports, tables of facts and label folders, and in `sweep`, `audit` and `submit`.

Each has an end that is expected: refused in one sentence, or taken, where it is odd but harmless.
"""

from __future__ import annotations

import io
import json
import os
import pty
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from attack_tools import MARK, PROJECT, SMOKE, Attack, command, each, refused_in, taken, told, why_not_refused
from attacks_files import MARKUP, SPECIAL, flown
from PIL import Image

from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.text.printable import unprintable

_LINK = "../secret.txt"
Try = Callable[[Path], object]


def attacks() -> list[Attack]:
    """All of them."""
    return [
        *each("parameter files", dict(_parameter_files())),
        *each("serial ports", dict(_serial_ports())),
        *each("tables of facts", dict(_facts())),
        *each("label folders", dict(_labels())),
        *each("sweep and audit", dict(_sweeps())),
        *each("submit", dict(_submit())),
    ]


# Parameter files -----------------------------------------------------------------------------------------------------


def _parameter_files() -> Iterator[tuple[str, Callable[[Path], str]]]:
    from cognitivedrone.vehicles.sitl.arducopter import ArduCopter

    def started(*defaults: str, program: str = "cat") -> Try:
        def act(folder: Path) -> object:
            binary = folder / "copter"
            binary.write_text(f'#!/bin/sh\n[ "$#" -eq 8 ] || touch {MARK}\nexec {program}\n')
            binary.chmod(0o755)
            with ArduCopter(binary, folder, defaults=[folder / name for name in defaults]) as copter:
                return copter.url

        return act

    def made(make: Callable[[Path], object], name: str, act: Try) -> Try:
        def run(folder: Path) -> object:
            make(folder / name)
            return act(folder)

        return run

    for name, make in SPECIAL.items():
        yield f"defaults: {name}", told(made(make, "x.parm", started("x.parm")))
    yield "defaults: nothing there", told(started("none.parm"))
    yield (
        "defaults: a comma adds a file",
        told(made(Path.touch, f"a,{_LINK.replace('/', '_')}", started("a,.._secret.txt"))),
    )
    yield "defaults: an option as a name", taken(made(Path.touch, "--help", started("--help")))
    yield "defaults: a blank", taken(made(Path.touch, "my drone.parm", started("my drone.parm")))
    yield (
        "defaults: a name with a command",
        taken(made(Path.touch, f"$(touch {MARK}).parm", started(f"$(touch {MARK}).parm"))),
    )
    yield "binary: a text that is no program", told(_not_a_program)


def _not_a_program(folder: Path) -> object:
    from cognitivedrone.vehicles.sitl.arducopter import ArduCopter

    binary = folder / "copter"
    binary.write_bytes(b"\x00\x01\x02")
    binary.chmod(0o755)
    with ArduCopter(binary, folder) as copter:
        for _ in range(100):
            copter.check()
            time.sleep(0.05)
    return "it runs"


# Serial ports --------------------------------------------------------------------------------------------------------


def _serial_ports() -> Iterator[tuple[str, Callable[[Path], str]]]:
    from cognitivedrone.vehicles.mavlink.client.link.transport import open_transport

    urls = {
        "a file": "serial:{folder}/file", "a folder": "serial:{folder}", "a pipe": "serial:{folder}/pipe",
        "zeros": "serial:/dev/zero", "nothing": "serial:/dev/null", "not there": "serial:{folder}/none",
        "a link to itself": "serial:{folder}/loop", "NUL in its name": "serial:/dev/tty\0S0",
        "no name": "serial:", "only a baud rate": "serial::57600", "baud rate below 0": "serial:/dev/null:-1",
        "baud rate of 5,000 digits": f"serial:/dev/null:{'9' * 5000}", "baud rate in Arabic": "serial:/dev/null:٥٧٦٠٠",
        "baud rate 10^8": "serial:/dev/null:99999999", "port of 5,000 digits": f"udp:127.0.0.1:{'1' * 5000}",
        "an escape in its name": "serial:/dev/\x1b[2J",
    }  # fmt: skip
    for name, url in urls.items():

        def act(folder: Path, url: str = url) -> object:
            (folder / "file").touch()
            os.mkfifo(folder / "pipe")
            (folder / "loop").symlink_to("loop")
            return open_transport(url.replace("{folder}", str(folder)))

        yield f"serial port: {name}", _spoken(act)
    yield "serial port: garbage from it", taken(_garbage)
    yield "serial port: it vanishes", told(_vanished)


def _spoken(act: Try) -> Callable[[Path], str]:
    """As `_told`; a path of the user's own may have any characters until it is printed."""

    def run(folder: Path) -> str:
        try:
            found = act(folder)
        except CognitiveDroneError:
            return ""
        return f"it was taken: {found!r:.99}"

    return run


def _garbage(_folder: Path) -> object:
    from cognitivedrone.vehicles.mavlink.client.link.transport import open_transport

    ours, theirs = pty.openpty()
    link = open_transport(f"serial:{os.ttyname(theirs)}:57600")
    os.write(ours, bytes(range(256)) * 4)
    data, _ = link.read(1.0)
    link.close()
    os.close(ours)
    os.close(theirs)
    return len(data)


def _vanished(_folder: Path) -> object:
    from cognitivedrone.vehicles.mavlink.client.link.transport import open_transport

    ours, theirs = pty.openpty()
    link = open_transport(f"serial:{os.ttyname(theirs)}:57600")
    os.close(theirs)
    os.close(ours)
    for _ in range(3):
        link.read(0.1)
        link.write(b"x")
    return "nothing was noticed"


# Tables of facts, label folders --------------------------------------------------------------------------------------


def _pictures(folder: Path, *names: str) -> Path:
    for name in names or ("birds/robin", "birds/wren", "birds/tit"):
        path = folder / "labels" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (32, 32), (len(name) * 20 % 256, 90, 60)).save(path)
    return folder / "labels"


def _lesson(folder: Path) -> object:
    from cognitivedrone.training.teach.lesson import read_lesson

    return read_lesson(folder / "labels")


def _facts() -> Iterator[tuple[str, Callable[[Path], str]]]:
    refused: dict[str, bytes] = {
        "empty": b"", "no column concept": b"name,size\nrobin,small\n",
        "a column without a name": b"concept,\nrobin,x\n",
        "a column twice": b"concept,size,size\nrobin,a,b\n", "an unknown concept": b"concept,size\nemu,big\n",
        "a concept twice": b"concept,size\nrobin,a\nrobin,b\n", "no rows": b"concept,size\n",
        "a quote left open": b'concept,size\n"robin,small\n', "NUL": b"concept,size\nrobin,a\0b\n",
        "an escape": b"concept,size\nrobin,\x1b[2J\n",
        "a name of direction": "concept,size\nrobin,\u202etxt\n".encode(),
        "a reserved column": b"concept,property\nrobin,x\n", "a cell of 1 MB": b"concept,size\nrobin," + b"x" * 10**6,
        "10,000 columns": b"concept" + b"".join(b",c%d" % n for n in range(10_000)) + b"\n",
        "a million rows": b"concept,size\n" + b"robin,x\n" * 10**6, "no text": bytes(range(128, 256)),
    }  # fmt: skip
    harmless = {
        "a format string": b"concept,{0.__class__},colour\nrobin,{x.__init__.__globals__},brown\nwren,{y},brown\n",
        "a formula": b'concept,remark\nrobin,=cmd|"/C calc"!A0\nwren,+1\ntit,@SUM(1)\n',
        "markup": f"concept,note\nrobin,{MARKUP[:30].replace(',', ' ')}\nwren,x\n".encode(),
        "a property that is a name of ours": b"concept,__class__\nrobin,os.system\nwren,x\n",
    }
    for end, contents in ((told, refused), (taken, harmless)):
        for name, content in contents.items():

            def act(folder: Path, content: bytes = content) -> object:
                (_pictures(folder) / "facts.csv").write_bytes(content)
                return _lesson(folder)

            yield f"facts.csv: {name}", end(act)
    for name, make in SPECIAL.items():

        def special(folder: Path, make: Callable[[Path], object] = make) -> object:
            make(_pictures(folder) / "facts.csv")
            return _lesson(folder)

        yield f"facts.csv: {name}", told(special)


def _labels() -> Iterator[tuple[str, Callable[[Path], str]]]:
    def lesson_with(change: Callable[[Path], object]) -> Try:
        def act(folder: Path) -> object:
            change(_pictures(folder))
            return _lesson(folder)

        return act

    def bomb(labels: Path) -> None:
        whole = io.BytesIO()
        Image.new("1", (30_000, 30_000)).save(whole, "PNG")
        (labels / "birds" / "bomb.png").write_bytes(whole.getvalue())

    def deep(labels: Path) -> None:
        place = labels
        for _ in range(120):
            place = place / "birds"
        place.mkdir(parents=True)
        Image.new("RGB", (8, 8)).save(place / "kite.png")

    def out_of_it(labels: Path) -> None:
        (labels / "birds" / "secret.png").symlink_to(labels.parents[1] / "secret.txt")

    def cycle(labels: Path) -> None:
        (labels / "birds" / "again").symlink_to(labels, target_is_directory=True)

    def placeholder(labels: Path) -> None:
        Image.new("RGB", (8, 8)).save(labels / "birds" / "{0.__class__}.png")

    def long_name(labels: Path) -> None:
        Image.new("RGB", (8, 8)).save(labels / "birds" / f"{'x' * 200}.png")

    yield "pictures: a bomb of 900 million pixels", told(lesson_with(bomb))

    def owl(make: Callable[[Path], object]) -> Callable[[Path], object]:
        return lambda labels: make(labels / "birds" / "owl.png")

    for name, make in SPECIAL.items():
        yield (
            f"pictures: {name}",
            told(lesson_with(owl(make))),
        )
    yield "pictures: a link out of the folder", taken(lesson_with(out_of_it))
    yield "pictures: a folder within itself", taken(lesson_with(cycle))
    yield "pictures: 120 folders deep", taken(lesson_with(deep))
    yield "pictures: a name that is a format string", taken(lesson_with(placeholder))
    yield "pictures: a name of 200 letters", taken(lesson_with(long_name))
    yield "pictures: one concept alone", told(lambda folder: (_pictures(folder, "birds/emu"), _lesson(folder))[1])


# Folders of sweep and audit, submit ----------------------------------------------------------------------------------


def _sweeps() -> Iterator[tuple[str, Callable[[Path], str]]]:
    sweep = ("sweep", *SMOKE, "--policy", "hover", "--reasoner", "none", "--out", "out")
    for value in ("nan", "inf", "-1", "1e400", "x", "0x10", "1;ls"):
        yield f"sweep: a latency of {value}", refused_in(lambda _folder: None, *sweep, "--ms", value)
    yield "sweep: no latency", refused_in(lambda _folder: None, *sweep, "--ms")
    yield "sweep: other latency below 0", refused_in(lambda _folder: None, *sweep, "--ms", "0", "--other-ms", "-1")
    audit = ("audit", *SMOKE, "--policy", "hover", "--out", "out", "--only", "wind")
    places: dict[str, Callable[[Path], object]] = {
        "a file": Path.touch, "a pipe": os.mkfifo, "a device": lambda path: path.symlink_to("/dev/null"),
        "below a file": lambda path: path.symlink_to("/dev/null/x"),
        "a link to itself": lambda path: path.symlink_to(path.name),
    }  # fmt: skip
    for name, make in places.items():
        for words in ((*sweep, "--ms", "0"), audit):
            yield (
                f"{words[0]}: the folder is {name}",
                refused_in(lambda folder, make=make: make(folder / "out"), *words),
            )
    for name in ("../x", "wind\x1b[2J", "wind" * 5000, ""):
        yield f"audit: only {name[:8]!r}", refused_in(lambda _folder: None, *audit[:-1], name)

    def prepared(target: str) -> Callable[[Path], object]:
        def make(folder: Path) -> None:
            place = folder / "out" / target
            place.parent.mkdir(parents=True)
            place.symlink_to(folder.parent / "secret.txt")

        return make

    for words, targets in (
        ((*sweep, "--ms", "0"), ("sweep.svg", "reasoner-0ms/run.json", "reasoner-0ms/results.json")),
        (audit, ("audit.json", "audit.html", "baseline.json", "baseline/run.json")),
    ):
        for target in targets:
            yield f"{words[0]}: {target} is a link to another file", _survived(prepared(target), *words)


def _survived(make: Callable[[Path], object], *words: object) -> Callable[[Path], str]:
    """The command may refuse or go on; `traces` finds what it did to the other file."""

    def run(folder: Path) -> str:
        make(folder)
        ended = command(*words)
        return "" if ended.code == 0 else why_not_refused(ended)

    return run


def _submit() -> Iterator[tuple[str, Callable[[Path], str]]]:
    def words(*more: object) -> tuple[object, ...]:
        return ("submit", flown() / "results.json", *more)

    texts = {
        "markup": MARKUP,
        "an escape": "\x1b[2J",
        "a direction": "\u202etxt",
        "a line": "a\nb",
        "nothing": "",
        "10,000 letters": "x" * 10_000,
    }
    for name, text in texts.items():
        for option in ("--name", "--by"):
            other = ("--by", "b") if option == "--name" else ("--name", "a")
            end = _refused_or_safe(words(option, text, *other, "--out", "s.json"))
            yield f"submit {option}: {name}", end
    for name, make in SPECIAL.items():
        yield (
            f"submit --out: {name}",
            refused_in(
                lambda folder, make=make: make(folder / "s.json"), *words("--name", "a", "--by", "b", "--out", "s.json")
            ),
        )

    def linked(folder: Path) -> None:
        (folder / "s.json").symlink_to(folder.parent / "secret.txt")

    yield (
        "submit --out: a link to another file",
        _survived(linked, *words("--name", "a", "--by", "b", "--out", "s.json")),
    )
    yield (
        "submit --out: the results themselves",
        refused_in(
            lambda _folder: None, "submit", PROJECT / "pyproject.toml", "--name", "a", "--by", "b", "--out", "s.json"
        ),
    )


def _refused_or_safe(words: tuple[object, ...]) -> Callable[[Path], str]:
    """A text is refused, or written as data that prints as nothing else."""

    def run(folder: Path) -> str:
        ended = command(*words)
        if ended.code == 2:
            reason: str = why_not_refused(ended)
            return reason
        found: str | None = unprintable(ended.out.replace("\n", ""))
        if found:
            return f"{found} was printed"
        document = json.loads((folder / "s.json").read_text("utf-8"))
        return "" if isinstance(document, dict) else "no object was written"

    return run
