"""Ground truth of frames, as training targets: the image positions of gates, panels and board, and the expert's action
toward each gate. Vectorised over frames.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.frames import rotate_yaw, rotation_matrix, world_to_heading, wrap_angle, yaw_of
from cognitivedrone.policies.expert import ExpertConfig, intent
from cognitivedrone.sim.drawing.views import FOCAL_PX, MOUNT
from cognitivedrone.types import ACTION_LIMITS, CONTROL_HZ, IMAGE_SIZE, FloatArray, Stage
from cognitivedrone.world import geometry

LEGIBLE_HEIGHT = 10.0
"""Minimum height of a legible panel in the image, pixels."""
LEGIBLE_SHARE = 0.6
"""Minimum visible share of a legible panel."""
CLOSEST = 0.15
"""A gate whose plane is nearer than this, m, counts as crossed: it is not a target."""
COMMITTED = 0.8
"""Once a gate's plane is nearer than this, m, other gates are not targets."""
_NEAREST = 0.25  # minimum distance of visible things before the lens, m
_LAG_S = 0.45  # lag of velocity behind command, for the actions after the first of a chunk


class Poses(NamedTuple):
    """The true motion of n drones, each in its own stage."""

    position: FloatArray
    """(n, 3) world, m."""
    quaternion: FloatArray
    """(n, 4) w, x, y, z, body to world."""
    velocity: FloatArray
    """(n, 3) world, m/s."""
    yaw_rate: FloatArray
    """(n,) rad/s."""

    def state(self) -> NDArray[np.float32]:
        """(n, 5) the drone's own state: velocity in the heading frame, m/s, height, m, yaw rate, rad/s."""
        heading = world_to_heading(self.velocity, yaw_of(self.quaternion))
        return np.column_stack([heading, self.position[:, 2], self.yaw_rate]).astype(np.float32)


class Truths(NamedTuple):
    """Ground truth of n frames; pixels count from the left and from the top."""

    gate: NDArray[np.float32]
    """(n, 3, 2) centres of the gates u, v, pixels; far outside if behind the camera."""
    in_view: NDArray[np.bool_]
    """(n, 3) whether that centre is in the image and the gate is still ahead."""
    place: NDArray[np.float32]
    """(n, 3, 3) distance, m, and sine and cosine of the gate's heading relative to the drone's."""
    panel: NDArray[np.float32]
    """(n, 4, 3) boxes of the three panels and the board: centre u, v and height, pixels."""
    legible: NDArray[np.bool_]
    """(n, 4) whether panels and board are legible."""
    action: NDArray[np.float32]
    """(n, 3, chunk, 4) the expert's actions toward each gate, heading frame, m/s and rad/s."""
    valid: NDArray[np.bool_]
    """(n, 3) whether each gate is a valid target."""
    ahead: NDArray[np.bool_]
    """(n, 3) whether each gate has not been crossed."""


