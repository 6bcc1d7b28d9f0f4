"""A view of the flight for people: the drone from behind and above, with shadows, sky and smooth edges.

It has its own MuJoCo model and its own OpenGL context and thread, apart from the policy's `Cameras`: what a policy
sees is the same with or without it.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from cognitivedrone.errors import RenderError
from cognitivedrone.frames import quaternion_from_yaw, rotate_yaw, wrap_angle, yaw_of
from cognitivedrone.sim.airframe import RACER, ROTORS, Airframe
from cognitivedrone.sim.drawing.gl import GLThread
from cognitivedrone.sim.drawing.readback import OneByOne
from cognitivedrone.sim.drawing.views import View
from cognitivedrone.sim.simulator import Scenery
from cognitivedrone.types import COLORS, FloatArray, Image, Quaternion, Stage, Vector
from cognitivedrone.world import assets, geometry, places
from cognitivedrone.world.appearance import Appearance
from cognitivedrone.world.engine import mujoco
from cognitivedrone.world.scene import OBSTACLE_COLORS

LIVE_SIZE: Final = (640, 360)
"""Width and height for a live view beside a flight on two cores; `benchmarks/chase.py` measures the cost."""
FILM_SIZE: Final = (1280, 720)
"""Width and height for films."""
_FIELD_OF_VIEW_DEG: Final = 62.0  # vertical
_DISTANCE_M, _ELEVATION_DEG = 1.75, -9.5  # of the camera from the point that it looks at, and of its view
_AHEAD_M, _ABOVE_M = 0.6, 0.38  # from the drone to the point that the camera looks at
_FOLLOW_S, _TURN_S = 0.12, 0.45  # time constants of the camera's position and heading
_LOWEST_M: Final = 0.15  # camera above the floor
_ZENITH, _HORIZON, _FLOOR, _GROUT = (0.36, 0.56, 0.86), (0.72, 0.81, 0.93), (0.80, 0.82, 0.85), (0.62, 0.65, 0.70)
_EXTENT_M: Final = 10.0  # MuJoCo's unit of length of a scene
_FLOOR_SCALE: Final = 3.0  # of the policy's floor, which ends in sight
_SUN: Final = (0.95, -0.25, -1.0)  # direction of the light
_SHADOW: Final = (0.10, 0.12, 0.18, 0.42)
_ALL_GLOW: Final = 1.0  # emission, as a share of the colour
_SHADOWLESS: Final = 1  # group of geoms that cast no shadow: too small, or not solid
_SHADOW_M: Final = 0.004  # above the floor
_TO_FLOOR: Final = np.array([[1.0, 0.0, -_SUN[0] / _SUN[2]], [0.0, 1.0, -_SUN[1] / _SUN[2]], [0.0, 0.0, 1e-4]])
"""Projects along the light; the last row is not zero, since normals need a matrix that has an inverse."""
_CARBON, _METAL, _FRONT, _REAR = (0.10, 0.10, 0.12), (0.45, 0.47, 0.52), (1.0, 0.45, 0.05), (0.30, 0.33, 0.40)
_SPIN_RAD_S: Final = 47.0  # as drawn; real rotors turn too fast for any frame rate
_BLADES: Final = 2


class ChaseView:
    """A chase camera at one drone in a stage. Use it as a context manager, or call `close`.

    `samples` of a pixel smooth its edges: by default 4, but none up to `LIVE_SIZE`, where they triple the cost.
    Not safe for calls from several threads at a time. Raises `RenderError` without OpenGL.
    """

    def __init__(
        self,
        stage: Stage,
        scenery: Scenery,
        width: int = FILM_SIZE[0],
        height: int = FILM_SIZE[1],
        *,
        airframe: Airframe = RACER,
        samples: int | None = None,
    ) -> None:
        self.size = (width, height)
        self._airframe = airframe
        self._samples = (0 if width <= LIVE_SIZE[0] else 4) if samples is None else samples
        # The second display: llvmpipe draws for one context per display at a time, and the policy's is the first.
        self._thread = GLThread(width, height, display=1)
        self._renderer: _Renderer | None = None
        self._finalizer = weakref.finalize(self, self._thread.stop)
        self._finalizer.atexit = False  # GLThread handles it
        self._eye: FloatArray | None = None
        self._yaw = 0.0
        self._spin = 0.0
        self.place(stage, scenery)

    def __enter__(self) -> ChaseView:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL context; may be called repeatedly."""
        if self._finalizer.alive and self._renderer is not None:
            self._thread.release(self._renderer)
            self._renderer = None
        self._finalizer()

    def place(self, stage: Stage, scenery: Scenery) -> None:
        """Show another stage; the camera moves on smoothly."""
        if not self._finalizer.alive:
            raise RenderError("this view is closed; make a new one.")
        made = partial(_Renderer, stage, scenery, self.size, self._airframe, self._samples)
        if self._renderer is not None:
            self._thread.release(self._renderer)
        self._renderer = self._thread.keep(self._thread.call(made).result())

    def cut(self) -> None:
        """Begin the next frame behind the drone, wherever the camera is now: for a new flight."""
        self._eye = None

    def frame(self, position: ArrayLike, quaternion: ArrayLike, seconds: float = 0.05, time: float = 0.0) -> Image:
        """The drone at `position` (3,) world m with attitude (4,) wxyz: (height, width, 3) uint8 RGB.

        `seconds` have passed since the previous frame; the camera follows smoothly. Moving obstacles are where they are
        at `time`, s since the flight began.
        """
        if self._renderer is None:
            raise RenderError("this view is closed; make a new one.")
        place, attitude = np.asarray(position, dtype=np.float64), np.asarray(quaternion, dtype=np.float64)
        eye = self._follow(place, float(yaw_of(attitude)), seconds)
        draw = partial(self._renderer.draw, place, attitude, eye, self._yaw, self._spin, time)
        return self._thread.call(draw).result()

    @property
    def view(self) -> View:
        """The camera of the last frame; raises `RenderError` before the first."""
        if self._eye is None:
            raise RenderError("this view has drawn no frame since its last cut; call frame first.")
        target, elevation = _aim(self._eye, self._yaw)
        level = rotate_yaw(np.array([1.0, 0.0, 0.0]), self._yaw)
        up = np.array([0.0, 0.0, 1.0])
        forward = math.cos(elevation) * level + math.sin(elevation) * up
        upward = math.cos(elevation) * up - math.sin(elevation) * level
        return View(target - _DISTANCE_M * forward, forward, upward, math.radians(_FIELD_OF_VIEW_DEG))

    def _follow(self, place: Vector, yaw: float, seconds: float) -> Vector:
        """Move the camera's target and heading towards the drone's, with first-order lags; returns the target (3,)."""
        if self._eye is None:
            self._eye, self._yaw = place, yaw
        self._eye = eye = self._eye + (place - self._eye) * -math.expm1(-seconds / _FOLLOW_S)
        self._yaw += float(wrap_angle(yaw - self._yaw)) * -math.expm1(-seconds / _TURN_S)
        self._spin = (self._spin + _SPIN_RAD_S * seconds) % (2 * math.pi)
        return eye


