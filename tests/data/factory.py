"""Synthetic flights: smooth, seeded, cheap, and as odd in their numbers as real ones."""

import numpy as np

from cognitivedrone.data.episode import Conditions, Encoding, Episode, encode_image
from cognitivedrone.frames import quaternion_from_yaw, world_to_heading
from cognitivedrone.tasks import BASE_FAMILIES, train_task

DT = 0.1


def make_episode(
    index: int = 0, length: int = 8, family: str | None = None, encoding: Encoding = "png", *, down: bool = False
) -> Episode:
    """A flight of `length` steps along a gentle curve; the same arguments give the same bits.

    With `down`, a camera that looks down saw the mirrored pictures.
    """
    rng = np.random.default_rng([7, index])
    order = index if family is None else index * len(BASE_FAMILIES) + BASE_FAMILIES.index(family)
    yaw = rng.uniform(-1, 1) + np.cumsum(rng.normal(0.03, 0.01, length + 1))
    speed = rng.uniform(1, 2)
    start = np.array([-1.0, 0.0, 0.75]) + rng.uniform(-0.5, 0.5, 3)
    steps = DT * np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), rng.uniform(-0.1, 0.1, length + 1)])
    points = start + np.cumsum(steps, axis=0)
    velocity = world_to_heading(np.diff(points, axis=0) / DT, yaw[:-1]).astype(np.float32)
    yaw_rate = (np.diff(yaw) / DT).astype(np.float32)
    action = np.column_stack([velocity, yaw_rate])
    return Episode(
        index=index,
        suite="open-v1:train",
        task=train_task(order),
        conditions=Conditions(
            seed=3,
            airframe="x500",
            look="varied",
            start_position=(float(points[0, 0]), float(points[0, 1]), float(points[0, 2])),
            start_yaw=float(yaw[0]),
            wind=(0.1, -0.2, 0.0),
        ),
        encoding=encoding,
        images=tuple(encode_image(make_image(index, step), encoding) for step in range(length)),
        action=action,
        sent=action + rng.normal(0, 0.1, action.shape).astype(np.float32),
        velocity=velocity,
        height=points[:-1, 2].astype(np.float32),
        yaw_rate=yaw_rate,
        position=points[:-1],
        quaternion=quaternion_from_yaw(yaw[:-1]).astype(np.float64),
        final_position=points[-1],
        down=tuple(encode_image(make_image(index, step)[:, ::-1], encoding) for step in range(length if down else 0)),
    )


def make_image(index: int, step: int) -> np.ndarray:
    """(256, 256, 3) a gradient with a square that moves from step to step."""
    ramp = np.linspace(0, 255, 256).astype(np.uint8)
    image = np.stack([np.tile(ramp, (256, 1)), np.tile(ramp[:, None], (1, 256)), np.full((256, 256), index % 256)], -1)
    image = image.astype(np.uint8)
    left = (8 * step) % 224
    image[96:128, left : left + 32] = (255, 0, 30 * step % 256)
    return image


def assert_same_episode(a: Episode, b: Episode) -> None:
    """Every field of both is the same, to the bit."""
    for name in ("action", "sent", "velocity", "height", "yaw_rate", "position", "quaternion", "final_position"):
        x, y = getattr(a, name), getattr(b, name)
        assert x.dtype == y.dtype, name
        np.testing.assert_array_equal(x, y, err_msg=name)
    for name in ("index", "suite", "task", "conditions", "encoding", "images", "down"):
        assert getattr(a, name) == getattr(b, name), name
