"""MuJoCo scene of a stage: placed meshes and a light, written straight into an `mjvScene`.

Each slot keeps its own scene, filled once per stage; drawing a frame then only sets the camera. This makes
rendering fast, and pictures independent of what was drawn before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cognitivedrone.frames import quaternion_from_yaw, rotation_matrix
from cognitivedrone.layout.motion import Motion
from cognitivedrone.types import COLORS, DroneState, FloatArray, Stage, Vectors
from cognitivedrone.world import geometry
from cognitivedrone.world.appearance import RGB, Appearance
from cognitivedrone.world.assets import BOARD, Assets, Placed
from cognitivedrone.world.engine import mujoco

_MAX_GEOMS = 128
_PAD_THICKNESS = 0.005  # m, half
_GATE_GLOW = 0.4  # keeps faces in shadow recognisable by colour
OBSTACLE_COLORS: dict[bool, RGB] = {True: (0.55, 0.5, 0.42), False: (0.42, 0.38, 0.36)}
"""Of round and of other obstacles: none of a gate's."""
OBSTACLE_GLOW = 0.1
_ARM = 0.11  # m, hub to rotor along x and along y: a 5-inch racing quadrotor
_ROTOR_RADIUS = 0.065
_BODY_COLOR: RGB = (0.15, 0.15, 0.17)
_FRONT_COLOR: RGB = (1.0, 0.55, 0.0)
_REAR_COLOR: RGB = (0.35, 0.35, 0.4)


@dataclass(frozen=True, slots=True)
class Movers:
    """What moves in a scene."""

    geoms: tuple[int, ...]
    """Indices."""
    places: Vectors
    """(n, 3) in the middle of their way, world, m."""
    motion: Motion


def new_scene(assets: Assets) -> Any:
    """An empty `mujoco.MjvScene`: no shadows, reflections, sky or fog."""
    scene = mujoco.MjvScene(assets.model, maxgeom=_MAX_GEOMS)
    scene.flags[:] = 0
    scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1
    return scene


def fill_scene(
    scene: Any,
    assets: Assets,
    slot: int,
    stage: Stage,
    aspects: Sequence[float],
    board_aspect: float | None,
    appearance: Appearance,
    panorama: int = -1,
) -> Movers | None:
    """Replace the content of `scene` by a stage whose pictures are in the textures of `slot`; returns what moves in it,
    for `move`.

    `aspects` are the labels' widths over heights; `board_aspect` is the board's, or None without a board. `panorama`
    is the texture of the appearance's place. A gate that stands alone has no panel. Room and light belong to the stage:
    they move and rotate with it.
    """
    scene.ngeom = 0
    level = rotation_matrix(quaternion_from_yaw(stage.yaw))
    centers, yaws = geometry.gate_centers(stage), geometry.gate_yaws(stage)
    placed: dict[str, tuple[int, FloatArray]] = {}
    for index in geometry.standing(stage):
        gate = stage.gates[index]
        color = appearance.gate_colors[COLORS.index(gate.color)]
        mesh = assets.gates[gate.size, gate.shape]
        axes = rotation_matrix(quaternion_from_yaw(yaws[index]))
        placed[f"gate{index}"] = _add_mesh(scene, mesh, centers[index], axes, color, _GATE_GLOW)
    pictures = assets.pictures[slot]
    paper: RGB = (appearance.panel_brightness,) * 3
    panels = geometry.panel_centers(stage)
    for index in geometry.panelled(stage):
        yaw, aspect = yaws[index], aspects[index]
        size = np.array([1.0, aspect * geometry.PANEL_HEIGHT, geometry.PANEL_HEIGHT])
        axes = rotation_matrix(quaternion_from_yaw(yaw)) * size
        picture = int(pictures[index])
        placed[f"panel{index}"] = _add_mesh(scene, assets.panel, panels[index], axes, paper, 1.0, picture)
    if board_aspect is not None:
        center, yaw, *sides = geometry.board_panel(stage, board_aspect)
        axes = rotation_matrix(quaternion_from_yaw(yaw)) * np.array([1.0, *sides])
        _add_mesh(scene, assets.panel, center, axes, paper, 1.0, int(pictures[BOARD]))
    if stage.obstacles or stage.landmark:
        placed |= _add_obstacles(scene, stage)
    if stage.landing:
        for gate, center in zip(stage.gates, centers, strict=True):
            _add_pad(scene, center, appearance.gate_colors[COLORS.index(gate.color)])
    _add_surroundings(scene, assets, stage, level, appearance, panorama)
    _set_light(scene, level, appearance)
    if (moving := geometry.moving_parts(stage)) is None:
        return None
    names, motion = moving
    geoms, places = zip(*(placed[name] for name in names), strict=True)
    movers = Movers(geoms, np.stack(places), motion)
    move(scene, movers, 0.0)
    return movers


