"""The truth of a frame agrees with the renderer and the expert, and knows what nobody could see."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from attitudes import tilted

from cognitivedrone.frames import quaternion_from_yaw, rotate_yaw
from cognitivedrone.policies.expert import ExpertConfig, intent
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.training.perception.ground_truth import COMMITTED, LEGIBLE_HEIGHT, Poses, Truths, project, truths
from cognitivedrone.types import ACTION_LIMITS, IMAGE_SIZE, FloatArray, Gate, GatePlace, Image, Stage
from cognitivedrone.world import geometry

STAGE = Stage(
    gates=(Gate("small", "round", "red"), Gate("small", "square", "green"), Gate("small", "round", "blue")),
    labels=("number/1@inter", "number/2@inter", "number/3@inter"),
)
TURNED = replace(STAGE, origin=(12.0, -7.0), yaw=2.0)
BOARDED = replace(STAGE, board="sum/1+2@inter")
ALONE = replace(STAGE, only=1)
EXPERT = ExpertConfig()
GREY = np.full((64, 64, 3), 128, np.uint8)
PINK = np.full((64, 64, 3), (255, 0, 255), np.uint8)
CHANNELS = (0, 1, 2)  # of the gates' colours, in their order


def at(
    *position: float, yaw: float = 0.0, attitude: FloatArray | None = None, velocity: tuple[float, ...] = (0, 0, 0)
) -> Poses:
    quaternion = quaternion_from_yaw(yaw) if attitude is None else attitude
    return Poses(np.array([position]), quaternion[None], np.array([velocity], dtype=float), np.zeros(1))


def known(poses: Poses, stage: Stage = STAGE, chunk: int = 1) -> Truths:
    return truths(poses, [stage] * len(poses.position), chunk, EXPERT)


@pytest.fixture(scope="module")
def cameras() -> Iterator[Cameras]:
    with Cameras(1) as made:
        yield made


def middle(mask: np.ndarray) -> FloatArray:
    """Middle u, v, of the box around what is true of the pixels."""
    rows, columns = np.nonzero(mask)
    return np.array([(columns.min() + columns.max() + 1) / 2, (rows.min() + rows.max() + 1) / 2])


def coloured(image: Image, channel: int) -> np.ndarray:
    """Which pixels show clearly more of one colour than of the others."""
    others = np.delete(image, channel, axis=2).max(axis=2)
    return image[..., channel].astype(int) - others > 60


# ---- where things are


@pytest.mark.parametrize(
    "attitude",
    [tilted(0, 0, 0), tilted(0.1, 0, 0), tilted(0, 0.3, 0), tilted(-0.15, 0.15, 0.35)],
    ids=["level", "yaw", "pitch", "all"],
)
@pytest.mark.parametrize("stage", [STAGE, TURNED], ids=["home", "turned"])
def test_gates_are_where_the_renderer_draws_them(cameras: Cameras, stage: Stage, attitude: FloatArray) -> None:
    cameras.set_stage(0, stage, [GREY] * 3)
    position = rotate_yaw(np.array([-1.5, 0.2, 1.1]), stage.yaw) + np.array([*stage.origin, 0.0])
    # The stage's yaw, then the attitude: the product of two quaternions of which the first only turns.
    w, z = math.cos(stage.yaw / 2), math.sin(stage.yaw / 2)
    a, b, c, d = attitude
    quaternion = np.array([w * a - z * d, w * b - z * c, w * c + z * b, w * d + z * a])
    poses = Poses(position[None], quaternion[None], np.zeros((1, 3)), np.zeros(1))
    image = cameras.first_person(poses.position, poses.quaternion)[0]
    found = known(poses, stage)
    assert found.in_view.all()
    for gate, channel in enumerate(CHANNELS):
        # A ring seen at a slant is not quite centred on its centre's image; small ones nearly are.
        assert middle(coloured(image, channel)) == pytest.approx(found.gate[0, gate], abs=2.0)


def test_panels_are_as_high_and_as_far_up_as_the_renderer_draws_them(cameras: Cameras) -> None:
    cameras.set_stage(0, STAGE, [GREY, PINK, GREY])
    poses = at(-1.0, 0.0, 1.0)
    image = cameras.first_person(poses.position, poses.quaternion)[0].astype(int)
    pink = np.minimum(image[..., 0], image[..., 2]) - image[..., 1] > 60
    u, v, height = known(poses).panel[0, 1]
    assert middle(pink) == pytest.approx([u, v], abs=1.0)
    assert np.ptp(np.nonzero(pink)[0]) + 1 == pytest.approx(height, abs=1.5)


def test_place_tells_distance_and_heading_of_every_gate() -> None:
    found = known(at(1.0, 0.0, 0.9, yaw=0.4)).place[0]
    assert found[1] == pytest.approx([4.0, math.sin(-0.4), math.cos(-0.4)], abs=1e-6)
    assert found[0, 0] == found[2, 0] == pytest.approx(5.0)
    assert math.atan2(found[0, 1], found[0, 2]) == pytest.approx(math.pi / 4 - 0.4, abs=1e-6)


def test_the_state_is_told_in_the_heading_frame() -> None:
    poses = at(0.0, 0.0, 1.3, yaw=math.pi / 2, velocity=(1.0, 0.0, 0.5))._replace(yaw_rate=np.array([0.2]))
    state = poses.state()
    assert state.dtype == np.float32
    assert state[0] == pytest.approx([0.0, -1.0, 0.5, 1.3, 0.2], abs=1e-6)


# ---- what is seen


@pytest.mark.parametrize(
    ("poses", "stage", "in_view", "legible"),
    [
        (at(*geometry.START), BOARDED, [True] * 3, [True] * 4),
        (at(*geometry.START), STAGE, [True] * 3, [True, True, True, False]),  # no board hangs
        (at(*geometry.START, yaw=math.pi), BOARDED, [False] * 3, [False] * 4),  # it looks away
        (at(2.0, -3.0, 0.9), STAGE, [False, True, True], [False, True, True, False]),
    ],
)
def test_what_is_in_view_can_be_read(poses: Poses, stage: Stage, in_view: list[bool], legible: list[bool]) -> None:
    found = known(poses, stage)
    assert (found.in_view.tolist(), found.legible.tolist()) == ([in_view], [legible])
    assert found.ahead.all()  # the gates are where they were


def test_far_panels_are_in_view_and_not_legible() -> None:
    found = known(at(-25.0, 0.0, 1.0))
    assert found.in_view.all()
    assert (found.panel[0, :3, 2] < LEGIBLE_HEIGHT).all()
    assert not found.legible.any()


def test_a_panel_mostly_above_the_image_is_not_legible() -> None:
    near = known(at(4.2, 0.0, 0.9))
    assert near.in_view[0, 1]
    assert near.panel[0, 1, 2] > LEGIBLE_HEIGHT
    assert not near.legible[0, 1]


def test_behind_a_gate_it_is_neither_seen_nor_taught() -> None:
    found = known(at(5.5, 0.0, 0.9, yaw=math.pi))  # looks back at it
    assert ((found.gate[0, 1] > 0) & (found.gate[0, 1] < IMAGE_SIZE)).all()
    assert not found.in_view[0, 1]
    assert not found.ahead[0, 1]
    assert not found.valid[0, 1]
    assert not found.legible[0, 1]


def test_close_to_a_gate_only_that_one_is_taught() -> None:
    before, beyond = 5.0 - COMMITTED - 0.1, 5.0 - COMMITTED + 0.1
    assert known(at(before, 0.0, 0.9)).valid.all()
    assert known(at(beyond, 0.0, 0.9)).valid.tolist() == [[False, True, False]]


def test_a_gate_that_stands_alone_is_all_there_is() -> None:
    found = known(at(*geometry.START), ALONE)
    for seen in (found.in_view, found.valid, found.ahead):
        assert seen.tolist() == [[False, True, False]]
    assert not found.legible.any()
    # The planes of gates that do not stand forbid nothing.
    assert known(at(4.0, 3.9, 0.9), ALONE).valid.tolist() == [[False, True, False]]


# ---- what is done


def test_the_first_action_is_the_expert_s() -> None:
    poses = at(0.3, -0.4, 1.2, yaw=0.2, velocity=(0.8, 0.1, -0.1))
    action = known(poses).action
    assert (action.shape, action.dtype) == ((1, 3, 1, 4), np.float32)
    for gate in range(3):
        wanted = intent(
            poses.position,
            poses.velocity,
            np.array([0.2]),
            geometry.gate_centers(STAGE)[[gate]],
            geometry.gate_yaws(STAGE)[[gate]],
            EXPERT,
        )
        assert action[0, gate, 0] == pytest.approx(np.clip(wanted[0], *np.outer([-1, 1], ACTION_LIMITS)), abs=1e-6)
    assert action[0, 0, 0, 1] > 0 > action[0, 2, 0, 1]  # to the left gate, to the right gate


def test_a_chunk_moves_on_from_its_first_action() -> None:
    poses = at(*geometry.START, velocity=(0.5, 0.0, 0.0))
    one, four = known(poses).action, known(poses, chunk=4).action
    assert four.shape == (1, 3, 4, 4)
    assert four[:, :, :1] == pytest.approx(one)
    # Toward the left gate the nose turns left, so that less and less is left to turn and to fly aside.
    assert (np.diff(four[0, 0, :, 3]) < 0).all()
    assert (np.diff(four[0, 0, :, 1]) < 0).all()
    # The second action is what the expert wants a tenth of a second later, give or take the simple model.
    heading = poses.velocity[0, :3] + (one[0, 1, 0, :3] - poses.velocity[0]) * (1 - math.exp(-0.1 / 0.45))
    later = at(*(poses.position[0] + 0.1 * heading), velocity=tuple(heading), yaw=0.1 * float(one[0, 1, 0, 3]))
    assert four[0, 1, 1] == pytest.approx(known(later).action[0, 1, 0], abs=1e-5)


def test_frames_do_not_depend_on_what_else_is_asked_together() -> None:
    poses = Poses(*(np.concatenate(both) for both in zip(at(0.0, 0.5, 1.0), at(2.0, -1.0, 0.7, yaw=0.5), strict=True)))
    both = truths(poses, [BOARDED, TURNED], 2, EXPERT)
    alone = truths(Poses(*(part[1:] for part in poses)), [TURNED], 2, EXPERT)
    for together, single in zip(both, alone, strict=True):
        np.testing.assert_array_equal(together[1:], single)


def test_targets_follow_the_places_of_a_layout() -> None:
    layout = (GatePlace(4.6, 3.2, 1.5, 0.6), GatePlace(6.0, -0.6, 0.9, -0.2), GatePlace(4.5, -4.1, 1.2, -1.1))
    stage, pose = replace(STAGE, layout=layout), at(*geometry.START)
    found, usual = known(pose, stage), known(pose)
    centers, panels = geometry.gate_centers(stage), geometry.panel_centers(stage)
    np.testing.assert_allclose(panels - centers, np.tile([0.0, 0.0, 1.85], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(found.gate[0], project(centers[None], *pose[:2])[0, :, :2], rtol=1e-5)
    np.testing.assert_allclose(found.panel[0, :3, 0], project(panels[None], *pose[:2])[0, :, 0], rtol=1e-5)
    np.testing.assert_allclose(found.place[0, :, 0], np.linalg.norm(centers - geometry.START, axis=1), rtol=1e-5)
    np.testing.assert_allclose(found.place[0, :, 1], np.sin([0.6, -0.2, -1.1]), rtol=1e-5)
    assert found.panel[0, 0, 1] < usual.panel[0, 0, 1]  # higher above the ground
    assert (np.abs(found.action - usual.action).max(axis=(0, 2, 3)) > 0.02).all()
    assert found.legible[0, :3].all()
