"""Checks shapes and dtypes of arrays in every call of the package, while tests run."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, get_args

from beartype import beartype
from jaxtyping import AbstractArray, config, install_import_hook

CHECKED: tuple[str, ...] = (
    "types", "frames", "sim.drawing.camera", "sim.simulator", "sim.drawing.views", "envs.worlds", "control.loop",
)  # fmt: skip
CHECKED += (
    "models.small_file", "models.eyes.sight", "models.mind", "models.openvla.actions", "policies.small",
    "policies.openvla", "data.episode",
)  # fmt: skip
"""Where arrays pass from one part to another. The arithmetic of one tick is left out: it is called too often."""


def checked(part: Callable[..., Any]) -> Callable[..., Any]:
    """The function with its annotations of arrays checked; everything else is left to mypy.

    Tests pass fakes and wrong values on purpose, and the package must answer those as it does without the checks.
    """
    hints = {name: hint if _of_array(hint) else Any for name, hint in part.__annotations__.items()}
    if set(hints.values()) <= {Any}:
        return part
    part.__annotations__ = hints
    return beartype(part)


def install() -> None:
    """From now on, check what is imported of `CHECKED`."""
    install_import_hook([f"cognitivedrone.{name}" for name in CHECKED], f"{__name__}.checked")


@contextmanager
def unchecked() -> Iterator[None]:
    """Without the checks, as users have it: for tests of what the package says to wrong values."""
    config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        config.update("jaxtyping_disable", False)


def _of_array(hint: Any) -> bool:
    """Whether a shape is part of the hint."""
    return (isinstance(hint, type) and issubclass(hint, AbstractArray)) or any(map(_of_array, get_args(hint)))
