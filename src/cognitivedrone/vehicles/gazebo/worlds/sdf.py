"""A stage as SDF: poses of gates, panels and light, their XML, and meshes as OBJ files from the MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import GazeboError
from cognitivedrone.sim.airframe import GRAVITY
from cognitivedrone.types import COLORS, SHAPES, SIZES, FloatArray, Shape, Size, Stage
from cognitivedrone.world import geometry
from cognitivedrone.world.appearance import RGB, Appearance, Pattern
from cognitivedrone.world.assets import Assets, Placed, build_assets
from cognitivedrone.world.scene import OBSTACLE_COLORS, OBSTACLE_GLOW

PANEL: Final = "panel"
PILLAR: Final = "pillar"
FLOOR: Final = "floor"
ROOM: Final = "room"
MATERIALS_FILE: Final = "white.mtl"
MATERIALS: Final = "newmtl white\nKd 1 1 1\n"
"""What every mesh is made of, until the SDF file says otherwise: Gazebo warns of a mesh without a material."""
_MATERIAL: Final = "white"
_SIDES: Final = 24  # of a pillar


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles in their original frame: the gate frame for gates, the stage frame for others."""

    vertices: FloatArray
    """(n, 3) m."""
    faces: NDArray[np.int64]
    """(k, 3) indices of vertices, counter-clockwise from outside."""
    texture: FloatArray
    """(t, 2) coordinates, v downwards, 0 to 1 across a picture."""
    texture_faces: NDArray[np.int64]
    """(k, 3) indices of texture coordinates."""


def gate_mesh(size: Size, shape: Shape) -> str:
    """The name of a gate's mesh."""
    return f"gate_{size}_{shape}"


def world_meshes() -> dict[str, Mesh]:
    """Every mesh of our world by file name: six gates, the unit panel, a pillar, floor and room."""
    assets = build_assets(slots=1, image_size=16)  # the model is only read, not rendered
    placed = {gate_mesh(size, shape): assets.gates[size, shape] for size in SIZES for shape in SHAPES}
    placed |= {PANEL: assets.panel, FLOOR: assets.floor, ROOM: assets.room}
    return {name: _read(assets, where) for name, where in placed.items()} | {PILLAR: _pillar()}


def _pillar() -> Mesh:
    """An upright prism of diameter and height 1, in place of a cylinder."""
    turn = np.linspace(0.0, 2 * np.pi, _SIDES, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn)]) / 2
    rings = [np.column_stack([ring, np.full(_SIDES, z)]) for z in (-0.5, 0.5)]
    low = np.arange(_SIDES)
    high, after = low + _SIDES, (low + 1) % _SIDES
    caps = [np.column_stack([np.full(_SIDES - 2, k), low[1:-1] + k, low[2:] + k]) for k in (0, _SIDES)]
    faces = np.concatenate(
        [np.column_stack([low, after, high]), np.column_stack([after, after + _SIDES, high]), caps[0][:, ::-1], caps[1]]
    )
    return Mesh(np.concatenate(rings), faces, np.zeros((1, 2)), np.zeros_like(faces))


