"""Chooses the scene of a simulated flight: the given one, or one that shows what the user asks for."""

from __future__ import annotations

import re
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cognitivedrone.apps.config import AUTO, FlyPlan
from cognitivedrone.apps.understanding.evidence import Evidence, not_understood
from cognitivedrone.apps.understanding.lexicon import spoken
from cognitivedrone.apps.understanding.request import Request, Understanding
from cognitivedrone.apps.understanding.sentence import placed
from cognitivedrone.errors import NotUnderstood
from cognitivedrone.labels import FolderPack, load_pack
from cognitivedrone.models.words.refusals import normalised
from cognitivedrone.tasks import Suite, track_at, vocabulary
from cognitivedrone.tasks.directives import HOLD
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.families.human import cast_portrait, person_lacking, person_with, touched_parts
from cognitivedrone.tasks.families.mission_tasks import landing_task
from cognitivedrone.tasks.families.symbols import RIVALS, distinct_animals
from cognitivedrone.tasks.generate import Draw, Panel, Puzzle
from cognitivedrone.tasks.matching import Match, best_scene
from cognitivedrone.tasks.missions import asked_of, is_mission, lands, shuts, sub_goals, things_of, told, way
from cognitivedrone.tasks.people import TRAIN_CAST
from cognitivedrone.tasks.suites import drawn_task, suite_of, suite_of_tasks, suite_of_tracks
from cognitivedrone.types import COLORS, Gate, SubGoal, Task, Track

DEFAULT = "open-v1:smoke"
DEFAULT_EPISODE = 27
"""Flown where nothing is asked for; unlike the first one, the packaged pilot is sure of it."""
MADE = "a scene made for this flight"
_FAMILY_OF = {"letter": "letters", "number": "digits", "logo": "logos", "animal": "animals", "person": "attributes"}
_DRAWS = 2000
"""Maximum number of scenes that are drawn for one whose gates look and stand as asked."""


@dataclass(frozen=True, slots=True)
class ChosenScene:
    """An episode of a suite."""

    suite: Suite
    episode: int
    summary: str
    """Description and reason of the choice, one line for the user."""
    made: bool = False
    """For the user's sentence, of which its tasks' instructions are parts."""

    @property
    def track(self) -> Track:
        """Its tasks; raises `TaskError` if there is no such episode."""
        return track_at(self.suite, self.episode)


def choose_scene(plan: FlyPlan, evidence: Evidence | None = None) -> ChosenScene:
    """The scene of a simulated flight: the seed decides, and nothing that a pilot reads.

    With --episode, that episode. Otherwise, for an instruction of the user's own, a scene that shows what it asks for:
    from the given suite or task file, or else made for it. Otherwise the first episode of the given suite or task file,
    a scene of the given folder of pictures, or `DEFAULT_EPISODE`. Raises `TaskError`, and `NotUnderstood` for an
    instruction that names nothing that there is.
    """
    scenario, seed = plan.scenario, plan.scenario.seed
    named = scenario.suite != AUTO or scenario.tasks is not None
    asked = plan.instruction.strip()
    own = own_names(scenario.labels)
    if named or plan.episode is not None or not (asked or own):
        first = 0 if named or asked else DEFAULT_EPISODE
        episode = first if plan.episode is None else plan.episode
        suite = suite_of(scenario if named else scenario.changed(suite=DEFAULT), episode + 1)
        if not asked or plan.episode is not None:
            return named_scene(suite, episode)
        found = best_scene(asked, [track[0] for track in suite.tracks], seed)
        if found is None:
            raise NotUnderstood(f"no scene of {suite.name} shows what {asked!r} asks for; name one with --episode")
        return replace(named_scene(suite, found[0]), summary=_why(found[1], named_scene(suite, found[0])))
    evidence = evidence or Evidence(Understanding(own))
    if asked and is_mission(goals := sub_goals(asked)):
        return _mission_scene(asked, goals, evidence, seed, own)
    request = evidence.request(asked) if asked else Request("", min(own.values(), key=min))
    if not request.understood:
        raise NotUnderstood(not_understood(request, evidence.understanding))
    task = made_task(request, (seed, 0), frozenset().union(*own.values()))
    scene = named_scene(suite_of_tasks(MADE, [task]), 0)
    return replace(scene, summary=f"{scene.summary}; it is to show {_meant(request, task)}", made=True)


