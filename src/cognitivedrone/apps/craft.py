"""What can be flown, behind one interface: the simulator on the wall clock, or a vehicle over MAVLink."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from cognitivedrone.apps.values import Ending, Status
from cognitivedrone.envs.drone import PacedDrone, SimulatedDrone
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.frames import yaw_of
from cognitivedrone.interfaces import Clock, Drone
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks.matching import asks_the_same
from cognitivedrone.types import GroundTruth, StageResult
from cognitivedrone.vehicles.camera import Camera, Shot
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone
from cognitivedrone.vehicles.mavlink.client.preflight import Checklist

Confirm = Callable[[Checklist], bool]
"""Shows the checklist, and tells whether to fly."""


class ClockedDrone(Drone, Clock, Protocol):
    """A drone with the clock that it is flown by."""


@dataclass(frozen=True, slots=True)
class Scene:
    """The stage of a simulated flight."""

    index: int
    """Which stage of the track."""
    truth: GroundTruth


class Craft(Protocol):
    """Something to fly, from the ground to the ground."""

    @property
    def simulated(self) -> bool:
        """Whether it is certain that nobody can be hurt."""
        ...

    def take_off(self, confirm: Confirm) -> ClockedDrone:
        """Get into the air; its clock begins."""
        ...

    def scene(self) -> Scene | None:
        """The stage at hand, where the truth about it is known."""
        ...

    def status(self) -> Status:
        """How it is doing now."""
        ...

    def ending(self) -> Ending | None:
        """Why the flight is over, once it is, as far as the craft itself can tell."""
        ...

    def out_of_time(self, seconds: float) -> Ending:
        """What it means that the time limit is reached."""
        ...

    def land(self) -> bool:
        """Bring it down, wherever it is, if it is ours; whether it stands on the ground then."""
        ...

    def close(self) -> None:
        """Land, and let go of everything."""
        ...


class SimulatedCraft:
    """One world of the simulator, flown in real time through the stages of a track that has begun.

    `own_words` tells the user's own instruction, "" where the scene's is flown. Where it asks for something else than
    the scene does, nobody but the user knows which gate is right.
    """

    def __init__(self, simulator: Simulator, track_runner: TrackRunner, own_words: Callable[[], str]) -> None:
        self._simulator = simulator
        self._track_runner = track_runner
        self._own_words = own_words

    @property
    def simulated(self) -> bool:
        """It is."""
        return True

    def take_off(self, confirm: Confirm) -> ClockedDrone:  # noqa: ARG002
        """It hovers at the start; nobody needs to confirm that."""
        return PacedDrone(SimulatedDrone(self._simulator, self._track_runner))

    def scene(self) -> Scene:
        """The stage at hand."""
        return Scene(self._track_runner.index, self._track_runner.truth())

    def status(self) -> Status:
        """Where it is; everything else is well in a simulation."""
        state = self._simulator.state(self._track_runner.world)
        return Status(position=state.position.copy(), yaw=float(yaw_of(state.quaternion)), mode="simulated")

    def ending(self) -> Ending | None:
        """Over with the last stage, or where a stage ended otherwise than by a gate."""
        if not self._track_runner.finished:
            return None
        own_words = self._own_words()
        flown = [
            (result, not own_words or asks_the_same(own_words, task))
            for result, task in zip(self._track_runner.results, self._track_runner.track, strict=True)
            if result.outcome != "not_reached"
        ]
        told = "; ".join(_told(result, judged=judged) for result, judged in flown)
        if any(result.outcome != "passed" and (judged or result.outcome != "wrong_gate") for result, judged in flown):
            return Ending("missed", told)
        return Ending("passed" if all(judged for _, judged in flown) else "flown", told)

    def out_of_time(self, seconds: float) -> Ending:
        """No gate was passed in time."""
        return Ending("missed", f"the time limit of {seconds:g} s is over")

    def land(self) -> bool:
        """A simulation ends in the air."""
        return False

    def close(self) -> None:
        """Free the renderer."""
        self._simulator.close()


class MavlinkCraft:
    """A vehicle over MAVLink; of a simulated one the scene may be known. `undo` is called after it has landed."""

    def __init__(
        self,
        drone: MavlinkDrone,
        eyes: TimestampedCamera,
        *,
        simulated: bool,
        scene: Scene | None = None,
        undo: Callable[[], None] = lambda: None,
    ) -> None:
        self._drone = drone
        self._eyes = eyes
        self._simulated = simulated
        self._scene = scene
        self._undo = undo

    @property
    def simulated(self) -> bool:
        """Whether it is known to be."""
        return self._simulated

    def take_off(self, confirm: Confirm) -> ClockedDrone:
        """Check, have it confirmed, arm and climb."""
        self._drone.take_off(confirm)
        return self._drone

    def scene(self) -> Scene | None:
        """The stage, where it is known."""
        return self._scene

    def status(self) -> Status:
        """What the vehicle says, and the guard."""
        told, decision = self._drone.telemetry, self._drone.decision
        now = time.monotonic()
        return Status(
            position=told.position.copy(),
            yaw=told.yaw,
            mode=told.mode,
            armed=told.armed,
            battery=told.battery,
            frame_age_s=now - self._eyes.seen_at,
            link_age_s=now - told.heard_at,
            decision=decision.kind if decision is not None else "fly",
            reason=decision.reason if decision is not None else "",
        )

    def ending(self) -> Ending | None:
        """Over where the rules of safety land it, or where it was taken over."""
        why = self._drone.over
        return None if why is None else Ending("vehicle", why)

    def out_of_time(self, seconds: float) -> Ending:
        """As it was meant: nobody judges a real flight."""
        return Ending("time", f"the time limit of {seconds:g} s is over")

    def land(self) -> bool:
        """Land it where it is."""
        self._drone.land()
        return not self._drone.telemetry.armed

    def close(self) -> None:
        """Land it, and hang up."""
        try:
            self._drone.close()
        finally:
            self._undo()


class TimestampedCamera:
    """A camera that remembers when its last frame that was looked at came."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self.seen_at = time.monotonic()
        """Of `time.monotonic`, s."""

    def read(self) -> Shot:
        """The newest frame."""
        shot = self._camera.read()
        self.seen_at = shot.time
        return shot

    def close(self) -> None:
        """Let go of the source."""
        self._camera.close()


def _told(result: StageResult, *, judged: bool) -> str:
    """How a stage ended, in words."""
    if not judged and result.chosen is not None and result.outcome in ("passed", "wrong_gate"):
        return f"flew through gate {result.chosen + 1} (not judged), after {result.time_s:.1f} s"
    gate = "no gate" if result.chosen is None else f"gate {result.chosen + 1}"
    how = {
        "passed": f"through {gate}",
        "wrong_gate": f"through {gate}, the right one was {result.target + 1}",
        "collision": f"collided, flying at {gate}",
        "missed": f"flew past the gates, at {gate}",
        "out_of_bounds": f"left the stage, flying at {gate}",
        "invalid": "the physics diverged",
    }.get(result.outcome, result.outcome)
    return f"{how}, after {result.time_s:.1f} s"