def move(scene: Any, movers: Movers, time: float) -> None:
    """Put what moves where it is at a time, s since the flight began."""
    places = movers.places + movers.motion.offset(time)
    for index, place in zip(movers.geoms, places, strict=True):
        scene.geoms[index].pos[:] = place


def _add_surroundings(
    scene: Any, assets: Assets, stage: Stage, level: FloatArray, appearance: Appearance, panorama: int
) -> None:
    """Floor and room, or the place of the appearance, whose texture is `panorama`."""
    home = np.array([*stage.origin, 0.0])
    if appearance.place:
        # Pads lie on level ground: a tilted one would cover them.
        around_x, around_y = (0.0, 0.0) if stage.landing else appearance.place_tilt
        tilt = np.array([1.0, around_x / 2, around_y / 2, 0.0])
        axes = level @ rotation_matrix(tilt / np.linalg.norm(tilt))
        axes = axes @ rotation_matrix(quaternion_from_yaw(appearance.place_turn))
        shade: RGB = (appearance.place_brightness,) * 3
        _add_mesh(scene, assets.place, home, axes, shade, 1.0, panorama)
        return
    floor, room = appearance.floor_pattern, appearance.surroundings_pattern
    _add_mesh(scene, assets.floor, home, level, appearance.floor, 0.0, _pattern(assets, floor))
    glow = appearance.surroundings_glow
    _add_mesh(scene, assets.room, home, level, appearance.surroundings, glow, _pattern(assets, room))


def add_drone(scene: Any, state: DroneState, scale: float = 1.0) -> None:
    """Put a quadrotor into the scene, for third-person views; resetting `scene.ngeom` removes it.

    The front rotors are orange. `scale` enlarges it for views from afar.
    """
    axes = rotation_matrix(np.asarray(state.quaternion, dtype=np.float64))
    position = np.asarray(state.position, dtype=np.float64)
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    _add_shape(scene, box, position, axes, scale * np.array([0.06, 0.03, 0.02]), _BODY_COLOR)
    half_arm = scale * np.array([_ARM * np.sqrt(2.0), 0.008, 0.005])
    for quarter in (1, -1):
        diagonal = axes @ rotation_matrix(quaternion_from_yaw(quarter * np.pi / 4))
        _add_shape(scene, box, position, diagonal, half_arm, _BODY_COLOR)
    rotor = scale * np.array([_ROTOR_RADIUS, 0.004, 0.0])
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        hub = position + axes @ (scale * np.array([_ARM * x, _ARM * y, 0.02]))
        _add_shape(scene, cylinder, hub, axes, rotor, _FRONT_COLOR if x > 0 else _REAR_COLOR)


def _pattern(assets: Assets, pattern: Any) -> int:
    """Material of a pattern; -1, which is no material and draws faster, for the plain pattern."""
    return -1 if pattern == "plain" else assets.patterns[pattern]