def _mission_scene(
    asked: str,
    goals: Sequence[SubGoal],
    evidence: Evidence,
    seed: int,
    own: Mapping[str, frozenset[str]],
) -> ChosenScene:
    """A track with a stage for every sub-goal of a mission; a landing without a pad has none."""
    rng = np.random.default_rng([seed, 0, 5])
    tasks: list[Task] = []
    summary = list[str]()
    left = tuple(goals)
    while left:
        goal, number = left[0], len(summary)
        requests = {said: evidence.request(said) for said in asked_of(goal)}
        for request in requests.values():
            if not request.understood:
                raise NotUnderstood(f"of sub-goal {number + 1}, {not_understood(request, evidence.understanding)}")
        seen, hidden = _shown_way(goal, requests)
        first, left = way(left, seen)
        plain = first.kind == "fly" and goal is first and not goal.avoid
        if first.kind == "fly" or hidden:
            task = _stage(goal, first, requests, hidden, (seed, number), frozenset().union(*own.values()))
            tasks.append(replace(task, mission=asked))
        summary.append(_meant(requests[goal.instruction], tasks[-1]) if plain else told(goal))
        if first.kind == "land" and (pad := lands(first.instruction)[1]):
            task = landing_task(pad, int(rng.integers(3)), COLORS, f"made/{seed}-pad")
            tasks.append(replace(task, mission=asked))
    if not tasks:
        raise NotUnderstood(f"{asked!r} names no gate to fly through and no pad; say what to fly to first")
    suite = suite_of_tracks(MADE, [tuple(tasks)])
    steps = "; ".join(f"{number}. {each}" for number, each in enumerate(summary, 1))
    return replace(named_scene(suite, 0), summary=f"mission: {steps}", made=True)


def _shown_way(goal: SubGoal, requests: Mapping[str, Request]) -> tuple[tuple[bool, ...], frozenset[str]]:
    """The way through a choice in the scene that is made for it, and labels that are not shown there.

    What is to be flown to if it is there is shown. What else is to be there is not.
    """
    seen, hidden = list[bool](), frozenset[str]()
    while goal.kind == "if":
        there = goal.then[0].instruction == goal.instruction
        seen.append(there)
        hidden |= frozenset() if there else requests[goal.instruction].labels
        goal = (goal.then if there else goal.otherwise)[0]
    return tuple(seen), hidden


def _stage(
    goal: SubGoal,
    first: SubGoal,
    requests: Mapping[str, Request],
    hidden: frozenset[str],
    seed: tuple[int, int],
    own: frozenset[str],
) -> Task:
    """A stage for what is done first of a sub-goal, which shows nothing of `hidden`; to look at, before a landing."""
    look = first.kind == "land"
    others = frozenset(f"{kind}/{name}" for name, kind in KIND_OF.items()) - hidden
    request = Request("", others, others) if look else requests[first.instruction]
    never = frozenset[str]().union(*(requests[thing].labels for thing in things_of(first.avoid)))
    for again in range(_DRAWS):
        task = made_task(request, (seed[0], 100 * seed[1] + 10_000 * again), own)
        gate, shown = task.gates[task.target or 0], [label.partition("@")[0] for label in task.labels]
        wrong = shuts(first.avoid, (gate.color, gate.shape, gate.size)) or shown[task.target or 0] in never
        if hidden.isdisjoint(shown) and (look or not wrong):
            break
    else:
        raise NotUnderstood(f"of sub-goal {seed[1] + 1}, all that fits is forbidden; leave out one of the two")
    if look:
        return replace(task, instruction=goal.instruction, directive=HOLD, target=None, family="absent")
    return replace(task, instruction=first.instruction)


def plain_instruction(evidence: Evidence, scene: ChosenScene | None, sentence: str) -> str | None:
    """The instruction of the pilot for the user's sentence; none where that says nothing to it.

    It is the sentence word for word, in every scene and on every vehicle. Only where its words are no English, or mean
    no thing to the pilot (a typing error, a foreign name) and are known here, it is told in English what they name; as
    is a gate's number ("gate 3", "the third gate"), which the program gives it.
    """
    if scene is not None and scene.made and not sentence:
        sentence = scene.track[0].instruction
    own = _own_sentences(scene) if scene is not None and not scene.made else ()
    if not sentence or lands(sentence)[0] or sentence in own:
        return sentence
    if evidence.problem(sentence):
        return None
    request = evidence.understanding.understand(sentence)
    numbered = request.place is not None and not request.labels and placed(normalised(sentence)) != normalised(sentence)
    if not request.understood or (not numbered and evidence.as_typed(sentence) and not evidence.unclear(request)):
        return sentence
    return sentence if len(request.labels) > 1 and not request.plain else f"Fly through {_meant(request)}"


