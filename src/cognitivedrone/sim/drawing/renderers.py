"""What draws: the processor or a graphics card; who decides that, and how many contexts pay off on it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from cognitivedrone.errors import RenderError
from cognitivedrone.system import NVIDIAS_DRIVER
from cognitivedrone.text.printable import visible

CHOICE: Final = "COGNITIVEDRONE_RENDERER"
"""The variable by which a person chooses: cpu or gpu."""
DEVICE: Final = "MUJOCO_EGL_DEVICE_ID"
"""MuJoCo's variable for the number of EGL's device."""
VISIBLE: Final = "CUDA_VISIBLE_DEVICES"
"""CUDA's variable for the cards that a process may use."""
REMEMBERED: Final = "COGNITIVEDRONE_GL"
"""The variable by which a process tells its children what it found that draws."""
_SOFTWARE: Final = re.compile(r"llvmpipe|softpipe|swrast|software|swiftshader|lavapipe", re.IGNORECASE)


def on_processor(renderer: str) -> bool:
    """Whether an OpenGL renderer of this name draws on the processor: llvmpipe and its like."""
    return _SOFTWARE.search(renderer) is not None


def contexts_for(renderer: str, slots: int, threads: int, most_slots: int) -> int:
    """How many OpenGL contexts pay off for `slots` cameras on up to `threads` threads.

    llvmpipe draws in the calling thread, so it takes them all. A card draws for one context at a time, and changing
    between contexts costs more than drawing (`docs/gymnasium.md` has the figures): it gets as few as hold the slots.
    """
    return threads if on_processor(renderer) else min(threads, -(-slots // most_slots))


def chosen() -> str:
    """What the person chose: cpu, gpu or nothing. Raises `RenderError` for anything else."""
    value = os.environ.get(CHOICE, "").strip().lower()
    if value not in ("", "cpu", "gpu"):
        raise RenderError(f"{CHOICE}={visible(value)} is no renderer; unset it, or set it to cpu or gpu.")
    return value


def cards_hidden() -> bool:
    """Whether `CUDA_VISIBLE_DEVICES` hides all cards, which are then another program's."""
    value = os.environ.get(VISIBLE)
    return value is not None and (not value.strip() or value.strip().startswith("-"))


def suits(renderer: str) -> bool:
    """Whether a renderer is what the person chose or, without a choice, is on no card that is hidden."""
    wish = chosen() or ("cpu" if cards_hidden() else "")
    return not wish or on_processor(renderer) == (wish == "cpu")


def check(renderer: str) -> None:
    """Raise `RenderError` if a renderer, the only one that was found, is not what the person chose."""
    wish = chosen()
    if not wish or suits(renderer):
        return
    if os.environ.get(DEVICE):
        raise RenderError(
            f"{CHOICE}={wish}, but {DEVICE}={visible(os.environ[DEVICE])} draws by {renderer}; unset one of the two."
        )
    if wish == "gpu":
        raise RenderError(
            f"{CHOICE}=gpu, but OpenGL finds no graphics card here, only {renderer}; unset it, or install the card's "
            "OpenGL (in a container: NVIDIA_DRIVER_CAPABILITIES=all)."
        )
    raise RenderError(
        f"{CHOICE}=cpu, but OpenGL draws by {renderer} alone; unset it, or install Mesa: "
        "apt-get install -y libegl1 libgl1-mesa-dri libopengl0"
    )


def why(renderer: str, driver: Path = NVIDIAS_DRIVER) -> str:
    """Why this renderer draws, as the end of a sentence. `driver` is there where NVIDIA's is loaded."""
    if os.environ.get("MUJOCO_GL"):
        return f"MUJOCO_GL={visible(os.environ['MUJOCO_GL'])}"
    if wish := chosen():
        return f"{CHOICE}={wish}"
    software = on_processor(renderer)
    if cards_hidden():
        hides = f"{VISIBLE} hides all cards"
        return hides if software else f"{hides}, but nothing else draws here"
    if software and driver.exists():
        return (
            "OpenGL does not find the graphics card of this machine: install the card's OpenGL, in a container by"
            " NVIDIA_DRIVER_CAPABILITIES=all"
        )
    if software:
        return "OpenGL finds no graphics card"
    if re.search("[A-Za-z]", os.environ.get(VISIBLE, "")):
        return f"OpenGL's first card, since it does not know the names in {VISIBLE}; {DEVICE} chooses another"
    return f"OpenGL's first card; {CHOICE}=cpu draws on the processor"
