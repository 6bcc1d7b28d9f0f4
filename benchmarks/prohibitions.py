"""What a reasoner's probabilities say of what is forbidden, and of what is not there: the thresholds of `control`.

First frames of every stage, asked as in flight. Prints, for thresholds of each kind, how often each of the two mistakes
is made: `python benchmarks/prohibitions.py open-v3:missions open-v1:test`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np

from cognitivedrone.benchmark.reasoning.reason import views
from cognitivedrone.control.calls import begin_stage, seed_of
from cognitivedrone.envs.track_runner import TrackConfig, episode_rng, forbidden_gates
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.labels import load_pack
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.types import EpisodeContext, SeenPanel, Task

THRESHOLDS = (0.01, 0.02, 0.03, 0.05, 0.08, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4)


def first_frames(
    suite_name: str, reasoner: Reasoner, episodes: int
) -> Iterator[tuple[Task, Sequence[SeenPanel], bool]]:
    """Each stage's task, its panels as they were read, and whether the reasoner was unsure of the answer."""
    suite = load_suite(suite_name)
    with Worlds(1, load_pack(None), TrackConfig()) as worlds:
        for episode in range(min(episodes, len(suite.tracks))):
            rng = episode_rng(suite.digest, episode, 0)
            own = 0
            for view in views(worlds.runners[0], suite, episode, rng):
                own = own if view.index else seed_of(reasoner, rng)
                task = view.truth.task
                if task.landing or task.target is None:
                    continue
                begin_stage(reasoner, EpisodeContext(task.instruction, own, view.index, view.truth))
                unsure = False
                try:
                    reasoner.refine(view.look(), task.instruction)
                except ReasonerError:
                    unsure = True
                if len(reasoner.seen) == 3:
                    yield task, reasoner.seen, unsure


def main() -> None:
    """Print the shares of mistakes by threshold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("suites", nargs="+")
    parser.add_argument("--reasoner", default="small")
    parser.add_argument("--episodes", type=int, default=10_000)
    args = parser.parse_args()
    if (reasoner := make_reasoner(args.reasoner)) is None:
        parser.error("name a reasoner")
    rng = np.random.default_rng(0)
    shown, absent, second, none, true, wrong = (list[float]() for _ in range(6))
    for suite in args.suites:
        for task, seen, unsure in first_frames(suite, reasoner, args.episodes):
            read = {panel.color: {said.lower(): share for said, share in panel.readings} for panel in seen}
            there = [label.partition("@")[0].partition("/")[2].replace("_", " ") for label in task.labels]
            for gate, name in zip(task.gates, there, strict=True):
                if name.replace(" ", "_") in KIND_OF and gate.color in read:
                    shown.append(read[gate.color].get(name, 0.0))
            names = sorted(set(KIND_OF) - {name.replace(" ", "_") for name in there})
            for other in rng.choice(names, 10, replace=False):
                absent.append(max(shares.get(str(other).replace("_", " "), 0.0) for shares in read.values()))
            right = {panel.color: panel.right or 0.0 for panel in seen}
            target = task.gates[task.target or 0].color
            shut = {task.gates[number].color for number in forbidden_gates(task)}
            if shut and right and max(right, key=lambda color: right[color]) in shut:
                second.append(right.get(target, 0.0))
            elif not shut:
                none.append(max((share for color, share in right.items() if color != target), default=0.0))
            if unsure:
                true.append(right.get(target, 0.0))
                wrong += [share for color, share in right.items() if color != target]
    for what, low, high in (
        ("MAY_READ: shown but read with less / absent but read with more", shown, absent),
        ("FITS: fits but has less / does not fit but has more", second, none),
        ("MAY_SHOW, of unsure answers: shows but has less / does not but has more", true, wrong),
    ):
        print(f"{what} ({len(low)} / {len(high)})")
        for limit in THRESHOLDS:
            less, more = np.mean(np.array(low or [1.0]) <= limit), np.mean(np.array(high or [0.0]) > limit)
            print(f"  {limit:4.2f}  {less:6.1%}  {more:6.1%}")


if __name__ == "__main__":
    main()