def _aim(eye: Vector, yaw: float) -> tuple[Vector, float]:
    """The point (3,) that the camera looks at, m, and its elevation, rad, for a drone at `eye`."""
    target = eye + rotate_yaw(np.array([_AHEAD_M, 0.0, _ABOVE_M]), yaw)
    sine = max((_LOWEST_M - target[2]) / _DISTANCE_M, math.sin(math.radians(-_ELEVATION_DEG)))
    return target, -math.asin(sine)


class _Renderer:
    """Model and buffers of one stage. Created and used only in the thread of its context."""

    def __init__(self, stage: Stage, scenery: Scenery, size: tuple[int, int], airframe: Airframe, samples: int) -> None:
        self._width, self._height = size
        self._model = _model(stage, scenery, size, airframe, samples)
        self._data = mujoco.MjData(self._model)
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scene = mujoco.MjvScene(self._model, maxgeom=300)
        self._scene.flags[:] = 0
        for flag in ("SKYBOX", "CULL_FACE"):
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 1
        self._options = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._readback = OneByOne(self._context, self._width, self._height)
        self._rotors = [self._model.body(f"rotor{index}").mocapid[0] for index in range(len(ROTORS))]
        self._hubs = _hubs(airframe)
        moving = geometry.moving_parts(stage)
        self._movers = [self._model.geom(name) for name in moving[0]] if moving else []
        self._middles = np.array([geom.pos for geom in self._movers])
        self._motion = moving[1] if moving else None

    def draw(self, place: Vector, attitude: Quaternion, eye: Vector, yaw: float, spin: float, time: float) -> Image:
        """One frame; `eye` is the smoothed place of the drone, `yaw` the camera's heading."""
        data, camera = self._data, self._camera
        if self._motion is not None:
            for geom, pos in zip(self._movers, self._middles + self._motion.offset(time), strict=True):
                geom.pos = pos
        drone = self._model.body("drone").mocapid[0]
        data.mocap_pos[drone], data.mocap_quat[drone] = place, attitude
        turned, hub = np.empty(4), np.empty(3)
        for mocap, offset, (_, _, direction) in zip(self._rotors, self._hubs, ROTORS, strict=True):
            mujoco.mju_rotVecQuat(hub, offset, attitude)
            mujoco.mju_mulQuat(turned, attitude, quaternion_from_yaw(-direction * spin))
            data.mocap_pos[mocap], data.mocap_quat[mocap] = place + hub, turned
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)
        target, elevation = _aim(eye, yaw)
        camera.lookat[:] = target
        camera.distance, camera.azimuth, camera.elevation = _DISTANCE_M, math.degrees(yaw), math.degrees(elevation)
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        _add_shadows(self._scene, self._model)
        viewport = mujoco.MjrRect(0, 0, self._width, self._height)
        mujoco.mjr_render(viewport, self._scene, self._context)
        frame = np.empty((self._height, self._width, 3), np.uint8)
        self._readback.read(frame)
        return frame

    def free(self) -> None:
        self._context.free()