def project(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Project world points (n, m, 3) into the images of drones at (n, 3), (n, 4): u, v in pixels and depth in m."""
    axes = rotation_matrix(quaternion)
    eye = position + np.einsum("nij,j->ni", axes, np.array(MOUNT))
    body = np.einsum("nij,nmi->nmj", axes, points - eye[:, None])
    depth = np.maximum(body[..., 0], 1e-2)
    u, v = (IMAGE_SIZE / 2 - FOCAL_PX * body[..., axis] / depth for axis in (1, 2))
    return np.stack([u, v, body[..., 0]], axis=-1)


def truths(poses: Poses, stages: list[Stage], chunk: int, expert: ExpertConfig) -> Truths:
    """Ground truth of the frames of drones at `poses`, each in its own stage."""
    centers = np.stack([geometry.gate_centers(stage) for stage in stages])
    yaws = np.stack([geometry.gate_yaws(stage) for stage in stages])
    stands = np.array([[index in geometry.standing(stage) for index in range(3)] for stage in stages])
    heading = yaw_of(poses.quaternion)
    ahead_m = np.einsum(
        "nmk,nmk->nm", centers[..., :2] - poses.position[:, None, :2], np.stack([np.cos(yaws), np.sin(yaws)], axis=-1)
    )
    ahead = (ahead_m > CLOSEST) & stands
    gate = project(centers, poses.position, poses.quaternion)
    inside = ((gate[..., :2] >= 0) & (gate[..., :2] < IMAGE_SIZE)).all(axis=-1)
    in_view = inside & (gate[..., 2] > _NEAREST) & (ahead_m > 0) & stands
    turned = wrap_angle(yaws - heading[:, None])
    distance = np.linalg.norm(centers - poses.position[:, None], axis=-1)
    nearest = np.where(stands, distance, np.inf).min(axis=1, keepdims=True)
    panel, legible = _panels(poses, stages)
    panelled = np.array([[index in geometry.panelled(stage) for index in range(3)] for stage in stages])
    legible[:, :3] &= panelled & (ahead_m > 0)
    action = _chunks(poses, heading, centers, yaws, chunk, expert)
    return Truths(
        gate=gate[..., :2].astype(np.float32),
        in_view=in_view,
        place=np.stack([distance, np.sin(turned), np.cos(turned)], axis=-1).astype(np.float32),
        panel=panel,
        legible=legible,
        action=action,
        valid=ahead & ((distance <= nearest) | (np.where(stands, ahead_m, np.inf).min(axis=1) > COMMITTED)[:, None]),
        ahead=ahead,
    )


def _panels(poses: Poses, stages: list[Stage]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Boxes (n, 4, 3) of panels and board, and their legibility (n, 4)."""
    board = np.array([[*geometry.BOARD_CENTER]])
    boards = np.stack([rotate_yaw(board, stage.yaw) + np.array([*stage.origin, 0.0]) for stage in stages])
    middles = np.concatenate([np.stack([geometry.panel_centers(stage) for stage in stages]), boards], axis=1)
    half = np.zeros((4, 3))
    half[:3, 2], half[3, 2] = geometry.PANEL_HEIGHT / 2, geometry.BOARD_HEIGHT / 2
    middle, top, bottom = (
        project(points, poses.position, poses.quaternion) for points in (middles, middles + half, middles - half)
    )
    height = np.minimum(bottom[..., 1] - top[..., 1], 4.0 * IMAGE_SIZE)
    u, v = middle[..., 0], (top[..., 1] + bottom[..., 1]) / 2
    share = _overlap(u, height) * _overlap(v, height)
    near = np.minimum(np.minimum(top[..., 2], bottom[..., 2]), middle[..., 2])
    legible = (near > _NEAREST) & (height >= LEGIBLE_HEIGHT) & (share >= LEGIBLE_SHARE)
    legible[:, 3] &= np.array([stage.board is not None for stage in stages])
    return np.stack([u, v, height], axis=-1).clip(-2000, 2000).astype(np.float32), legible


def _overlap(middle: FloatArray, size: FloatArray) -> FloatArray:
    """Share of the interval around `middle` inside the image."""
    low, high = np.maximum(middle - size / 2, 0.0), np.minimum(middle + size / 2, IMAGE_SIZE)
    share: FloatArray = np.maximum(high - low, 0.0) / np.maximum(size, 1e-6)
    return share


def _chunks(
    poses: Poses, heading: FloatArray, centers: FloatArray, yaws: FloatArray, chunk: int, expert: ExpertConfig
) -> NDArray[np.float32]:
    """The expert's actions (n, 3, chunk, 4) toward each gate; those after the first at predicted states, from a simple
    model of the drone whose velocity follows the command with a lag.
    """
    position = np.repeat(poses.position[:, None], 3, axis=1)
    velocity = np.repeat(poses.velocity[:, None], 3, axis=1)
    yaw = np.repeat(heading[:, None], 3, axis=1)
    limits, period = np.array(ACTION_LIMITS), 1 / CONTROL_HZ
    actions = []
    for _ in range(chunk):
        action = np.clip(intent(position, velocity, yaw, centers, yaws, expert), -limits, limits)
        actions.append(action)
        wanted = rotate_yaw(action[..., :3], yaw)
        velocity = velocity + (wanted - velocity) * (1 - np.exp(-period / _LAG_S))
        position = position + velocity * period
        yaw = yaw + action[..., 3] * period
    return np.stack(actions, axis=2).astype(np.float32)