def _add_mesh(
    scene: Any, mesh: Placed, position: FloatArray, axes: FloatArray, color: RGB, glow: float, material: int = -1
) -> tuple[int, FloatArray]:
    """Place a mesh. `axes` (3, 3) may stretch it: its columns are the mesh's own axes in the world.

    Returns the geom's index and position (3,), m.
    """
    place: FloatArray = position + axes @ mesh.position
    geom = _next_geom(
        scene,
        mujoco.mjtGeom.mjGEOM_MESH,
        place,
        axes @ mesh.rotation,
        np.ones(3),
        color,
        glow,
    )
    geom.dataid = 2 * mesh.mesh  # even numbers are meshes, odd ones their convex hulls
    geom.matid = material
    geom.texcoord = int(material >= 0)
    return scene.ngeom - 1, place


def _add_shape(scene: Any, kind: Any, position: FloatArray, axes: FloatArray, size: FloatArray, color: RGB) -> None:
    geom = _next_geom(scene, kind, position, axes, size, color, 0.2)
    geom.dataid = geom.matid = -1


def _add_obstacles(scene: Any, stage: Stage) -> dict[str, tuple[int, FloatArray]]:
    """Boxes and cylinders, not the panel of a landmark; returns geoms and positions by name."""
    found, placed = geometry.solids(stage), {}
    for index in range(len(found.yaws) - (stage.landmark is not None)):
        is_round, half = bool(found.round[index]), found.halves[index]
        kind = mujoco.mjtGeom.mjGEOM_CYLINDER if is_round else mujoco.mjtGeom.mjGEOM_BOX
        size = np.array([half[0], half[2], 0.0]) if is_round else half
        axes = rotation_matrix(quaternion_from_yaw(found.yaws[index]))
        placed[f"obstacle{index}"] = (scene.ngeom, found.centers[index])
        geom = _next_geom(scene, kind, found.centers[index], axes, size, OBSTACLE_COLORS[is_round], OBSTACLE_GLOW)
        geom.dataid = geom.matid = -1
    return placed


def _add_pad(scene: Any, center: FloatArray, color: RGB) -> None:
    """A disc on the floor."""
    size = np.array([geometry.PAD_RADIUS, _PAD_THICKNESS, 0.0])
    geom = _next_geom(scene, mujoco.mjtGeom.mjGEOM_CYLINDER, center, np.eye(3), size, color, _GATE_GLOW)
    geom.dataid = geom.matid = -1


def _next_geom(
    scene: Any, kind: Any, position: FloatArray, axes: FloatArray, size: FloatArray, color: RGB, glow: float
) -> Any:
    """A geom that shows the share `glow` (0 to 1) of its colour as emission, and the rest as lit."""
    geom = scene.geoms[scene.ngeom]
    # OpenGL adds emission * colour to the lit colour, so the colour is dimmed by the emitted share.
    lit = max(1.0 - glow, 1e-3)
    rgba = np.array([*(lit * part for part in color), 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, size, position, axes.reshape(-1), rgba)
    geom.category = mujoco.mjtCatBit.mjCAT_STATIC
    geom.emission = glow / lit
    geom.specular = geom.shininess = geom.reflectance = 0.0
    scene.ngeom += 1
    return geom


def _set_light(scene: Any, level: FloatArray, appearance: Appearance) -> None:
    """One directional light without shadows."""
    direction = level @ np.array(appearance.light_direction)
    scene.nlight = 1
    light = scene.lights[0]
    light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    light.headlight = light.castshadow = 0
    light.pos[:] = (0.0, 0.0, 10.0)
    light.dir[:] = direction / np.linalg.norm(direction)
    light.attenuation[:] = (1.0, 0.0, 0.0)
    light.ambient[:] = appearance.ambient * np.array(appearance.ambient_color)
    light.diffuse[:] = appearance.diffuse * np.array(appearance.light_color)
    light.specular[:] = 0.0
