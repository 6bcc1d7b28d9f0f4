"""Which graphics cards there are, who takes which, and a pool whose workers cannot all draw on one."""

import os
import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from cognitivedrone.errors import FirstFrameError, PluginError
from cognitivedrone.interfaces import Policy
from cognitivedrone.pilot import on_card
from cognitivedrone.rollout import cards, ray_pool
from cognitivedrone.rollout.cards import Cards
from cognitivedrone.rollout.process_pool import ProcessPool
from cognitivedrone.sim.drawing.renderers import REMEMBERED, VISIBLE

H100, T4 = "NVIDIA H100 80GB HBM3", "Tesla T4"
UNSEEN = "no variable"


def machine(root: Path, *kinds: str) -> Path:
    """A machine with cards of these kinds, as NVIDIA's driver lists them."""
    for number, kind in enumerate(kinds):
        folder = root / f"proc/driver/nvidia/gpus/0000:0{number}:00.0"
        folder.mkdir(parents=True)
        (folder / "information").write_text(f"Model: \t\t {kind}\nIRQ:   \t\t 24\nGPU UUID: \t GPU-{number}\n")
    return root


@pytest.mark.parametrize(
    ("kinds", "told", "names", "of_kinds"),
    [
        ([], None, (), ()),
        ([], "0,1", (), ()),  # there is no driver
        ([H100], None, ("0",), (H100,)),
        ([H100, H100], None, ("0", "1"), (H100,)),
        ([T4, H100], None, ("0", "1"), (H100, T4)),
        ([T4, H100], "1, 0", ("1", "0"), (H100, T4)),
        ([T4, H100], "1", ("1",), ()),
        ([H100, H100], "", (), ()),
        ([H100, H100], "-1", (), ()),
        ([H100, H100], "1,-1,0", ("1",), ()),
        ([H100, H100], "0,1,2", ("0", "1"), (H100,)),  # CUDA stops at the first that is not there
        ([H100], "MIG-1a,MIG-2b", ("MIG-1a", "MIG-2b"), ()),
    ],
)
def test_the_cards_of_a_machine(
    kinds: Sequence[str],
    told: str | None,
    names: tuple[str, ...],
    of_kinds: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(VISIBLE, raising=False)
    if told is not None:
        monkeypatch.setenv(VISIBLE, told)
    assert cards.here(machine(tmp_path, *kinds)) == Cards(names, of_kinds)


def test_a_container_with_the_devices_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VISIBLE)
    (tmp_path / "dev").mkdir()
    for name in ("nvidia0", "nvidia1", "nvidiactl", "nvidia-uvm"):
        (tmp_path / "dev" / name).touch()
    assert cards.here(tmp_path) == Cards(("0", "1"))


def test_as_many_workers_as_pay_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cards, "cores", lambda: 16)
    two = Cards(("0", "1"))
    assert two.workers(on_card=True) == 2
    assert two.workers(on_card=False) == 16
    assert Cards().workers(on_card=True) == 16
    monkeypatch.setattr(cards, "cores", lambda: 1)
    assert two.workers(on_card=True) == 1


class OnCard(Policy):
    """A user's own policy."""

    on_card = True

    def __init__(self, device: str | None = None) -> None:
        pass

    def act(self, observation: Any) -> Any:
        raise NotImplementedError


@pytest.mark.parametrize(
    ("policy", "reasoner", "found"),
    [
        ("small", "small", False),
        ("openvla:some/folder", "none", True),
        ("openvla:some/folder,device=cpu", "none", False),
        ("lerobot:some/folder", "none", True),
        ("small", "vlm-local:some/folder", True),
        (f"{__name__}:OnCard", "none", True),
        (f"{__name__}:OnCard:cpu", "none", False),
        ("hovver", "none", False),
    ],
)
def test_whose_network_is_on_a_card(policy: str, reasoner: str, found: bool) -> None:
    assert on_card(policy, reasoner) is found


def test_a_wrong_argument_is_a_sentence() -> None:
    with pytest.raises(PluginError, match="has no option 'devise'"):
        on_card("openvla:folder,devise=cpu")


class Seeing:
    """A worker that says which card it sees, where a worker says what draws."""

    def __init__(self, watch: Any) -> None:
        self.watch = watch

    @property
    def renderer(self) -> str:
        return f"{os.environ.get(VISIBLE, UNSEEN)} {os.environ.get(REMEMBERED, UNSEEN)}"

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class Looking:
    """Work whose items say which card the worker sees; item -1 ends it in a policy's call."""

    time_limit_s: float = 60.0

    def open(self, watch: object = None) -> Seeing:
        return Seeing(watch)

    def fly(self, worker: Seeing, item: int) -> Iterable[str]:
        if item < 0:
            worker.watch.begin()
            os._exit(3)
        yield worker.renderer

    def title(self, item: int) -> str:
        return f"item {item}"

    def lost(self, item: int, message: str, trace: str) -> str:
        return "lost"

    def differences(self) -> str:
        return ""


