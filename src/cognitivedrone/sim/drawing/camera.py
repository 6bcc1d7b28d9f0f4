"""Off-screen rendering with MuJoCo: the drone's first-person camera and third-person views.

One `Cameras` serves many worlds. A world is a slot: `set_stage` fills it once, in place; after that, a frame only sets
a camera and draws. The picture of a slot depends only on its stage, its look and the pose: not on earlier frames,
on the other slots, or on the number of threads.
"""

from __future__ import annotations

import weakref
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import wait
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image as PillowImage

from cognitivedrone.errors import RenderError
from cognitivedrone.frames import rotation_matrix
from cognitivedrone.sim.drawing.gl import GLThread, enlarge_only, renderer_name
from cognitivedrone.sim.drawing.readback import OneByOne, readback
from cognitivedrone.sim.drawing.renderers import contexts_for, on_processor
from cognitivedrone.sim.drawing.views import DOWN_MOUNT, FIELD_OF_VIEW, MOUNT, View, focal_length, top_view
from cognitivedrone.types import IMAGE_SIZE, DroneState, FloatArray, Image, Images, Stage, Vector, Vectors
from cognitivedrone.world.appearance import PLAIN, Appearance, expose
from cognitivedrone.world.assets import BOARD, MAX_SLOTS, build_assets, write_picture, write_place
from cognitivedrone.world.engine import mujoco
from cognitivedrone.world.places import names
from cognitivedrone.world.scene import Movers, add_drone, fill_scene, move, new_scene

_NEAR, FAR_M = 0.03, 200.0
_TOP_DRONE_SCALE = 3.0
_SUPERSAMPLE = 2  # third-person views are drawn this many times larger and downsampled, for smooth edges