def obj_text(name: str, mesh: Mesh) -> str:
    """A mesh as the text of a Wavefront OBJ file."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lines = [f"mtllib {MATERIALS_FILE}", f"o {name}", f"usemtl {_MATERIAL}"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
    lines += [f"vt {u:.6f} {1.0 - v:.6f}" for u, v in mesh.texture]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals]
    for number, (face, texture) in enumerate(zip(mesh.faces + 1, mesh.texture_faces + 1, strict=True), start=1):
        corner_texts = (f"{v}/{t}/{number}" for v, t in zip(face, texture, strict=True))
        lines.append(f"f {' '.join(corner_texts)}")
    return "\n".join(lines) + "\n"


def _read(assets: Assets, placed: Placed) -> Mesh:
    """A mesh of the compiled model, transformed back to its original frame."""
    model, mesh = assets.model, placed.mesh

    def part(values: FloatArray, first: NDArray[np.int32], count: NDArray[np.int32]) -> FloatArray:
        return np.asarray(values[first[mesh] : first[mesh] + count[mesh]])

    vertices = part(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum).astype(np.float64)
    return Mesh(
        vertices=vertices @ placed.rotation.T + placed.position,
        faces=part(model.mesh_face, model.mesh_faceadr, model.mesh_facenum).astype(np.int64),
        texture=part(model.mesh_texcoord, model.mesh_texcoordadr, model.mesh_texcoordnum).astype(np.float64),
        texture_faces=part(model.mesh_facetexcoord, model.mesh_faceadr, model.mesh_facenum).astype(np.int64),
    )


VERSION: Final = "1.9"
WORLD: Final = "cognitivedrone"
"""Name of every exported world."""
SUN: Final = "sun"
STEP_S: Final = 0.001
"""Physics step; ArduPilot needs 800 Hz or more to pass its gyro check."""
_GATE_GLOW: Final = 0.4  # as in our world: keeps the colour of unlit faces recognisable
_SYSTEMS: Final = (
    ("gz-sim-physics-system", "gz::sim::systems::Physics"),
    ("gz-sim-user-commands-system", "gz::sim::systems::UserCommands"),
    ("gz-sim-scene-broadcaster-system", "gz::sim::systems::SceneBroadcaster"),
    ("gz-sim-imu-system", "gz::sim::systems::Imu"),
)
_SCATTERED: Final = 1.51
"""Intensity of the light that makes up for ogre2's diffuse reflection, after Disney: a rough surface that is seen along
the light sends back 1/1.51 (https://seblagarde.files.wordpress.com/2015/07/course_notes_moving_frostbite_to_pbr_v32.pdf)."""
_HOME: Final = (-35.363262, 149.165237, 584.0)  # ArduPilot's default place: latitude and longitude in degrees, m


@dataclass(frozen=True, slots=True)
class PanelPicture:
    """The picture on a panel or board."""

    file: str
    """File name in the folder of textures."""
    aspect: float
    """Width over height."""


@dataclass(frozen=True, slots=True)
class Paint:
    """A matt colour as Gazebo's renderer takes it: linear, where ours has sRGB, and without ambient light.

    Ours adds up emission, ambient and directional light in sRGB. What does not depend on the direction becomes emission
    here, so a face away from the light looks the same in both; so does one that faces it.
    """

    emissive: RGB
    """Linear."""
    diffuse: RGB
    """Linear; what a light of intensity 1 adds to a face towards it."""


def paint(color: RGB, glow: float, appearance: Appearance) -> Paint:
    """The paint of a colour (sRGB) of which the share `glow` (0 to 1) is emission and the rest is lit."""
    away = glow + (1.0 - glow) * appearance.ambient
    towards = away + (1.0 - glow) * appearance.diffuse
    red, green, blue = ((linear(away * part), linear(towards * part)) for part in color)
    dark, lit = (red[0], green[0], blue[0]), (red[1], green[1], blue[1])
    return Paint(dark, (lit[0] - dark[0], lit[1] - dark[1], lit[2] - dark[2]))


def linear(value: float) -> float:
    """The light of an sRGB value, both 0 to 1 (IEC 61966-2-1); larger values are cut, as on a screen."""
    value = min(value, 1.0)
    return value / 12.92 if value <= 0.04045 else float(((value + 0.055) / 1.055) ** 2.4)


@dataclass(frozen=True, slots=True)
class Prop:
    """A static mesh in the world, without collision, like the gates of our world."""

    name: str
    mesh: str
    """File name in the folder of meshes, without ".obj"."""
    position: tuple[float, float, float]
    """World, m."""
    yaw: float
    """rad."""
    paint: Paint
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: str | None = None
    """File name in the folder of textures; multiplied by the colour."""

    def alike(self, other: Prop) -> bool:
        """Whether the two differ only in position and heading."""
        return replace(self, position=other.position, yaw=other.yaw) == other


def props_of(
    stage: Stage, labels: Sequence[PanelPicture], board: PanelPicture | None, appearance: Appearance
) -> tuple[Prop, ...]:
    """Gates, panels, board, floor and room of a stage, placed as in our world.

    `labels` are the pictures of gates 1 to 3. A single gate has no panel. Floor and room belong to the stage: they move
    and turn with it.
    """
    if stage.landing:
        raise GazeboError("worlds for Gazebo have no landing pads; export each stage before the landing with --task ID")
    if geometry.moving_parts(stage) is not None:
        raise GazeboError("worlds for Gazebo stand still, and in a stage something moves; export others")
    centers, yaws = geometry.gate_centers(stage), geometry.gate_yaws(stage)
    home = (float(stage.origin[0]), float(stage.origin[1]), 0.0)
    paper = paint((appearance.panel_brightness,) * 3, 1.0, appearance)
    props: list[Prop] = []
    for index in geometry.standing(stage):
        gate = stage.gates[index]
        x, y, z = (float(value) for value in centers[index])
        color = paint(appearance.gate_colors[COLORS.index(gate.color)], _GATE_GLOW, appearance)
        mesh = gate_mesh(gate.size, gate.shape)
        props.append(Prop(f"gate_{index + 1}", mesh, (x, y, z), float(yaws[index]), color))
    panels = geometry.panel_centers(stage)
    for index in geometry.panelled(stage):
        x, y, z = (float(value) for value in panels[index])
        props.append(
            _panel(f"panel_{index + 1}", labels[index], (x, y, z), float(yaws[index]), geometry.PANEL_HEIGHT, paper)
        )
    if board is not None:
        center, yaw, _, height = geometry.board_panel(stage, board.aspect)
        x, y, z = (float(value) for value in center)
        props.append(_panel("board", board, (x, y, z), yaw, height, paper))
    props += _obstacles(stage, appearance)
    floor = paint(appearance.floor, 0.0, appearance)
    props.append(Prop(FLOOR, FLOOR, home, stage.yaw, floor, texture=pattern_file(appearance.floor_pattern)))
    room = paint(appearance.surroundings, appearance.surroundings_glow, appearance)
    props.append(Prop(ROOM, ROOM, home, stage.yaw, room, texture=pattern_file(appearance.surroundings_pattern)))
    return tuple(props)


def pattern_file(pattern: Pattern) -> str | None:
    """The texture of a pattern; none for the plain one."""
    return None if pattern == "plain" else f"pattern_{pattern}.png"


def document(element: ET.Element) -> str:
    """The text of an SDF file with one world or model."""
    root = ET.Element("sdf", version=VERSION)
    root.append(element)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def prop_model(prop: Prop, folder: str = "") -> ET.Element:
    """The `<model>` of a prop.

    `folder` is the prefix of mesh and texture names: empty for files next to the world's, and "file:///a/folder/" for a
    model that is sent to a running Gazebo.
    """
    mesh: Fields = {"uri": f"{folder}meshes/{prop.mesh}.obj", "scale": prop.scale}
    visual = new("visual", {"cast_shadows": "false", "geometry": {"mesh": mesh}}, name="visual")
    visual.append(material(prop.paint, prop.texture and f"{folder}textures/{prop.texture}"))
    model = new("model", {"static": "true", "pose": (*prop.position, 0.0, 0.0, prop.yaw)}, name=prop.name)
    ET.SubElement(model, "link", name="link").append(visual)
    return model


def material(paint: Paint, texture: str | None = None) -> ET.Element:
    """A `<material>` of this paint, multiplied by the texture's colours."""
    diffuse, maps = (*paint.diffuse, 1.0), ("albedo_map", "emissive_map")
    light = {"ambient": diffuse, "diffuse": diffuse, "specular": (0, 0, 0, 1), "emissive": (*paint.emissive, 1.0)}
    metal = dict.fromkeys(maps, texture) if texture is not None else {}
    return new("material", {**light, "pbr": {"metal": {**metal, "metalness": 0, "roughness": 1}}})


def world(stage: Stage, props: Sequence[Prop], appearance: Appearance, vehicle: ET.Element) -> ET.Element:
    """The `<world>` of a stage: systems, physics, one light without shadows, ground, props and the vehicle."""
    element = ET.Element("world", name=WORLD)
    physics = {"max_step_size": STEP_S, "real_time_factor": 1}
    element.append(new("physics", physics, name="lockstep", type="ignored"))
    for filename, name in _SYSTEMS:
        ET.SubElement(element, "plugin", filename=filename, name=name)
    sensors = {"filename": "gz-sim-sensors-system", "name": "gz::sim::systems::Sensors"}
    element.append(new("plugin", {"render_engine": "ogre2"}, **sensors))
    latitude, longitude, elevation = _HOME
    place: Fields = {
        "surface_model": "EARTH_WGS84", "world_frame_orientation": "ENU", "latitude_deg": latitude,
        "longitude_deg": longitude, "elevation": elevation, "heading_deg": 0,
    }  # fmt: skip
    ambient = (0, 0, 0, 1)  # is part of the paint
    background = (*appearance.surroundings, 1.0)
    scene: Fields = {"ambient": ambient, "background": background, "grid": "false", "shadows": "false"}
    fill(element, {"gravity": (0.0, 0.0, -GRAVITY), "spherical_coordinates": place, "scene": scene})
    element.extend([sun(stage, appearance), _ground(), *map(prop_model, props), vehicle])
    return element


def sun(stage: Stage, appearance: Appearance) -> ET.Element:
    """The only `<light>`: directional, without shadows, rotated with the stage."""
    fields: Fields = {
        "pose": (*stage.origin, 10.0, 0.0, 0.0, stage.yaw),
        "cast_shadows": "false",
        "diffuse": (1, 1, 1, 1),  # its intensity is part of the paint
        "specular": (0, 0, 0, 1),
        "intensity": _SCATTERED,
        "attenuation": {"range": 1000, "constant": 1, "linear": 0, "quadratic": 0},
        "direction": appearance.light_direction,
    }
    return new("light", fields, name=SUN, type="directional")


Fields: TypeAlias = Mapping[str, "str | float | Sequence[float] | Fields"]
"""What is in an element, by tag: text, a number, several, or fields again."""


def new(tag: str, fields: Fields, **attributes: str) -> ET.Element:
    """An element of these fields."""
    return fill(ET.Element(tag, attributes), fields)


def fill(parent: ET.Element, fields: Fields) -> ET.Element:
    """Append fields; returns the parent."""
    for tag, value in fields.items():
        child = ET.SubElement(parent, tag)
        if isinstance(value, Mapping):
            fill(child, value)
        else:
            child.text = value if isinstance(value, str) else numbers(*np.atleast_1d(value))
    return parent


def numbers(*values: float) -> str:
    """Numbers formatted for SDF, with nine digits; 0 without a sign."""
    return " ".join(format(float(value) + 0.0, ".9g") for value in values)


def _panel(
    name: str, picture: PanelPicture, place: tuple[float, float, float], yaw: float, height: float, paper: Paint
) -> Prop:
    scale = (1.0, picture.aspect * height, height)
    return Prop(name, PANEL, place, yaw, paper, scale, picture.file)


def _obstacles(stage: Stage, appearance: Appearance) -> list[Prop]:
    """Boxes and pillars; not the panel of a landmark."""
    found, props = geometry.solids(stage), []
    for index in range(len(found.yaws) - (stage.landmark is not None)):
        is_round, (depth, width, height) = bool(found.round[index]), (2 * found.halves[index]).tolist()
        scale = (depth, width, height) if is_round else (depth / geometry.PANEL_DEPTH, width, height)
        x, y, z = found.centers[index].tolist()
        mesh, color = PILLAR if is_round else PANEL, paint(OBSTACLE_COLORS[is_round], OBSTACLE_GLOW, appearance)
        props.append(Prop(f"obstacle_{index + 1}", mesh, (x, y, z), float(found.yaws[index]), color, scale))
    return props


def _ground() -> ET.Element:
    """The ground under the vehicle: infinite and invisible, so that it need not move with the stage."""
    plane = new("collision", {"geometry": {"plane": {"normal": (0, 0, 1), "size": (1, 1)}}}, name="collision")
    model = new("model", {"static": "true"}, name="ground")
    ET.SubElement(model, "link", name="link").append(plane)
    return model