def check_evidence(evidence: Evidence, scene: ChosenScene | None, instruction: str) -> None:
    """Raise `NotUnderstood` if what is to be flown says nothing to the pilot: a person's words, or else the tasks'."""
    if scene is not None and not scene.made and (not instruction or instruction in _own_sentences(scene)):
        problem = next(filter(None, map(evidence.problem_of_task, _own_sentences(scene))), "")
    elif scene is not None and scene.made:  # it was made from what was understood
        problem = ""
    else:
        goals = sub_goals(instruction)
        flown = [said for goal in goals for said in asked_of(goal)] if is_mission(goals) else [instruction]
        problem = next(filter(None, map(evidence.problem, flown)), "")
    if problem:
        raise NotUnderstood(problem)


def _own_sentences(scene: ChosenScene) -> tuple[str, ...]:
    """What the tasks of a scene ask for."""
    found = (said for task in scene.track for said in (task.instruction, task.directive, task.mission or ""))
    return tuple(dict.fromkeys(filter(None, found)))


def own_names(labels: str | Path | None) -> Mapping[str, frozenset[str]]:
    """The concepts of a folder of pictures as one says them, with the labels of their pictures; empty for a pack."""
    found: dict[str, set[str]] = {}
    pack = load_pack(labels) if labels and Path(labels).is_dir() else None
    for kind, concept, style in pack.files() if isinstance(pack, FolderPack) else ():
        name = re.sub(r"[\s_-]+", " ", concept.rpartition("/")[2].removesuffix(".dae")).strip()
        name = re.sub(r"(?<=[^\W\d]) ?\d+$", "", name)
        found.setdefault(name, set()).add(f"{kind}/{concept}" + (f"@{style}" if style else ""))
    return {name: frozenset(pictures) for name, pictures in found.items()}


def made_task(request: Request, seed: tuple[int, int], own: Collection[str] = frozenset()) -> Task:
    """A task for a request that was understood; `own` are the labels of the user's pictures.

    Another sentence gets another scene by the same seed.
    """
    rng = np.random.default_rng([*seed, zlib.crc32(request.sentence.encode())])
    kind = (
        "person"
        if request.features or request.lacks or request.name
        else min(request.labels or {"animal/"}).partition("/")[0]
    )
    for number in range(_DRAWS):
        task = drawn_task(
            _FAMILY_OF.get(kind, "association"),
            rng,
            f"made/{seed[0]}-{seed[1]}-{number}",
            make=lambda draw: _puzzle(draw, request, own),
        )
        if _fits(request, task.gates, task.target or 0):
            break
    return replace(task, instruction=request.sentence or task.instruction)


def _fits(request: Request, gates: tuple[Gate, Gate, Gate], target: int) -> bool:
    """Whether the right gate, and no other, looks and stands as asked."""
    looks = [frozenset((gate.size, gate.color, gate.shape)) for gate in gates]
    asked = frozenset(filter(None, request.look))
    fits = [asked <= look for look in looks]
    return (
        fits[target]
        and (not asked or sum(fits) == 1)
        and not looks[target] & request.refused_looks
        and request.place in (None, target)
    )


def _puzzle(draw: Draw, request: Request, own: Collection[str]) -> Puzzle:
    """Three panels, one of which is right."""
    if request.features or request.lacks:
        return _people(draw, request)
    if request.name:
        others = draw.sample([name for name in TRAIN_CAST if name != request.name], 2)
        return draw.puzzle("", cast_portrait(draw, request.name), [cast_portrait(draw, name) for name in others])
    if not request.labels and request.refused:  # anything but that: two panels show it
        label = min(request.refused)
        others = [other for other in _alike(label, own) if other not in request.refused]
        if not others:  # a whole kind is refused
            others = [
                other
                for other in sorted(f"{of}/{name}" for name, of in KIND_OF.items())
                if other not in request.refused
            ]
        right = draw.pick(others)
        return draw.puzzle("", _panel(draw, right, own), [_panel(draw, label, own), _panel(draw, label, own)])
    if not request.labels:
        first, *others = distinct_animals(draw, 3)
        return draw.puzzle("", draw.drawing("animal", first), [draw.drawing("animal", name) for name in others])
    right = draw.pick(sorted(request.labels))
    there = [label for label in _alike(right, own) if label not in request.labels | _rivals(right)]
    clear = [label for label in there if label in request.wrong] if request.wrong else there
    wrong = [label for label in sorted(request.refused) if label not in request.labels][:2]
    pool = [label for label in (clear if len(clear) > 1 else sorted(request.wrong) or there) if label not in wrong]
    if not pool:  # a folder of one concept, or any letter or number
        pool = [f"letter/{letter}" for letter in vocabulary.LETTERS if f"letter/{letter}" not in request.labels]
        pool = pool or _alike("number/0", own)
    wrong += draw.sample(pool if len(pool) > 1 else pool * 2, 2 - len(wrong))
    return draw.puzzle("", _panel(draw, right, own), [_panel(draw, label, own) for label in wrong])


