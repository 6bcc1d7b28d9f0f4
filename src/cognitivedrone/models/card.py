"""What is the matter with a graphics card: one sentence each, with the way out."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.system import NVIDIAS_DRIVER

EMULATED: Final = "which is emulated, several times slower: take one of compute capability 8.0 (Ampere, 2020) or newer"
"""Of a card that multiplies no bfloat16, where nothing else is to be had."""


def why_none(torch: Any, driver: Path = NVIDIAS_DRIVER) -> str:
    """Why PyTorch can use no card although there is one, as the end of a sentence; empty where there is none."""
    if not driver.exists():
        return ""
    if getattr(torch.version, "cuda", None) is None:
        return "; there is a card, but this PyTorch is a build without CUDA: install one with it (docs/install.md)"
    if _hidden():
        return "; there is a card, but CUDA_VISIBLE_DEVICES hides it: unset it"
    try:
        torch.cuda.init()
    except Exception as error:  # PyTorch tells the driver's version, or what the driver says
        reason = " ".join(str(error).split())[:200]
        return f"; there is a card, but it does not start: {reason} (a newer driver, or an older PyTorch, may help)"
    return ""


def _hidden() -> bool:
    """Whether all cards are hidden, by somebody who wants none."""
    hidden = os.environ.get("CUDA_VISIBLE_DEVICES")
    return hidden is not None and (not hidden.strip() or hidden.strip().startswith("-"))


def warn(torch: Any, who: str, without_bf16: str, driver: Path = NVIDIAS_DRIVER) -> None:
    """Warn of what makes `who` slower here than it needs to be: a card that cannot be used, or a slow one.

    `without_bf16` as in `remarks`. Of cards that are hidden nothing is said.
    """
    if torch.cuda.is_available():
        for remark in remarks(torch, without_bf16):
            warnings.warn(f"{who}: {remark}", RuntimeWarning, stacklevel=3)
    elif not _hidden() and (fault := why_none(torch, driver)):
        warnings.warn(f"{who} runs on the processor{fault}", RuntimeWarning, stacklevel=3)


@contextmanager
def in_memory(raised: type[CognitiveDroneError], who: str, way_out: str) -> Iterator[None]:
    """Inside this context, an error of PyTorch about a card that is full or taken is a sentence, of the type `raised`.

    `who` is its beginning, and `way_out` its end, such as ", or take quant=int8".
    """
    try:
        yield
    except RuntimeError as error:
        if not (short := shortage(error)):
            raise
        raise raised(f"{who}: {short}{way_out}") from None


def shortage(error: Exception) -> str:
    """What is short on a card, where an error of PyTorch says so, and the way out; else empty."""
    text = " ".join(str(error).split())
    if type(error).__name__ == "OutOfMemoryError" or "CUDA out of memory" in text:
        return "the card's memory is full: end what else uses it (nvidia-smi lists it)"
    if "busy or unavailable" in text:
        return "another program holds the card for itself: wait for it, or choose another by CUDA_VISIBLE_DEVICES"
    return ""


def remarks(torch: Any, without_bf16: str) -> Sequence[str]:
    """What makes the cards that PyTorch can use slower than they need to be: a sentence each.

    `without_bf16` is the end of the one about a card that multiplies no bfloat16; empty where none is used.
    """
    found = []
    if without_bf16 and not torch.cuda.is_bf16_supported(including_emulation=False):
        name = torch.cuda.get_device_name()
        found.append(f"{name} multiplies no bfloat16, {without_bf16}")
    names = sorted({torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())})
    if len(names) > 1:
        found.append(
            f"there are cards of different kinds ({', '.join(names)}); those that work together go at the pace of the"
            " slowest: CUDA_VISIBLE_DEVICES chooses"
        )
    return found
