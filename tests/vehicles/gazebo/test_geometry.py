"""Exported worlds, read back, against our own: the same places, shapes, pictures, light and camera."""

import math
from typing import Any

import numpy as np
import pytest
from PIL import Image as Pictures
from sdf_reading import element_pose, model_mesh, models, parse, read_obj, read_world, values

from cognitivedrone.frames import rotate_yaw
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.drawing.camera import FIELD_OF_VIEW, MOUNT
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate, Landmark, Obstacle, Stage
from cognitivedrone.vehicles.gazebo.worlds.export import world_of
from cognitivedrone.vehicles.gazebo.worlds.sdf import PanelPicture, document, props_of
from cognitivedrone.world import geometry
from cognitivedrone.world.appearance import PLAIN, varied_appearance
from cognitivedrone.world.assets import ROOM_HALF_SIZE, ROOM_HEIGHT

MM = 1e-3
TENTH_OF_DEGREE = math.radians(0.1)
VARIANTS = [Gate(size, shape, color) for size in SIZES for shape in SHAPES for color in COLORS]
LABELS = (PanelPicture("a.png", 1.0), PanelPicture("b.png", 0.7), PanelPicture("c.png", 1.5))
ORIGIN, YAW = (7.5, -3.25), 2.3


def stage_with(first: int, **options) -> Stage:
    """A stage whose gates are three of the variants, so that all stages put every variant in every place."""
    gates: Any = tuple(VARIANTS[(first + 6 * place) % len(VARIANTS)] for place in range(3))
    return Stage(gates=gates, labels=("letter/A@inter",) * 3, origin=ORIGIN, yaw=YAW, **options)


def world_with(stage: Stage, appearance=PLAIN, board: PanelPicture | None = None):
    props = props_of(stage, LABELS, board, appearance)
    return parse(document(world_of(stage, props, appearance))).find("world")


def nearest(points: np.ndarray, others: np.ndarray) -> float:
    """How far the loneliest of `points` is from the nearest of `others`."""
    return float(np.linalg.norm(points[:, None] - others[None], axis=-1).min(axis=1).max())