def _people(draw: Draw, request: Request) -> Puzzle:
    """People, of whom one has the features; of those that exclude each other, the first."""
    features = list(request.features[:1])
    for feature in request.features[1:]:
        if not any(touched_parts(feature) & touched_parts(other) for other in features):
            features.append(feature)
    if request.lacks:
        lacking = request.lacks[0]
        wrong = [draw.portrait(person_with(draw, [lacking])) for _ in range(2)]
        right = draw.portrait(person_lacking(draw, features, lacking))
    else:
        wrong = [draw.portrait(person_lacking(draw, features, draw.pick(features))) for _ in range(2)]
        right = draw.portrait(person_with(draw, features))
    return draw.puzzle("", right, wrong)


def _alike(label: str, own: Collection[str]) -> list[str]:
    """Labels of the same kind, sorted; of the user's pictures, all if there are few of a kind."""
    kind = label.partition("/")[0]
    if label in own:
        same = sorted(other for other in own if other.partition("/")[0] == kind)
        return same if len(same) > 3 else sorted(own)
    concepts = {"letter": vocabulary.LETTERS, "number": tuple(map(str, range(21))), "logo": vocabulary.LOGOS}
    return [f"{kind}/{name}" for name in concepts.get(kind, sorted(name for name, of in KIND_OF.items() if of == kind))]


def _rivals(label: str) -> frozenset[str]:
    kind, _, name = label.partition("/")
    return frozenset(f"{kind}/{other}" for other in {name, *RIVALS.get(name, ())})


def _panel(draw: Draw, label: str, own: Collection[str]) -> Panel:
    kind, _, name = label.partition("/")
    if label in own:
        return Panel(name.partition("@")[0], label)
    if kind == "logo":
        return Panel(name, f"{label}@{vocabulary.LOGO_STYLE}")
    return draw.glyph(kind, name) if kind in ("letter", "number") else draw.drawing(kind, name)


def _meant(request: Request, task: Task | None = None) -> str:
    """What is asked for, in plain words that a pilot knows; of several things, what is right in the task."""
    target = 0 if task is None or task.target is None else task.target
    label = "" if task is None else task.labels[target]
    if request.plain and not request.labels:
        return f"the gate with {request.plain}"
    if not request.labels and request.refused:
        return f"the gate that does not show {_noun(min(request.refused))}"
    if request.labels or request.plain:
        return f"the gate with {request.plain or _noun(label)}"
    place = "" if request.place is None else ("left ", "middle ", "right ")[request.place]
    if place or any(request.look) or not request.refused_looks:
        return f"the {place}{''.join(f'{word} ' for word in request.look if word)}gate"
    if task is not None:
        return f"the {task.gates[target].color} gate"
    refused = sorted(request.refused_looks)
    return f"the gate that is {'not' if len(refused) == 1 else 'neither'} {' nor '.join(refused)}"


def _noun(label: str) -> str:
    """A label as one says it."""
    return f"the {spoken(label)}"


def _why(match: Match, scene: ChosenScene) -> str:
    """The description of a scene with the reason for its choice."""
    task = scene.track[0]
    fit = f"{' and '.join(map(repr, match.words))} {'fits' if len(match.words) == 1 else 'fit'} gate {match.gate + 1}"
    if match.shown:
        fit = f"{fit}, {_shown(task.options[match.gate], task.labels[match.gate])}"
    if match.missing:
        fit = f"{fit}, though {' and '.join(map(repr, match.missing))} {'do' if len(match.missing) > 1 else 'does'} not"
    return f"{scene.summary}; chosen because {fit}"


def named_scene(suite: Suite, episode: int) -> ChosenScene:
    """An episode of a suite, described by what its panels show. Raises `TaskError` if there is none."""
    track = track_at(suite, episode)
    shown = "; then ".join(map(_panels, track))
    where = MADE if suite.name == MADE else f"episode {episode} of {suite.name}"
    return ChosenScene(suite, episode, f"scene: {where}, with {shown}")


def _panels(task: Task) -> str:
    """What the panels of a task show, left to right."""
    if task.landing:
        return "pads"
    if task.only is not None:
        return "one gate"
    panels = enumerate(zip(task.options, task.labels, strict=True))
    names = [_shown(*panel) for index, panel in panels if index != task.missing]
    if len(set(names)) == 1:
        return f"{names[0]} at every gate"
    return f"{', '.join(names[:-1])} and {names[-1]} from left to right"


def _shown(option: str, label: str) -> str:
    if label.startswith("person/") and "=" in option:
        return "a person"
    return option.removesuffix(".dae").replace("_", " ")
