"""A Ray cluster that fails, or a node of it, played without Ray: a sentence with the way out, not Ray's text."""

import contextlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs import runner
from cognitivedrone.errors import RunError
from cognitivedrone.rollout import cards, ray_pool
from cognitivedrone.rollout.cards import Cards
from cognitivedrone.rollout.ray_pool import LOSSES, RayPool


class RayError(Exception):
    """Ray's own."""


class RayTaskError(RayError):
    """What an actor raised."""

    def __init__(self, cause: Exception) -> None:
        super().__init__("Ray's own text\n of several lines")
        self.cause = cause


class PlayedRay:
    """As much of Ray as a pool uses; `answer` makes the answer of a call of an actor's method."""

    exceptions = SimpleNamespace(RayError=RayError, RayTaskError=RayTaskError)

    def __init__(self, answer: Callable[[str, object], object]) -> None:
        self.actors = 0
        self.gpus = 0.0
        """Of the one node."""
        self.reserved: dict[str, object] = {}
        """By an actor."""
        self._answer = answer

    def nodes(self) -> list[dict[str, Any]]:
        return [{"Alive": True, "Resources": {"CPU": 1.0} | ({"GPU": self.gpus} if self.gpus else {})}]

    def put(self, thing: object) -> object:
        return thing

    def remote(self, **reserved: object) -> Callable[[type], Any]:
        self.reserved = reserved

        def made(*_: object) -> SimpleNamespace:
            self.actors += 1
            return SimpleNamespace(
                **{name: SimpleNamespace(remote=self._called(name)) for name in ("open", "fly", "close")}
            )

        return lambda _: SimpleNamespace(remote=made)

    def _called(self, name: str) -> Callable[..., object]:
        return lambda *arguments: (name, *arguments)

    def wait(self, messages: list[Any], **_: object) -> tuple[list[Any], list[Any]]:
        return messages[:1], messages[1:]

    def get(self, message: tuple[str, ...]) -> object:
        return self._answer(message[0], message[-1])

    def kill(self, actor: object) -> None:
        if self._answer("kill", None) == "fails":
            raise RayError("no cluster")


@pytest.fixture
def play(monkeypatch):
    """Plays a cluster that answers so."""

    def playing(answer):
        ray = PlayedRay(answer)

        @contextlib.contextmanager
        def cluster(_):
            yield ray

        monkeypatch.setattr(ray_pool, "ray_cluster", cluster)
        return ray

    return playing


def pool() -> RayPool[int, str]:
    work: Any = SimpleNamespace(title=lambda item: f"episode {item}")
    return RayPool(work, 1, 1)


DEAD = RayError("the agent of this node has died")
OWN = RuntimeError("The node with node id: 12ab\nhas been marked dead because the agent failed")


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ({"fly": OWN, "kill": "fails"}, r"^the Ray cluster has failed; continue .* \(RuntimeError: The node"),
        ({"fly": RayTaskError(DEAD)}, f"episode 1 has lost its worker {LOSSES} times; continue"),
        ({"open": DEAD}, "no worker of the Ray cluster becomes ready; continue"),
    ],
    ids=["Ray's own", "every node fails", "no worker opens"],
)
def test_what_ends_a_cluster_is_one_sentence_with_the_way_out(play, answers, says):
    def answer(name, _):
        if isinstance(answers.get(name), Exception):
            raise answers[name]
        return answers.get(name)

    play(answer)
    with pytest.raises(RunError, match=says) as told, pool() as flying:
        list(flying.fly([1]))
    assert "continue with --resume" in str(told.value)


def test_an_episode_on_a_node_that_fails_is_flown_again(play):
    failed: list[object] = []

    def answer(name, item):
        if name == "fly" and not failed:
            failed.append(item)
            raise RayTaskError(RayError("the agent of this node has died"))
        return [(f"flown {item}", "")] if name == "fly" else None

    ray = play(answer)
    with pool() as flying:
        assert sorted(flying.fly([1, 2])) == [("flown 1", ""), ("flown 2", "")]
    assert ray.actors == 2


@pytest.mark.parametrize(
    ("policy", "asked", "there", "reserved"),
    [
        ("openvla:folder", None, 1.0, 1.0),
        ("openvla:folder", None, 0.0, 0.0),  # it says itself what it needs
        ("openvla:folder", 0.5, 1.0, 0.5),
        ("openvla:folder,device=cpu", None, 1.0, 0.0),
        ("small", None, 1.0, 0.0),
    ],
)
def test_an_actor_reserves_a_gpu_for_a_network_on_one(play, policy, asked, there, reserved):
    ray = play(lambda name, item: None)
    ray.gpus = there
    plan = Plan.of(policy=policy, executor="ray", gpus_per_worker=asked)
    flights: Any = SimpleNamespace(job=SimpleNamespace(plan=plan), title=str)
    with runner._pool_of(flights, 1, None):
        assert ray.reserved == {"num_cpus": 1, "num_gpus": reserved}


def test_workers_by_default_are_as_many_as_the_cards_that_hold_the_network(monkeypatch):
    made: list[int] = []
    monkeypatch.setattr(runner, "ProcessPool", lambda flights, workers: made.append(workers))
    monkeypatch.setattr(cards, "here", lambda: Cards(("0", "1")))
    monkeypatch.setattr(cards, "cores", lambda: 8)
    for policy, workers in (("openvla:folder", None), ("small", None), ("openvla:folder", 3)):
        flights: Any = SimpleNamespace(job=SimpleNamespace(plan=Plan.of(policy=policy, workers=workers)))
        runner._pool_of(flights, 300, None)
    assert made == [2, 8, 3]
