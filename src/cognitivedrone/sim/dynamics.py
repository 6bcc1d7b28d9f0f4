"""Batched flight dynamics: MuJoCo's physics and our autopilot in lock-step."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cognitivedrone.errors import ActionError
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.sim.airframe import RACER, Airframe, build_model
from cognitivedrone.sim.autopilot import GUIDE_S, Autopilot, AutopilotGains, trim
from cognitivedrone.types import DroneState, FloatArray, Quaternions, Scalars, Vector, Vectors
from cognitivedrone.world.engine import Batch, mujoco

MAX_POSITION_M = 1e4
MAX_VELOCITY_M_S = 100.0
MAX_BODY_RATE_RAD_S = 300.0
"""Limits per axis; beyond them a flight counts as diverged."""
_LIMITS = np.array([MAX_POSITION_M] * 3 + [2.0] * 4 + [MAX_VELOCITY_M_S] * 3 + [MAX_BODY_RATE_RAD_S] * 3)[:, None]
"""Limits of the state: m, quaternion, m/s, rad/s."""

WORLDS_PER_THREAD = 32
"""Stepping fewer worlds takes less time than waking a sleeping thread, much less on a busy machine."""


def threads_for(worlds: int, threads: int) -> int:
    """How many of up to `threads` threads pay off for the physics of so many worlds (`benchmarks/dynamics.py`).

    They are woken at every tick of 2.5 ms, and wait for each other; the autopilot between ticks has one thread anyway.
    """
    return max(1, min(threads, worlds // WORLDS_PER_THREAD))


class BatchedFlight:
    """n drones, each in its own world, flown by velocity setpoints, on `threads` threads.

    A world's flight depends only on its `reset` and its commands, to the last bit: not on the other worlds,
    on threads, or on earlier flights.
    """

    TICK_S = 0.0025
    """Physics period, s."""
    SAMPLE_TICKS = round(GUIDE_S / TICK_S)
    """Ticks between runs of the autopilot's outer loops, and between samples of `advance`."""

    def __init__(
        self, worlds: int = 1, airframe: Airframe = RACER, *, threads: int = 1, gains: AutopilotGains | None = None
    ) -> None:
        self.worlds = worlds
        self.airframe = airframe
        self._batch = Batch(build_model(airframe, self.TICK_S), worlds, threads)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl, self._act = self._batch.bind("ctrl"), self._batch.bind("act")
        self._force = self._batch.bind("qfrc_applied")
        self._autopilot = Autopilot(airframe, worlds, self.TICK_S, gains)
        self._wind = np.zeros((3, worlds))
        self._state = np.zeros((13, worlds))  # qpos and qvel, component first
        self._diverged = np.zeros(worlds, dtype=bool)
        self._phase = 0  # ticks since the last run of the outer loops
        for world in range(worlds):
            self.reset(world, np.array([0.0, 0.0, 1.0]))

    def reset(
        self,
        world: int,
        position: Vector,
        yaw: float = 0.0,
        velocity: Vector | None = None,
        *,
        wind: Vector | None = None,
    ) -> None:
        """Reset to steady, trimmed flight with spinning rotors.

        position, velocity and wind are (3,), world axes, m and m/s; yaw in rad. Until the first command the drone
        keeps `velocity`; as after any command, it stops if no other follows within three seconds. The wind is steady.
        """
        position = np.asarray(position, dtype=np.float64)
        velocity = np.zeros(3) if velocity is None else np.asarray(velocity, dtype=np.float64)
        wind = np.zeros(3) if wind is None else np.asarray(wind, dtype=np.float64)
        trimmed = trim(self.airframe, yaw, velocity, wind)
        self._batch.reset(ids=[world], stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._qpos[world, :3] = position
        self._qpos[world, 3:] = trimmed.quaternion
        self._qvel[world, :3] = velocity
        self._ctrl[world] = self._act[world] = trimmed.rotor_thrust
        self._wind[:, world] = wind
        self._state[:7, world] = self._qpos[world]
        self._state[7:, world] = self._qvel[world]
        self._autopilot.reset(world, trimmed, position, velocity)
        self._diverged[world] = False
        if self.worlds == 1:
            self._phase = 0

    def command(self, actions: ArrayLike) -> None:
        """Latch (worlds, 4) heading-frame velocities in m/s and yaw rates in rad/s, turned to world axes now.

        Speeds and rates beyond the autopilot's limits are flown at the limit. Raises `ActionError` on values that are
        not finite or an array of another shape.
        """
        self._latch(slice(None), np.asarray(actions, dtype=np.float64), (self.worlds, 4))

    def command_one(self, world: int, action: ArrayLike) -> None:
        """Like `command`, (4,) for one world."""
        self._latch(slice(world, world + 1), np.asarray(action, dtype=np.float64)[None], (1, 4))

    def _latch(self, worlds: slice, actions: FloatArray, shape: tuple[int, int]) -> None:
        if actions.shape != shape:
            raise ActionError(f"actions have shape {actions.shape}; expected {shape}: vx, vy, vz and yaw rate a drone")
        if not np.isfinite(actions).all():
            bad = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise ActionError(
                f"the action {actions[bad].tolist()} of drone {bad} is not finite; send four real numbers"
            )
        w, x, y, z = self._state[3:7, worlds]
        # The heading's cosine and sine without computing angles, which keeps them exact.
        c, s = 1 - 2 * (y * y + z * z), 2 * (w * z + x * y)
        scale = 1 / np.maximum(np.sqrt(c * c + s * s), 1e-9)
        c, s = c * scale, s * scale
        vx, vy, vz, yaw_rate = actions.T
        self._autopilot.command(worlds, np.stack((c * vx - s * vy, s * vx + c * vy, vz, yaw_rate)))

    def advance(self, ticks: int) -> Vectors:
        """Advance the simulation; returns positions (worlds, samples, 3), world, m, every fourth tick and at the end.

        Several worlds share one guidance clock, so they advance by multiples of four ticks; a single world by any
        number. Raises `ValueError` otherwise.
        """
        if ticks < 0 or (self.worlds > 1 and ticks % self.SAMPLE_TICKS):
            raise ValueError(f"cannot advance {self.worlds} worlds by {ticks} ticks; give a multiple of four")
        path = []
        with np.errstate(over="ignore", invalid="ignore"):  # for a diverging world, until it is frozen
            while ticks > 0:
                if self._phase == 0:
                    self._guide()
                run = min(ticks, self.SAMPLE_TICKS - self._phase)
                self._step(run)
                ticks -= run
                self._phase = (self._phase + run) % self.SAMPLE_TICKS
                path.append(self._state[:3].T.copy())
        return np.stack(path, axis=1) if path else np.empty((self.worlds, 0, 3))

    def _guide(self) -> None:
        """The outer loops and, at the same rate, the drag."""
        state = self._state
        self._autopilot.guide(state[:3], state[7:10], state[3:7])
        self._force[:, :3] = self._drag().T

    def _step(self, ticks: int) -> None:
        flying = np.flatnonzero(~self._diverged) if self._diverged.any() else None
        rates = self._state[10:].copy()
        for _ in range(ticks):
            self._ctrl[:] = self._autopilot.stabilise(rates).T
            self._batch.step(flying)
            rates[:] = self._qvel[:, 3:].T
        fresh = np.concatenate((self._qpos.T, self._qvel.T))
        if (np.abs(fresh) < _LIMITS).all():
            self._state[:] = fresh
        else:
            self._freeze(fresh)

    def _drag(self) -> FloatArray:
        """Drag force on the body, (3, worlds), N."""
        air = self._wind - self._state[7:10]
        speed = np.sqrt(air[0] * air[0] + air[1] * air[1] + air[2] * air[2])
        force: FloatArray = air * (self.airframe.linear_drag + self.airframe.quadratic_drag * speed)
        return force

    def _freeze(self, fresh: FloatArray) -> None:
        """Freeze diverged worlds at their last valid state; the others continue."""
        sane = (np.abs(fresh) < _LIMITS).all(axis=0)
        self._state[:, sane] = fresh[:, sane]
        self._diverged |= ~sane
        self._qpos[~sane] = self._state[:7, ~sane].T
        self._qvel[~sane] = self._state[7:, ~sane].T

    @property
    def position(self) -> Vectors:
        """(worlds, 3), world, m."""
        return self._state[:3].T.copy()

    @property
    def velocity(self) -> Vectors:
        """(worlds, 3), world, m/s."""
        return self._state[7:10].T.copy()

    @property
    def heading_velocity(self) -> Vectors:
        """(worlds, 3), heading frame, m/s."""
        return world_to_heading(self.velocity, self.yaw)

    @property
    def quaternion(self) -> Quaternions:
        """(worlds, 4), w, x, y, z, body to world."""
        return self._state[3:7].T.copy()

    @property
    def body_rates(self) -> Vectors:
        """(worlds, 3), body FLU, rad/s."""
        return self._state[10:].T.copy()

    @property
    def yaw(self) -> Scalars:
        """(worlds,), heading, rad."""
        return yaw_of(self.quaternion)

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """(worlds,): whether the state diverged; such a world is frozen until its next reset."""
        return self._diverged.copy()

    def state(self, world: int) -> DroneState:
        """The true state of one drone."""
        column = self._state[:, world].copy()
        return DroneState(column[:3], column[7:10], column[3:7], column[10:])