def _add_shadows(scene: Any, model: Any) -> None:
    """Add what everything in the scene casts on the floor: its geoms, flattened along the light.

    On one plane this looks like shadow mapping, at a tenth of its cost on a CPU, and with smooth edges.
    """
    for index in range(scene.ngeom):
        geom = scene.geoms[index]
        if model.geom_group[geom.objid] == _SHADOWLESS:
            continue
        shadow = scene.geoms[scene.ngeom]
        place = _TO_FLOOR @ geom.pos + [0.0, 0.0, _SHADOW_M]
        axes = (_TO_FLOOR @ geom.mat).reshape(-1)
        color = np.array([*_SHADOW[:3], _SHADOW[3] * min(1.0, 2 * geom.rgba[3])], np.float32)
        mujoco.mjv_initGeom(shadow, geom.type, geom.size, place, axes, color)
        shadow.dataid, shadow.matid, shadow.objid, shadow.category = geom.dataid, -1, -1, geom.category
        shadow.emission = shadow.specular = 0.0
        scene.ngeom += 1


def _model(stage: Stage, scenery: Scenery, size: tuple[int, int], airframe: Airframe, samples: int) -> Any:
    """The `mujoco.MjModel` of a stage, a floor under a sky, and a drone of free pose."""
    spec = mujoco.MjSpec()
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = size
    visual.global_.fovy = _FIELD_OF_VIEW_DEG
    visual.quality.offsamples = samples
    visual.quality.shadowsize = 0
    visual.quality.numslices, visual.quality.numstacks, visual.quality.numquads = 16, 8, 1
    visual.headlight.ambient = [0.52] * 3
    visual.headlight.diffuse = [0.18] * 3
    visual.headlight.specular = [0.0] * 3
    visual.map.znear, visual.map.zfar = 0.005, 20.0
    spec.stat.extent, spec.stat.center = _EXTENT_M, [0.0, 0.0, 1.0]
    if scenery.appearance.place:
        _add_place(spec, stage, scenery.appearance)
    else:
        _add_floor_and_sky(spec, stage)
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=_SUN,
        castshadow=False,
        diffuse=[0.62] * 3,
        ambient=[0.0] * 3,
        specular=[0.3] * 3,
    )
    _add_stage(spec, stage, scenery)
    _add_drone(spec, airframe)
    return spec.compile()