def seen(model, towards: float) -> np.ndarray:
    """(3,) what a linear renderer shows of a face, sRGB 0 to 1; `towards` is the cosine of its angle to the light."""
    emissive, diffuse = (np.array(values(model, f".//material/{tag}")[:3]) for tag in ("emissive", "diffuse"))
    light = np.minimum(emissive + towards * diffuse, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("first", range(len(VARIANTS)))
def test_every_gate_variant_stands_in_every_place_as_in_our_world(track_folder, first):
    stage = stage_with(first)
    found = models(world_with(stage))
    centers, yaws = geometry.gate_centers(stage), geometry.gate_yaws(stage)
    for place, gate in enumerate(stage.gates):
        model = found[f"gate_{place + 1}"]
        points, _ = model_mesh(track_folder, model)
        along, in_plane = np.split(geometry.to_gate_frame(points, centers[place], yaws[place]), [1], axis=1)
        assert np.abs(np.abs(along) - geometry.BAR_DEPTH / 2).max() < MM
        corners = np.concatenate([geometry.opening_outline(gate), geometry.opening_outline(gate, geometry.BAR_WIDTH)])
        assert nearest(in_plane, corners) < MM
        assert nearest(corners, in_plane) < MM
        turned = values(model, "pose")[5] - yaws[place]
        assert abs(math.remainder(turned, 2 * math.pi)) < TENTH_OF_DEGREE
        assert seen(model, towards=1.0).argmax() == COLORS.index(gate.color)
        assert model.findtext("static") == "true"


@pytest.mark.parametrize("place", range(3))
def test_panels_hang_over_their_gates_as_wide_as_their_pictures(track_folder, place):
    stage = stage_with(0)
    points, obj = model_mesh(track_folder, models(world_with(stage))[f"panel_{place + 1}"])
    center, yaw = geometry.gate_centers(stage)[place], geometry.gate_yaws(stage)[place]
    local = geometry.to_gate_frame(points, center, yaw) - [0, 0, geometry.PANEL_CENTER_HEIGHT - geometry.GATE_HEIGHT]
    size = np.array([geometry.PANEL_DEPTH, LABELS[place].aspect * geometry.PANEL_HEIGHT, geometry.PANEL_HEIGHT])
    assert np.abs(local.max(axis=0) - size / 2).max() < MM
    assert np.abs(local.min(axis=0) + size / 2).max() < MM
    # Whoever flies towards the gate sees the picture's left edge on the left, its upper edge above.
    front = np.flatnonzero((local[obj.faces][..., 0] < -0.9 * size[0] / 2).all(axis=1))
    assert len(front) == 2
    for corner, (u, v) in zip(local[obj.faces[front]].reshape(-1, 3), obj.texture[front].reshape(-1, 2), strict=True):
        assert u == pytest.approx(0.5 - corner[1] / size[1], abs=1e-4)
        assert v == pytest.approx(0.5 + corner[2] / size[2], abs=1e-4)


def test_the_board_hangs_where_ours_does(track_folder):
    stage = stage_with(0, board="sum/7*9@inter")
    model = models(world_with(stage, board=PanelPicture("sum.png", 1.25)))["board"]
    points, _ = model_mesh(track_folder, model)
    home = np.array([*ORIGIN, 0.0])
    local = rotate_yaw(points - home, -YAW) - geometry.BOARD_CENTER
    size = np.array([geometry.PANEL_DEPTH, 1.25 * geometry.BOARD_HEIGHT, geometry.BOARD_HEIGHT])
    assert np.abs(local.max(axis=0) - size / 2).max() < MM
    assert "board" not in models(world_with(stage_with(0)))


def test_a_gate_that_stands_alone_has_no_neighbours_and_no_panel():
    found = models(world_with(stage_with(0, only=1)))
    assert {name for name in found if name.startswith(("gate", "panel"))} == {"gate_2"}


def test_room_and_floor_surround_the_stage_and_turn_with_it(track_folder):
    found = models(world_with(stage_with(0)))
    for name, low, high in (("floor", -0.01, 0.0), ("room", 0.0, ROOM_HEIGHT)):
        points, _ = model_mesh(track_folder, found[name])
        local = rotate_yaw(points - np.array([*ORIGIN, 0.0]), -YAW)
        assert np.abs(np.abs(local[:, :2]) - ROOM_HALF_SIZE).max() < MM
        assert (local[:, 2].min(), local[:, 2].max()) == pytest.approx((low, high), abs=MM)


def test_faces_look_outwards_and_carry_their_normals(track_folder):
    for file in sorted((track_folder / "meshes").glob("*.obj")):
        obj = read_obj(file)
        corners = obj.vertices[obj.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        assert np.abs(obj.normals - normals[:, None]).max() < 1e-3
        if file.stem.startswith("gate"):  # a closed ring: the volume by the divergence theorem is that of the bar
            volume = np.einsum("kj,kj->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
            _, size, shape = file.stem.split("_")
            gate = Gate(size, shape, "red")
            area = polygon_area(geometry.opening_outline(gate, geometry.BAR_WIDTH)) - polygon_area(
                geometry.opening_outline(gate)
            )
            assert volume == pytest.approx(area * geometry.BAR_DEPTH, rel=1e-3)


def test_every_mesh_has_a_material_which_gazebo_warns_of_otherwise(track_folder):
    for file in sorted((track_folder / "meshes").glob("*.obj")):
        words = dict(line.split(maxsplit=1) for line in file.read_text().splitlines() if line.split()[0] != "f")
        materials = (file.parent / words["mtllib"]).read_text().splitlines()
        assert f"newmtl {words['usemtl']}" in materials


def polygon_area(corners: np.ndarray) -> float:
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2)


def test_the_light_is_ours_and_turns_with_the_stage():
    world = world_with(stage_with(0))
    light = world.find("light")
    direction = element_pose(light)[:3, :3] @ values(light, "direction")
    assert direction == pytest.approx(rotate_yaw(np.array(PLAIN.light_direction), YAW), abs=1e-6)
    assert light.findtext("cast_shadows") == world.findtext("scene/shadows") == "false"
    assert values(light, "diffuse")[:3] == [1, 1, 1]
    assert values(world, "scene/ambient")[:3] == [0, 0, 0]


@pytest.mark.parametrize("appearance", [PLAIN, *(varied_appearance(np.random.default_rng(seed)) for seed in range(5))])
def test_faces_towards_and_away_from_the_light_are_as_bright_as_ours(appearance):
    found = models(world_with(stage_with(0), appearance))
    gate = np.array(appearance.gate_colors[COLORS.index(stage_with(0).gates[0].color)])
    for name, color, glow in (
        ("gate_1", gate, 0.4),
        ("floor", np.array(appearance.floor), 0.0),
        ("room", np.array(appearance.surroundings), appearance.surroundings_glow),
        ("panel_1", np.array([appearance.panel_brightness] * 3), 1.0),
    ):
        for towards in (0.0, 1.0):
            light = appearance.ambient + towards * appearance.diffuse
            ours = np.minimum(glow * color + (1 - glow) * color * light, 1.0)
            assert seen(found[name], towards) == pytest.approx(ours, abs=1e-3), (name, towards)


def test_the_camera_is_ours():
    sensor = models(world_with(stage_with(0)))["iris"].find(".//sensor[@type='camera']")
    assert element_pose(sensor)[:3, 3] == pytest.approx(MOUNT, abs=1e-9)
    assert element_pose(sensor)[:3, :3] == pytest.approx(np.eye(3))
    assert values(sensor, "camera/horizontal_fov") == pytest.approx([FIELD_OF_VIEW], abs=1e-6)
    assert [sensor.findtext(f"camera/image/{side}") for side in ("width", "height")] == ["256", "256"]
    assert sensor.find("camera/noise") is None
    mask = int(sensor.findtext("camera/visibility_mask"))
    assert mask == 2**30 - 1  # the two highest bits are ogre2's own: it warns of them


def test_a_varied_look_brings_its_colours_patterns_and_noise():
    appearance = next(
        appearance
        for appearance in (varied_appearance(np.random.default_rng(seed)) for seed in range(100))
        if appearance.floor_pattern != "plain" and appearance.noise > 1 and appearance.surroundings_pattern != "plain"
    )
    world = world_with(stage_with(0), appearance)
    floor, sensor = models(world)["floor"], models(world)["iris"].find(".//sensor[@type='camera']")
    assert floor.findtext(".//albedo_map") == f"textures/pattern_{appearance.floor_pattern}.png"
    assert floor.findtext(".//emissive_map") == floor.findtext(".//albedo_map")
    assert values(sensor, "camera/noise/stddev") == pytest.approx([appearance.noise / 255])
    assert models(world)["panel_1"].findtext(".//emissive_map") == "textures/a.png"


def test_the_textures_are_the_labels_to_the_pixel(track_folder):
    pack, track = load_pack(), load_suite("open-v1:track").tracks[0]
    for number, task in enumerate(track, start=1):
        found = models(read_world(track_folder / f"stage_{number}.sdf"))
        for place, label in enumerate(task.labels, start=1):
            file = track_folder / found[f"panel_{place}"].findtext(".//emissive_map")
            assert np.array_equal(np.asarray(Pictures.open(file)), pack.image(label))


def test_obstacles_stand_where_they_are_in_our_world(track_folder):
    obstacles = (Obstacle("pillar", 2.0, 0.4, 0.3, 2.0), Obstacle("frame", 2.0, -1.5, 1.2, 1.0, 0.1, 0.4, 0.2))
    stage = stage_with(0, obstacles=obstacles, landmark=Landmark("number/1@inter", 4.5, 2.0, 2.0, 0.3))
    found = models(world_with(stage, board=PanelPicture("d.png", 0.5)))
    solids = geometry.solids(stage)
    assert len(solids.yaws) == 1 + 4 + 2
    for index in range(len(solids.yaws) - 1):
        points, _ = model_mesh(track_folder, found[f"obstacle_{index + 1}"])
        local = rotate_yaw(points - solids.centers[index], -solids.yaws[index])
        assert np.abs(np.abs(local).max(axis=0) - solids.halves[index]).max() < MM
        assert solids.distance(points)[:, index].max() < MM
    points, _ = model_mesh(track_folder, found["board"])
    assert np.abs(points.mean(axis=0) - solids.centers[-1]).max() < MM
    assert np.ptp(points[:, 2]) == pytest.approx(1.2)
