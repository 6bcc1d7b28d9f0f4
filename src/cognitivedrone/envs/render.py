"""What `render` of the Gymnasium environment shows: the drone's own view, or one from behind it."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

from cognitivedrone.envs.track_runner import TrackRunner, scenery_of
from cognitivedrone.errors import SimulationError, did_you_mean
from cognitivedrone.sim.airframe import Airframe
from cognitivedrone.sim.drawing.chase import LIVE_SIZE, ChaseView
from cognitivedrone.types import CONTROL_HZ, Image, Stage

Camera: TypeAlias = Literal["drone", "chase"]
CAMERAS: tuple[Camera, ...] = get_args(Camera)


class TaskView:
    """Shows the current stage of a `TrackRunner`; the chase view is made when it is first needed.

    Raises `SimulationError` for an unknown camera or mode.
    """

    def __init__(self, mode: str | None, camera: Camera, airframe: Airframe) -> None:
        if camera not in CAMERAS:
            raise SimulationError(f"unknown camera {camera!r}; {did_you_mean(str(camera), CAMERAS)}")
        if mode not in (None, "rgb_array"):
            way = 'gymnasium.make(..., render_mode="human") opens a window' if mode == "human" else "known: rgb_array"
            raise SimulationError(f"render_mode is {mode!r}, but the environment itself renders arrays; {way}")
        self._camera, self._airframe = camera, airframe
        self._chase: ChaseView | None = None
        self._stage: Stage | None = None

    def cut(self) -> None:
        """A new flight begins: move the camera there at once."""
        if self._chase is not None:
            self._chase.cut()

    def image(self, track: TrackRunner) -> Image:
        """(256, 256, 3) first-person, or (360, 640, 3) from behind; call it once a control period."""
        if self._camera == "drone":
            return track.world.frame()
        scenery = scenery_of(track.stage, track.labels, track.appearance)
        if self._chase is None:
            self._chase = ChaseView(track.stage, scenery, *LIVE_SIZE, airframe=self._airframe, samples=4)
        elif self._stage is not track.stage:
            self._chase.place(track.stage, scenery)
        self._stage, state = track.stage, track.world.state()
        return self._chase.frame(state.position, state.quaternion, 1 / CONTROL_HZ, track.world.time())

    def close(self) -> None:
        """Free the renderer."""
        if self._chase is not None:
            self._chase.close()
