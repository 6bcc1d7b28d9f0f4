"""How often `fly` hovers rightly and wrongly: the same scenes with the instruction of each, and with that of another.

Run: python benchmarks/holding.py [--suite open-v1:test] [--episodes 100] [--below 0.5]
    [--out results/holding_test.json]

Flies the small policy with the small reasoner in simulated time, as `fly` does: with what is asked for in the scene it
should pass, and hovering is a mistake; with the instruction of a task whose panels are of other kinds it should hover,
and flying through any gate is one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.control.async_reasoner import SimulatedReasoner
from cognitivedrone.control.hold import HeldDrone, Hold, HoldAwareReasoner, HoldRule
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.envs.worlds import SimulatedDrone
from cognitivedrone.labels import load_pack
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite, load_suite
from cognitivedrone.types import Task

LIMIT_S = 15.0


@dataclass(frozen=True)
class Config:
    """What to fly."""

    suite: str = "open-v1:test"
    episodes: int = 100
    below: float = 0.5
    seed: int = 0
    policy: str = "small"
    reasoner: str = "small"
    out: Path | None = None
    """File for the figures."""


class Flights:
    """One drone that is flown through one stage after the other."""

    def __init__(self, suite: Suite, config: Config) -> None:
        self.suite, self.config = suite, config
        self.simulator = Simulator(1)
        self.track_runner = TrackRunner(
            self.simulator.world(0), load_pack("open-v1"), TrackConfig(time_limit_s=LIMIT_S)
        )
        self.drone = SimulatedDrone(self.track_runner)
        reasoner = make_reasoner(config.reasoner)
        if reasoner is None:
            raise SystemExit("nothing is doubted without a reasoner; name one, such as small")
        self.policy, self.reasoner = make_policy(config.policy), reasoner

    def fly(self, episode: int, words: str | None) -> str:
        """How an episode ends: the outcome of its worst stage, or `hovered`."""
        track_runner, hold = self.track_runner, Hold(HoldRule(below=self.config.below))
        track_runner.begin(self.suite.tracks[episode], episode_rng(self.suite.digest, episode, self.config.seed))
        async_reasoner = HoldAwareReasoner(SimulatedReasoner(self.reasoner), hold)

        def segment() -> Segment | None:
            return (
                None if track_runner.finished else Segment(track_runner.index, words or track_runner.task.instruction)
            )

        fly(HeldDrone(self.drone, hold), self.policy, self.drone, segment, reasoner=async_reasoner)
        outcomes = [result.outcome for result in track_runner.results]
        if words is not None and outcomes[0] in ("passed", "wrong_gate"):
            return "through a gate"
        return "hovered" if hold.active else next((one for one in outcomes if one != "passed"), "passed")


def kinds(task: Task) -> set[str]:
    return {label.partition("/")[0] for label in task.labels}


def unknown_people(suite: Suite, episodes: range, seed: int) -> Iterator[tuple[int, str]]:
    """Scenes, each with the instruction of a task whose panels show other kinds of things."""
    rng = np.random.default_rng(seed)
    tasks = [track[0] for track in suite.tracks if track[0].board is None]
    for episode in episodes:
        here = kinds(suite.tracks[episode][0])
        others = [task for task in tasks if not kinds(task) & here]
        if others:
            yield episode, others[int(rng.integers(len(others)))].instruction


def main(config: Config) -> None:
    suite = load_suite(config.suite)
    episodes = range(min(config.episodes, len(suite.tracks)))
    flights = Flights(suite, config)
    own = Counter(flights.fly(episode, None) for episode in episodes)
    print(f"{config.suite}, hovers below {config.below:g}")
    print(f"  its own instruction  n {own.total():3d}: {dict(own.most_common())}")
    other = Counter(flights.fly(episode, words) for episode, words in unknown_people(suite, episodes, config.seed))
    print(f"  another's            n {other.total():3d}: {dict(other.most_common())}")
    flights.simulator.close()
    ends = ("passed", "wrong_gate", "hovered")
    row = {
        **{f"own_{end}": own[end] for end in ends},
        "own_other": own.total() - sum(own[end] for end in ends),
        "another_hovered": other["hovered"],
        "another_through": other["through a gate"],
        "another_other": other.total() - other["hovered"] - other["through a gate"],
    }
    keep(config.out, f"Hovering in doubt, {config.suite}, below {config.below:g}", [row], seed=config.seed)


if __name__ == "__main__":
    main(tyro.cli(Config))
