"""Policies with one thing wrong each, around a pilot that flies."""

import functools
from dataclasses import replace

import numpy as np

from cognitivedrone.interfaces import Policy
from cognitivedrone.policies import make_policy


class Broken(Policy):
    """The policy `around` with the fault `how`."""

    def __init__(self, how: str = "", around: str = "small") -> None:
        self.how, self.inner = how, make_policy(around)
        self.needs_ground_truth = self.inner.needs_ground_truth
        self.buffer = np.zeros((1, 4), np.float32)
        self.rng = np.random.default_rng(0)
        self.smooth = np.zeros((1, 4), np.float32)

    def reset(self, context):
        self.told = context.instruction
        self.inner.reset(context)

    def act(self, observation):
        how, image = self.how, observation.image
        if how == "writes":
            image[0, 0] ^= 1
        if how == "reset only":
            observation = replace(observation, instruction=self.told)
        if how == "deaf":
            observation = replace(observation, instruction="Fly through the red gate")
        if how == "raises at foreign text":
            observation.instruction.encode("ascii")
        if how in IMAGES:
            observation = replace(observation, image=np.ascontiguousarray(IMAGES[how](image)))
        if how in STATES:
            observation = with_state(observation, STATES[how])
        chunk = self.inner.act(observation)
        if how in CHUNKS:
            return CHUNKS[how](chunk)
        if how == "noise":
            return chunk + self.rng.normal(0, 0.05, chunk.shape).astype(np.float32)
        if how == "remembers":
            before, self.smooth = self.smooth, chunk
            return 0.8 * chunk + 0.2 * before
        if how == "reuses":
            self.buffer[:] = chunk
            return self.buffer
        return chunk


def with_state(observation, order):
    numbers = np.array([*observation.velocity, observation.height, observation.yaw_rate])
    given = np.array([np.sign(i + 0.5) * numbers[i if i >= 0 else ~i] for i in order])
    velocity, height, yaw_rate = given[:3].astype(np.float32), float(given[3]), float(given[4])
    return replace(observation, velocity=velocity, height=height, yaw_rate=yaw_rate)


IMAGES = {
    "bgr": lambda x: x[..., ::-1],
    "gbr": lambda x: x[..., [1, 2, 0]],
    "mirrored": lambda x: x[:, ::-1],
    "upside down": lambda x: x[::-1],
    "transposed": lambda x: x.transpose(1, 0, 2),
    "turned": np.rot90,
    "channels first": lambda x: x.transpose(2, 0, 1).reshape(x.shape),
    "inverted": lambda x: 255 - x,
    "blind": lambda x: np.full_like(x, 127),
    "divided": lambda x: x // 255,
    "clipped": lambda x: np.where(x > 0, 255, 0).astype(np.uint8),
    "nearly black": lambda x: x // 64,
}
STATES = {
    "height first": (3, 0, 1, 2, 4),
    "height and yaw rate": (0, 1, 2, 4, 3),
    "velocity reversed": (2, 1, 0, 3, 4),
    "height down": (0, 1, 2, ~3, 4),
    "yaw rate right": (0, 1, 2, 3, ~4),
}
CHUNKS = {
    "nan": lambda x: np.full_like(x, np.nan),
    "shape": lambda x: x[0],
    "long": lambda x: np.repeat(x, 40, axis=0),
    "yaw": lambda x: x * np.array([1, 1, 1, -1], np.float32),
    "left": lambda x: x * np.array([1, -1, 1, 1], np.float32),
    "backwards": lambda x: x * np.array([-1, 1, 1, 1], np.float32),
    "normalised": lambda x: x / np.array([3, 3, 1.5, 1], np.float32),
    "twice": lambda x: 2 * x,
    "half": lambda x: x / 2,
    "degrees": lambda x: x * np.array([1, 1, 1, 57.3], np.float32),
    "centimetres": lambda x: x * np.array([100, 100, 100, 1], np.float32),
    "vertical first": lambda x: x[:, [2, 1, 0, 3]],
    "constant": lambda x: np.full_like(x, 0.5),
}


@functools.cache
def answer_of(name):
    """A stateless policy whose answers are remembered by their input, for tests that ask the same again and again."""
    inner, known = make_policy(name), {}

    class Remembered(Policy):
        def reset(self, context):
            inner.reset(context)

        def act(self, observation):
            state = (*observation.velocity.tolist(), observation.height, observation.yaw_rate)
            key = (hash(observation.image.tobytes()), observation.instruction, state)
            if key not in known:
                known[key] = inner.act(observation)
            return known[key].copy()

    return Remembered


class Seeker(Broken):
    """Around the heuristic pilot, which is fast."""

    def __init__(self, how: str = "") -> None:
        super().__init__(how, "colour_seeker")


class Remembering(Broken):
    """Around the packaged model, whose answers are remembered."""

    def __init__(self, how: str = "") -> None:
        super().__init__(how, "hover")
        self.inner = answer_of("small")()


class Slow(Broken):
    """Takes its time, by a clock of its own."""

    now = 0.0

    def __init__(self) -> None:
        super().__init__("", "colour_seeker")

    def act(self, observation):
        Slow.now += 0.35
        return super().act(observation)
