"""The number format of a training run's networks: bfloat16 where the hardware multiplies it, float32 elsewhere."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Final

import torch

_PROCESSOR: Final = Path("/proc/cpuinfo")


@functools.cache
def trains_in_bf16() -> bool:
    """Whether this machine does. What has no bfloat16 only emulates it, several times slower than float32."""
    if torch.cuda.is_available():
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    return multiplies_bf16(_PROCESSOR)


def multiplies_bf16(processor: Path) -> bool:
    """Whether Linux lists bfloat16 among a processor's instructions: avx512_bf16 or amx_bf16 (x86), bf16 (Arm)."""
    try:
        text = processor.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    flags = " ".join(re.findall(r"^(?:flags|Features)\s*:(.*)$", text, flags=re.MULTILINE))
    return any(flag.endswith("bf16") for flag in flags.split())
