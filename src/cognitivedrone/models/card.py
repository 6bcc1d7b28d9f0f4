"""What is the matter with a graphics card: one sentence each, with the way out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

DRIVER: Final = Path("/proc/driver/nvidia/version")
"""Is there where NVIDIA's driver is loaded."""


def why_none(torch: Any, driver: Path = DRIVER) -> str:
    """Why PyTorch can use no card although there is one, as the end of a sentence; empty where there is none."""
    if not driver.exists():
        return ""
    if getattr(torch.version, "cuda", None) is None:
        return "; there is a card, but this PyTorch is a build without CUDA: install one with it (docs/install.md)"
    hidden = os.environ.get("CUDA_VISIBLE_DEVICES")
    if hidden is not None and (not hidden.strip() or hidden.strip().startswith("-")):
        return "; there is a card, but CUDA_VISIBLE_DEVICES hides it: unset it"
    try:
        torch.cuda.init()
    except Exception as error:  # PyTorch tells the driver's version, or what the driver says
        reason = " ".join(str(error).split())[:200]
        return f"; there is a card, but it does not start: {reason} (a newer driver, or an older PyTorch, may help)"
    return ""


def remarks(torch: Any) -> Sequence[str]:
    """What makes the cards that PyTorch can use slower than they need to be: a sentence each."""
    found = []
    if not torch.cuda.is_bf16_supported(including_emulation=False):
        name = torch.cuda.get_device_name()
        found.append(
            f"{name} multiplies no bfloat16, which is emulated, several times slower; dtype=float32 may be faster"
        )
    names = sorted({torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())})
    if len(names) > 1:
        found.append(
            f"there are cards of different kinds ({', '.join(names)}); those that work together go at the pace of the"
            " slowest: CUDA_VISIBLE_DEVICES chooses"
        )
    return found