def _add_place(spec: Any, stage: Stage, appearance: Appearance) -> None:
    """The place around the stage, where the policy's scene has it."""
    pixels = places.load_place(appearance.place).pixels
    texture = assets.add_texture(spec, "place", pixels.shape[1], pixels.shape[0])
    texture.data = pixels.tobytes()
    material = spec.material("place")
    material.rgba = [*(appearance.place_brightness,) * 3, 1.0]
    material.emission, material.specular = _ALL_GLOW, 0.0
    assets.add_mesh(spec, "place", *places.mesh())
    _add_placed(
        spec, "place", "place", np.array([*stage.origin, 0.0]), stage.yaw + appearance.place_turn, group=_SHADOWLESS
    )


def _add_floor_and_sky(spec: Any, stage: Stage) -> None:
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=256, height=1536)
    nadir = 2 * np.array(_HORIZON) - _ZENITH  # the horizon is in the middle
    sky.builtin, sky.rgb1, sky.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, _ZENITH, np.minimum(nadir, 1.0)
    tiles = spec.add_texture(name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D, width=512, height=512)
    tiles.builtin, tiles.mark = mujoco.mjtBuiltin.mjBUILTIN_CHECKER, mujoco.mjtMark.mjMARK_EDGE
    tiles.rgb1, tiles.rgb2, tiles.markrgb = _FLOOR, tuple(0.97 * part for part in _FLOOR), _GROUT
    ground = spec.add_material(name="ground", texrepeat=[1.5 * _FLOOR_SCALE] * 2, specular=0.0)
    ground.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    # A mesh: MuJoCo's planes take ten times as long to draw on a CPU.
    assets.add_mesh(spec, "floor", *assets.floor_mesh()).scale = [_FLOOR_SCALE] * 3
    _add_placed(spec, "floor", "ground", np.array([*stage.origin, 0.0]), 0.0, group=_SHADOWLESS)


def _add_stage(spec: Any, stage: Stage, scenery: Scenery) -> None:
    """Gates, panels and board where the policy's scene has them."""
    centers, yaws, panels = geometry.gate_centers(stage), geometry.gate_yaws(stage), geometry.panel_centers(stage)
    for index in geometry.standing(stage):
        gate, name = stage.gates[index], f"gate{index}"
        assets.add_mesh(spec, name, *assets.frame_mesh(gate))
        color = _gate_color(scenery.appearance, COLORS.index(gate.color))
        spec.add_material(name=name, rgba=[*color, 1.0], specular=0.4, shininess=0.6, emission=0.15)
        _add_placed(spec, name, name, centers[index], float(yaws[index]))
    for index in geometry.panelled(stage):
        _add_picture(spec, f"panel{index}", scenery.panels[index], geometry.PANEL_HEIGHT, panels[index], yaws[index])
    for index in geometry.choices(stage) if stage.landing else ():
        color = _gate_color(scenery.appearance, COLORS.index(stage.gates[index].color))
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=centers[index], size=[geometry.PAD_RADIUS, _SHADOW_M / 2, 0.0],
            rgba=[*color, 1.0], group=_SHADOWLESS,
        )  # fmt: skip
    if scenery.board is not None:
        place, yaw, _, height = geometry.board_panel(stage, scenery.board.shape[1] / scenery.board.shape[0])
        _add_picture(spec, "board", scenery.board, height, place, yaw)
    found = geometry.solids(stage)
    for index in range(len(found.yaws) - (stage.landmark is not None)):
        is_round, (depth, width, height) = bool(found.round[index]), found.halves[index]
        spec.worldbody.add_geom(
            name=f"obstacle{index}", type=mujoco.mjtGeom.mjGEOM_CYLINDER if is_round else mujoco.mjtGeom.mjGEOM_BOX,
            pos=found.centers[index], quat=quaternion_from_yaw(found.yaws[index]),
            size=[depth, height, 0.0] if is_round else [depth, width, height],
            rgba=[*OBSTACLE_COLORS[is_round], 1.0],
        )  # fmt: skip


