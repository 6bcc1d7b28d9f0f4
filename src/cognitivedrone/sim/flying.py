"""Protocols of what a simulator needs: flight dynamics and cameras, our own or another program's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.types import DroneState, FloatArray, Image, Images, Quaternions, Stage, Vectors
from cognitivedrone.world.appearance import Look


class Flying(Protocol):
    """Batched flight dynamics, one drone per world. `sim.dynamics.Flight` is ours and documents the members."""

    @property
    def worlds(self) -> int:
        """Number of worlds."""
        ...

    def reset(
        self,
        world: int,
        position: FloatArray,
        yaw: float = 0.0,
        velocity: FloatArray | None = None,
        *,
        wind: FloatArray | None = None,
    ) -> None:
        """Reset to steady flight; (3,) world, m and m/s, yaw in rad."""
        ...

    def command(self, actions: FloatArray) -> None:
        """Set (worlds, 4) heading-frame velocities in m/s and yaw rates in rad/s."""
        ...

    def command_one(self, world: int, action: FloatArray) -> None:
        """Like `command`, (4,) for one world."""
        ...

    def advance(self, ticks: int) -> FloatArray:
        """Advance by ticks of `Flight.TICK_S`; returns the path, (worlds, samples, 3), world, m."""
        ...

    def state(self, world: int) -> DroneState:
        """The true state of one drone."""
        ...

    @property
    def position(self) -> FloatArray:
        """(worlds, 3), world, m."""
        ...

    @property
    def velocity(self) -> FloatArray:
        """(worlds, 3), world, m/s."""
        ...

    @property
    def quaternion(self) -> FloatArray:
        """(worlds, 4), w, x, y, z, body to world."""
        ...

    @property
    def body_rates(self) -> FloatArray:
        """(worlds, 3), body FLU, rad/s."""
        ...

    @property
    def yaw(self) -> FloatArray:
        """(worlds,), heading, rad."""
        ...

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """(worlds,): whether the flight can no longer be judged; such a world is frozen until its next reset."""
        ...


class CameraSource(Protocol):
    """First-person cameras, one per world; `sim.camera.Cameras` is our implementation and documents the members."""

    def set_stage(self, slot: int, stage: Stage, images: Sequence[Image], board: Image | None, look: Look) -> None:
        """Show a stage in a world, with the pictures on its panels."""
        ...

    def first_person(
        self, positions: Vectors, quaternions: Quaternions, out: Images | None, slots: Sequence[int] | None
    ) -> Images:
        """(n, size, size, 3) views from (n, 3) world, m, and (n, 4) w, x, y, z; written into `out` if given."""
        ...
