"""Sentences about graphics cards, with a pretended PyTorch."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.compiling import in_memory, remarks, warn, why_none

SLOW = "so it takes longer"
FULL = "CUDA out of memory. Tried to allocate 2.00 GiB.\nGPU 0 has a total capacity"
TAKEN = "CUDA error: CUDA-capable device(s) is/are busy or unavailable\nCUDA kernel errors might be"


@pytest.fixture
def driver(tmp_path: Path) -> Path:
    (tmp_path / "version").write_text("NVRM version")
    return tmp_path / "version"


def pretended(
    cuda: str | None = "13.0",
    error: str = "",
    names: tuple[str, ...] = ("A",),
    *,
    bf16: bool = True,
    usable: bool = True,
) -> Any:
    def init() -> None:
        if error:
            raise RuntimeError(error)

    return SimpleNamespace(
        version=SimpleNamespace(cuda=cuda),
        cuda=SimpleNamespace(
            init=init,
            is_available=lambda: usable,
            is_bf16_supported=lambda including_emulation: bf16,
            get_device_name=lambda index=0: names[index],
            device_count=lambda: len(names),
        ),
    )


def test_without_a_driver_there_is_nothing_to_say(tmp_path: Path) -> None:
    assert why_none(pretended(None), tmp_path / "version") == ""


@pytest.mark.parametrize(
    ("torch", "hidden", "says"),
    [
        (pretended(None), None, "this PyTorch is a build without CUDA: install one with it"),
        (pretended(), "", "CUDA_VISIBLE_DEVICES hides it: unset it"),
        (pretended(), "-1", "CUDA_VISIBLE_DEVICES hides it: unset it"),
        (
            pretended(error="The NVIDIA driver on your\nsystem is too old"),
            "0",
            "your system is too old (a newer driver,",
        ),
        (pretended(), "0", ""),
    ],
)
def test_a_card_that_cannot_be_used(
    torch: Any, hidden: str | None, says: str, driver: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    if hidden is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", hidden)
    said = why_none(torch, driver)
    assert says in said
    assert bool(said) == bool(says)
    assert "\n" not in said


def test_cards_that_are_slower_than_they_need_to_be() -> None:
    assert remarks(pretended(), SLOW) == []
    assert remarks(pretended(names=("A", "A")), SLOW) == []
    assert remarks(pretended(names=("T4",), bf16=False), SLOW) == ["T4 multiplies no bfloat16, so it takes longer"]
    assert remarks(pretended(names=("T4",), bf16=False), "") == []
    (mixed,) = remarks(pretended(names=("B", "A", "B")), SLOW)
    assert "cards of different kinds (A, B)" in mixed


@pytest.mark.parametrize(
    ("torch", "says"),
    [
        (pretended(names=("T4",), bf16=False), "training: T4 multiplies no bfloat16, so it takes longer"),
        (pretended(None, usable=False), "training runs on the processor; there is a card, but this PyTorch is a build"),
        (pretended(error="driver too old", usable=False), "on the processor; .* it does not start: driver too old"),
    ],
)
def test_what_is_slower_is_said(torch: Any, says: str, driver: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    with pytest.warns(RuntimeWarning, match=says) as told:
        warn(torch, "training", SLOW, driver)
    assert len(told) == 1


def test_who_hides_a_card_knows_of_it(driver: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    warn(pretended(usable=False), "training", SLOW, driver)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    warn(pretended(None, usable=False), "training", SLOW, tmp_path / "no driver")
    warn(pretended(), "training", SLOW, driver)


class OutOfMemoryError(RuntimeError):
    """As PyTorch's own is called."""


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (OutOfMemoryError(FULL), "the card's memory is full: end what else uses it (nvidia-smi lists it)"),
        (RuntimeError(FULL), "the card's memory is full: end what else uses it (nvidia-smi lists it)"),
        (
            RuntimeError(TAKEN),
            "another program holds the card for itself: wait for it, or choose another by CUDA_VISIBLE_DEVICES",
        ),
    ],
)
def test_a_card_that_is_full_or_taken_is_a_sentence(error: Exception, says: str) -> None:
    with pytest.raises(TrainingError) as caught, in_memory(TrainingError, "training", ", or hide it"):
        raise error
    assert str(caught.value) == f"training: {says}, or hide it"


def test_other_errors_stay_what_they_are() -> None:
    with pytest.raises(RuntimeError, match="shapes"), in_memory(TrainingError, "training", ""):
        raise RuntimeError("shapes do not fit")