def _gate_color(appearance: Appearance, index: int) -> FloatArray:
    """A gate's colour, softened a little: fully saturated colours show no shading."""
    return 0.04 + 0.9 * np.array(appearance.gate_colors[index])


def _add_picture(spec: Any, name: str, image: Image, height: float, place: Vector, yaw: float) -> None:
    """A panel of `height` m that shows an image."""
    texture = assets.add_texture(spec, name, assets.TEXTURE_SIZE)
    texture.data = assets.square(image).tobytes()
    material = spec.material(name)
    material.emission, material.specular = 0.35, 0.0
    mesh = assets.add_mesh(spec, name, *assets.panel_mesh())
    mesh.scale = [1.0, image.shape[1] / image.shape[0] * height, height]
    _add_placed(spec, name, name, place, float(yaw))


def _add_placed(spec: Any, mesh: str, material: str, place: Vector, yaw: float, group: int = 0) -> None:
    spec.worldbody.add_geom(
        name=mesh, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, material=material, pos=place,
        quat=quaternion_from_yaw(yaw), group=group,
    )  # fmt: skip


def _hubs(airframe: Airframe) -> FloatArray:
    """(4, 3) of the rotors, body FLU, m."""
    side = airframe.rotor_offset
    return np.array([[forward * side, left * side, 0.24 * side] for forward, left, _ in ROTORS])


def _add_drone(spec: Any, airframe: Airframe) -> None:
    """A quadrotor of boxes and cylinders with rotors that turn, the front ones orange; for any size of airframe."""
    box, cylinder, ball = (getattr(mujoco.mjtGeom, f"mjGEOM_{kind}") for kind in ("BOX", "CYLINDER", "ELLIPSOID"))
    for name, color, specular in (("carbon", _CARBON, 0.5), ("metal", _METAL, 0.9), ("lens", (0.02, 0.03, 0.06), 1.0)):
        spec.add_material(name=name, rgba=[*color, 1.0], specular=specular, shininess=0.7)
    for name, color in (("front", _FRONT), ("rear", _REAR)):
        spec.add_material(name=name, rgba=[*color, 1.0], emission=0.3, specular=0.2)
        spec.add_material(name=f"{name} disk", rgba=[*color, 0.28], emission=0.4, specular=0.0)
    side = airframe.rotor_offset
    body = spec.worldbody.add_body(name="drone", mocap=True)

    def add(
        kind: Any,
        size: Sequence[float],
        place: Sequence[float],
        material: str,
        yaw: float = 0.0,
        *,
        shadow: bool = False,
    ) -> None:
        body.add_geom(
            type=kind, size=side * np.array(size), pos=side * np.array(place), material=material,
            quat=quaternion_from_yaw(yaw), group=0 if shadow else _SHADOWLESS,
        )  # fmt: skip

    add(ball, (0.62, 0.34, 0.22), (0.0, 0.0, 0.05), "carbon", shadow=True)
    add(box, (0.34, 0.20, 0.10), (-0.12, 0.0, 0.24), "metal")  # battery
    add(ball, (0.12, 0.12, 0.12), (0.60, 0.0, 0.08), "lens")
    for turn in (math.pi / 4, -math.pi / 4):
        add(box, (math.sqrt(2.0), 0.08, 0.05), (0.0, 0.0, 0.0), "carbon", turn, shadow=True)
    for left in (0.30, -0.30):
        add(box, (0.5, 0.03, 0.03), (0.0, left, -0.32), "carbon")  # skids
    for index, ((forward, _, _), hub) in enumerate(zip(ROTORS, _hubs(airframe), strict=True)):
        paint = "front" if forward > 0 else "rear"
        rotor = spec.worldbody.add_body(name=f"rotor{index}", mocap=True, pos=hub)
        rotor.add_geom(type=cylinder, size=side * np.array([0.82, 0.008, 0.0]), material=f"{paint} disk")
        rotor.add_geom(type=box, size=side * np.array([0.80, 0.075, 0.016]), material=paint, group=_SHADOWLESS)