class Cameras:
    """The cameras of `slots` worlds. Use it as a context manager, or call `close`.

    Up to `threads` renderers share the slots, each with its own OpenGL context and thread: as many as pay off with
    what draws, or `contexts` of them. Raises `RenderError` without OpenGL.
    """

    def __init__(
        self, slots: int = 1, size: int = IMAGE_SIZE, *, threads: int = 1, contexts: int | None = None
    ) -> None:
        if not 1 <= threads <= slots:
            raise ValueError(f"threads must be 1 to the number of slots ({slots}), not {threads}")
        if -(-slots // threads) > MAX_SLOTS:
            raise ValueError(f"{slots} slots are too many: at most {MAX_SLOTS} a thread")
        self.slots = slots
        self.size = size
        self._threads: list[GLThread] = []
        self._renderers: list[_Renderer] = []
        self._finalizer = weakref.finalize(self, _close, self._threads, self._renderers)
        self._finalizer.atexit = False  # GLThread handles it, in the right order
        renderer = renderer_name()
        threads = contexts or contexts_for(renderer, slots, threads, MAX_SLOTS)
        for index in range(threads):
            thread = GLThread(size, size, display=index % 2)
            self._threads.append(thread)
            owned = len(range(index, slots, threads))
            self._renderers.append(thread.keep(thread.call(partial(_Renderer, owned, size, renderer)).result()))
        if not on_processor(renderer):
            for thread, made in zip(self._threads, self._renderers, strict=True):
                thread.first(made.first_frame)

    def __enter__(self) -> Cameras:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL contexts; may be called repeatedly."""
        self._finalizer()

    def set_stage(
        self,
        slot: int,
        stage: Stage,
        images: Sequence[NDArray[np.uint8]],
        board: NDArray[np.uint8] | None = None,
        appearance: Appearance = PLAIN,
    ) -> None:
        """Show `stage` in `slot`, with the label `images` (h, w, 3) of gates 1 to 3, and a board if given."""
        if len(images) != 3:
            raise ValueError(f"a stage has three labels, not {len(images)}")
        thread, renderer, own = self._owner(slot)
        thread.call(partial(renderer.set_stage, own, stage, images, board, appearance)).result()

    def first_person(
        self,
        positions: ArrayLike,
        quaternions: ArrayLike,
        out: Images | None = None,
        slots: Sequence[int] | None = None,
        yaw_rates: ArrayLike | None = None,
        times: ArrayLike | None = None,
        *,
        down: bool = False,
        depth: FloatArray | None = None,
    ) -> Images:
        """First-person images (n, size, size, 3) uint8 of drones at `positions` (n, 3) world m, attitudes (n, 4) wxyz.

        Image i shows the world of `slots[i]`, or of slot i without `slots`. A slot may occur several times.
        The result is written into `out` if given. `yaw_rates` (n,) rad/s blur the pictures of appearances with an
        exposure. `times` (n,) s since each flight began say where moving obstacles are. `down` takes the camera under
        the drone instead. `depth` (n, size, size) float32 is filled with how far ahead of the camera what it shows is,
        m, at most `FAR_M`.
        """
        position = np.asarray(positions, dtype=np.float64)
        axes = rotation_matrix(np.asarray(quaternions, dtype=np.float64))
        count = len(position)
        if position.shape != (count, 3) or axes.shape != (count, 3, 3):
            got = f"{np.shape(positions)} and {np.shape(quaternions)}"
            raise ValueError(f"expected positions (n, 3) and quaternions (n, 4), not {got}")
        shown = range(count) if slots is None else slots
        if len(shown) != count:
            raise ValueError(f"{count} positions but {len(shown)} slots")
        shape = (count, self.size, self.size, 3)
        if out is None:
            out = np.empty(shape, np.uint8)
        elif out.shape != shape or out.dtype != np.uint8:
            raise ValueError(f"out must be uint8 {shape}, not {out.dtype} {out.shape}")
        ahead, above = axes[..., 0], axes[..., 2]
        mount = DOWN_MOUNT if down else MOUNT
        eye = position + mount[0] * ahead + mount[1] * axes[..., 1] + mount[2] * above
        forward, up = (-above, ahead) if down else (ahead, above)
        rates = np.zeros(count) if yaw_rates is None else np.asarray(yaw_rates, dtype=np.float64)
        blur = np.abs(rates) * focal_length(self.size, FIELD_OF_VIEW)
        clock = np.zeros(count) if times is None else np.asarray(times, dtype=np.float64)
        jobs: list[list[tuple[int, int]]] = [[] for _ in self._threads]
        for index, slot in enumerate(shown):
            self._check(slot)
            jobs[slot % len(jobs)].append((index, slot // len(jobs)))
        pending = [
            thread.call(partial(renderer.first_person, job, eye, forward, up, out, blur, clock, depth))
            for thread, renderer, job in zip(self._threads, self._renderers, jobs, strict=True)
            if job
        ]
        wait(pending)  # all of them, so that nothing writes into `out` after an error
        for future in pending:
            future.result()
        return out

    def top(self, slot: int, state: DroneState, size: tuple[int, int] = (640, 480)) -> Image:
        """The whole stage from high above its start, with the drone at three times its size: (h, w, 3)."""
        thread, renderer, own = self._owner(slot)

        def draw() -> Image:
            return renderer.overlook(own, state, _TOP_DRONE_SCALE, size, top_view(renderer.stage(own)))

        return thread.call(draw).result()

    def _check(self, slot: int) -> None:
        if not self._finalizer.alive:
            raise RenderError("these cameras are closed; make new ones.")
        if not 0 <= slot < self.slots:
            raise ValueError(f"slot must be 0 to {self.slots - 1}, not {slot}")

    def _owner(self, slot: int) -> tuple[GLThread, _Renderer, int]:
        """The thread and renderer of a slot, and its number within the renderer."""
        self._check(slot)
        index = slot % len(self._threads)
        return self._threads[index], self._renderers[index], slot // len(self._threads)


class _Renderer:
    """The slots of one OpenGL context. Created and used only in that context's thread."""

    def __init__(self, slots: int, size: int, renderer: str) -> None:
        self._size = size
        self._assets = build_assets(slots, size)
        self._context = mujoco.MjrContext(self._assets.model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scenes = [new_scene(self._assets) for _ in range(slots)]
        self._stages: list[Stage | None] = [None] * slots
        self._looks: list[Appearance] = [PLAIN] * slots
        self._movers: list[Movers | None] = [None] * slots
        self._places: dict[str, int] = {}  # the texture that each place is in
        self._viewport = mujoco.MjrRect(0, 0, size, size)
        self._readback = readback(renderer, self._context, size, size)

    def first_frame(self) -> None:
        """Draw and read a frame of nothing, to see whether it comes."""
        mujoco.mjr_render(self._viewport, self._scenes[0], self._context)
        list(self._readback.frames([0], np.empty((1, self._size, self._size, 3), np.uint8)))

    def stage(self, slot: int) -> Stage:
        stage = self._stages[slot]
        if stage is None:
            raise RenderError("this slot shows no stage yet; call set_stage first.")
        return stage

    def set_stage(
        self,
        slot: int,
        stage: Stage,
        images: Sequence[NDArray[np.uint8]],
        board: NDArray[np.uint8] | None,
        appearance: Appearance,
    ) -> None:
        pictures = dict(enumerate(images)) | ({} if board is None else {BOARD: board})
        for picture, image in pictures.items():
            texture = write_picture(self._assets, slot, picture, image)
            mujoco.mjr_uploadTexture(self._assets.model, self._context, texture)
        place, scene = self._texture_of(appearance.place, slot), self._scenes[slot]
        aspects, board_aspect = [_aspect(image) for image in images], None if board is None else _aspect(board)
        self._movers[slot] = fill_scene(scene, self._assets, slot, stage, aspects, board_aspect, appearance, place)
        _set_lens(scene, FIELD_OF_VIEW)
        self._stages[slot], self._looks[slot] = stage, appearance

    def _texture_of(self, place: str, slot: int) -> int:
        """The texture that has the panorama of a place for `slot`, filled if need be; -1 for no place."""
        if not place or place in self._places:
            return self._places.get(place, -1)
        shown = {look.place for other, look in enumerate(self._looks) if other != slot} & self._places.keys()
        own = place not in names()
        if own and (others := shown - {*names()}):
            raise RenderError(f"only one place of your own is drawn at a time: {min(others)} and {place} are two")
        free = [self._assets.own_place] if own else sorted({*self._assets.places} - {self._places[p] for p in shown})
        texture = min(free, key=lambda each: each in self._places.values())  # an empty one first
        self._places = {name: held for name, held in self._places.items() if held != texture} | {place: texture}
        write_place(self._assets, texture, place)
        mujoco.mjr_uploadTexture(self._assets.model, self._context, texture)
        enlarge_only(self._context, texture)
        return texture

    def first_person(
        self,
        job: list[tuple[int, int]],
        eye: Vectors,
        forward: Vectors,
        up: Vectors,
        out: Images,
        blur: FloatArray,
        times: FloatArray,
        depth: FloatArray | None,
    ) -> None:
        """Render (index, slot) pairs of `job` into `out[index]`, and `depth[index]` if given."""
        slots = dict(job)

        def drawn() -> Iterator[int]:
            for index, slot in job:
                self.stage(slot)
                if (movers := self._movers[slot]) is not None:
                    move(self._scenes[slot], movers, float(times[index]))
                _aim(self._scenes[slot], eye[index], forward[index], up[index])
                mujoco.mjr_render(self._viewport, self._scenes[slot], self._context)
                if depth is not None:
                    depth[index] = self._depth()
                yield index

        for index in self._readback.frames(drawn(), out):
            appearance = self._looks[slots[index]]
            pose = np.concatenate([eye[index], forward[index], up[index]])
            expose(out[index], appearance, zlib.crc32(pose.tobytes()), appearance.exposure_s * blur[index])

    def _depth(self) -> FloatArray:
        """(size, size), m, of the frame that was drawn last: OpenGL's depth is 0 at the near plane, 1 at the far."""
        rows = np.empty((self._size, self._size), np.float32)
        mujoco.mjr_readPixels(None, rows, self._viewport, self._context)
        meters: FloatArray = _NEAR * FAR_M / (FAR_M - rows[::-1] * (FAR_M - _NEAR))
        return meters

    def overlook(self, slot: int, state: DroneState, scale: float, size: tuple[int, int], view: View) -> Image:
        """A third-person view, including the drone: (h, w, 3)."""
        self.stage(slot)
        scene = self._scenes[slot]
        width, height = (_SUPERSAMPLE * side for side in size)
        stage_geoms = scene.ngeom
        pixels = np.empty((height, width, 3), np.uint8)
        add_drone(scene, state, scale)
        _set_lens(scene, view.field_of_view)
        _aim(scene, view.eye, view.forward, view.up)
        mujoco.mjr_resizeOffscreen(width, height, self._context)
        try:
            mujoco.mjr_render(mujoco.MjrRect(0, 0, width, height), scene, self._context)
            OneByOne(self._context, width, height).read(pixels)
        finally:
            mujoco.mjr_resizeOffscreen(self._size, self._size, self._context)
            scene.ngeom = stage_geoms
            _set_lens(scene, FIELD_OF_VIEW)
        return np.array(PillowImage.fromarray(pixels).reduce(_SUPERSAMPLE))

    def free(self) -> None:
        self._context.free()


def _set_lens(scene: Any, field_of_view: float) -> None:
    """Set the vertical field of view, rad; MuJoCo derives the horizontal one from the viewport's aspect ratio."""
    half = _NEAR * float(np.tan(field_of_view / 2))
    for camera in scene.camera:
        camera.orthographic = 0
        camera.frustum_center = camera.frustum_width = 0.0
        camera.frustum_bottom, camera.frustum_top = -half, half
        camera.frustum_near, camera.frustum_far = _NEAR, FAR_M


def _aim(scene: Any, eye: Vector, forward: Vector, up: Vector) -> None:
    # Two cameras because MuJoCo can draw in stereo; a single view averages them.
    for camera in scene.camera:
        camera.pos = eye
        camera.forward = forward
        camera.up = up


def _aspect(image: NDArray[np.uint8]) -> float:
    return float(image.shape[1] / image.shape[0])


def _close(threads: list[GLThread], renderers: list[_Renderer]) -> None:
    for thread, renderer in zip(threads, renderers, strict=False):
        thread.release(renderer)
    renderers.clear()
    for thread in threads:
        thread.stop()