@pytest.fixture
def two_cards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """A machine with two cards of a kind, whose first one draws for this process."""
    monkeypatch.delenv(VISIBLE)
    monkeypatch.setenv(REMEMBERED, f"egl:{H100}")
    pretended = machine(tmp_path, H100, H100)
    found = cards.here
    monkeypatch.setattr(cards, "here", lambda: found(pretended))
    return monkeypatch


def seen_by(pool: ProcessPool[int, str]) -> list[str]:
    """What each worker sees, once all are ready."""
    for worker in pool._workers:
        if worker.renderer is None:
            pool._receive(worker)
    return [worker.renderer or "" for worker in pool._workers]


def test_workers_take_the_cards_by_turns_and_their_successors_too(two_cards: pytest.MonkeyPatch) -> None:
    with ProcessPool(Looking(), 3) as pool:
        assert seen_by(pool) == [f"0 {UNSEEN}", f"1 {UNSEEN}", f"0 {UNSEEN}"]
        assert [answer for answer, _ in pool.fly([-1, -1, -1])] == ["lost"] * 3
        assert seen_by(pool) == [f"0 {UNSEEN}", f"1 {UNSEEN}", f"0 {UNSEEN}"]
    assert VISIBLE not in os.environ
    assert os.environ[REMEMBERED] == f"egl:{H100}"


def test_a_worker_alone_sees_what_this_process_sees(two_cards: pytest.MonkeyPatch) -> None:
    two_cards.setenv(VISIBLE, "1,0")
    with ProcessPool(Looking(), 1) as pool:
        assert seen_by(pool) == [f"1,0 egl:{H100}"]


def test_cards_of_different_kinds_are_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VISIBLE)
    pretended, found = machine(tmp_path, H100, T4), cards.here
    monkeypatch.setattr(cards, "here", lambda: found(pretended))
    says = re.escape(f"spread over cards of different kinds ({H100}, {T4}), whose pictures and answers may differ")
    with pytest.warns(RuntimeWarning, match=says), ProcessPool(Looking(), 2) as pool:
        assert [seen[0] for seen in seen_by(pool)] == ["0", "1"]


def test_an_actor_sees_the_card_that_ray_gave_it(two_cards: pytest.MonkeyPatch) -> None:
    two_cards.setenv(VISIBLE, "1")
    actor = ray_pool.Actor(Looking(), Path.cwd(), [])
    actor.open()
    try:
        assert actor.fly(0) == [(f"1 {UNSEEN}", f"1 {UNSEEN}")]
    finally:
        actor.close()


class Drawing:
    renderer = "a card"

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class CardFor:
    """Work on a card that returns frames to the first `most` processes alone."""

    folder: Path
    most: int
    time_limit_s: float = 60.0

    def open(self, watch: object = None) -> Drawing:
        for number in range(self.most):
            try:
                (self.folder / str(number)).touch(exist_ok=False)
            except FileExistsError:
                continue
            return Drawing()
        raise FirstFrameError("a card drew no frame within 60 s; let fewer processes draw on it.")

    def fly(self, worker: Drawing, item: int) -> Iterable[int]:
        yield item * item

    def title(self, item: int) -> str:
        return f"item {item}"

    def lost(self, item: int, message: str, trace: str) -> Any:
        raise AssertionError(message)

    def differences(self) -> str:
        return ""


def test_fewer_workers_go_on_where_a_card_draws_for_no_more(tmp_path: Path) -> None:
    with warnings.catch_warnings(record=True) as said, ProcessPool(CardFor(tmp_path, 1), 3) as pool:
        warnings.simplefilter("always")
        answers = sorted(answer for answer, _ in pool.fly(range(6)))
        while pool.size > 1:  # those that are late to fail
            list(pool.fly([0]))
    assert answers == [0, 1, 4, 9, 16, 25]
    assert [str(warning.message).partition("on it. ")[2] for warning in said] == [
        "2 of 3 workers go on.",
        "1 of 3 workers go on.",
    ]


@pytest.mark.filterwarnings("ignore:a card drew no frame")
def test_without_any_that_draws_the_error_is_raised(tmp_path: Path) -> None:
    pool = ProcessPool(CardFor(tmp_path, 0), 2)
    with pytest.raises(FirstFrameError, match="drew no frame"):
        pool.__enter__()
