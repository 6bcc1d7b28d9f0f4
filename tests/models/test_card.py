"""Sentences about graphics cards, with a pretended PyTorch."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cognitivedrone.models.card import remarks, why_none


@pytest.fixture
def driver(tmp_path: Path) -> Path:
    (tmp_path / "version").write_text("NVRM version")
    return tmp_path / "version"


def pretended(cuda: str | None = "13.0", error: str = "", names: tuple[str, ...] = ("A",), bf16: bool = True) -> Any:
    def init() -> None:
        if error:
            raise RuntimeError(error)

    return SimpleNamespace(
        version=SimpleNamespace(cuda=cuda),
        cuda=SimpleNamespace(
            init=init,
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
    assert remarks(pretended()) == []
    assert remarks(pretended(names=("A", "A"))) == []
    (old,) = remarks(pretended(names=("T4",), bf16=False))
    assert old.startswith("T4 multiplies no bfloat16")
    (mixed,) = remarks(pretended(names=("B", "A", "B")))
    assert "cards of different kinds (A, B)" in mixed
