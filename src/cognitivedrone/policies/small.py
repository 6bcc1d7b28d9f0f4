"""The small VLA policy: image, drone motion and a sentence in, velocities out; ONNX Runtime runs it on one core."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Self, cast

import numpy as np

from cognitivedrone.errors import ModelError, NonFiniteAction, PluginError, PolicyError
from cognitivedrone.interfaces import Policy, attempt
from cognitivedrone.models.eyes.obstacle_eye import ObstacleEye, eye_of
from cognitivedrone.models.eyes.opinions import Opinions
from cognitivedrone.models.onnx_file import check_model_file
from cognitivedrone.models.small_file import Output, SmallModel
from cognitivedrone.policies.avoidance import Avoidance
from cognitivedrone.system import cores
from cognitivedrone.types import IMAGE_SIZE, Action, ActionChunk, EpisodeContext, FloatArray, Image, Observation

LONGEST_INSTRUCTION = 1000
"""Maximum length in characters."""
_VISIBLE = 0.3  # minimum score of a visible gate
_NEAR_M = 1.2  # nearer to a gate, panels leave the view
_ENOUGH = 4  # frames: soon the panels beside the chosen one leave the view
_NEWEST = 0.15  # minimum weight of the newest frame
_DECLINE, _RESUME = 0.2, 0.4  # mean probabilities
_LOOKS = 1  # of the picture classifier in a frame: it costs as much as the rest
_SHAPE = (IMAGE_SIZE, IMAGE_SIZE, 3)


@dataclass(slots=True)
class Presence:
    """Whether a gate matches the instruction, from the network's answers to all frames so far that show three gates."""

    frames: int = 0
    mean: float = 1.0
    """Mean probability that one of the gates is the right one; newer frames weigh more."""
    declining: bool = False

    def update(self, output: Output) -> bool:
        """Process the answer to a frame (n = 1); returns whether to decline."""
        scores, distances = output.gates[0, :, 2], output.gates[0, :, 3]
        if output.present is None or (scores < _VISIBLE).any() or distances.min() < _NEAR_M:
            return self.declining
        self.frames += 1
        self.mean += max(_NEWEST, 1 / self.frames) * (float(output.present[0]) - self.mean)
        # Hysteresis, so that a drone that hovers does not waver.
        limit = _RESUME if self.declining else _DECLINE
        self.declining = self.frames >= _ENOUGH and self.mean < limit
        return self.declining


class Small(Policy):
    """Flies a small model: the packaged one, or the file at `path`.

    Its actions depend on the current observation only, but for three things: it declines, and hovers, when the first
    frames agree that no gate matches the instruction; what the picture classifier thought of a panel in earlier frames
    counts; and it remembers obstacles that have left its view, around which it flies (`avoidance`). Raises
    `PolicyError` if the file is missing or unusable.

    For several flights at once it uses all cores, one frame at a time, so that each answer is that of `act` to the bit.
    With `stack`, up to so many frames go through the network together: faster, but rounded differently. Without `avoid`
    it sees no obstacles.
    """

    reads_english_only = True

    weights = "small.onnx"
    """The packaged file, in `cognitivedrone/models/weights`."""

    def __init__(self, path: Path | str | None = None, *, stack: int = 1, avoid: bool = True) -> None:
        if stack < 1:
            raise PluginError(f"policy 'small': stack is {stack}; it must be at least 1")
        self._stack = stack
        self._threads: ThreadPoolExecutor | None = None
        file = self.file_of(path)
        self.model = SmallModel.load(file)
        self._eye = ObstacleEye.load(eye_of(file)) if avoid else None
        self._avoidance = Avoidance()
        self._opinions = None if self.model.opinions is None else self.model.opinions.fork()
        self.last: Output | None = None
        """The network's output for the last frame, n = 1, for viewers; none before the first."""
        self._text = ""
        self._state: FloatArray | None = None
        self._presence = Presence()
        self.declines = False

    @property
    def present(self) -> float | None:  # type: ignore[override]
        """Mean over the frames so far that show three gates; none before the first, and for weights without it."""
        return self._presence.mean if self._presence.frames else None

    @classmethod
    def file_of(cls, path: Path | str | None = None, *, stack: int = 1, avoid: bool = True) -> Path:  # noqa: ARG003
        """The model file of a policy made with `path`; raises `ModelError` if it does not exist or is too large."""
        packaged = Path(str(resources.files("cognitivedrone.models") / "weights" / cls.weights))
        if path is None and not packaged.is_file():
            raise ModelError(
                f"this installation has no model {cls.weights}: reinstall cognitivedrone, or train one with"
                " `cognitivedrone train` and give its file, as in --policy small:model.onnx"
            )
        found = packaged if path is None else Path(path)
        check_model_file(found)  # a run hashes it before it is loaded
        return found

    def reset(self, context: EpisodeContext) -> None:
        """Take a new instruction.

        Raises `PolicyError` if it is empty or longer than `LONGEST_INSTRUCTION`.
        """
        self.last = self._state = None
        self._forget()
        self._avoidance = Avoidance()
        self.declines = False
        self._listen(context.instruction)

    def act(self, observation: Observation) -> ActionChunk:
        """Commands (k, 4) for the next k control steps, for the observation's instruction.

        Raises `PolicyError` for an invalid instruction, as `reset`, or an image that is not uint8 (256, 256, 3), and
        `NonFiniteAction` if the network's output is not finite.
        """
        frame = self._frame(observation)
        (output,) = _run(self.model, self._eye, [frame])
        if isinstance(output, Exception):
            raise output
        return self._decide(frame, output)

    def around(self, action: Action) -> Action:
        """As `Policy.around`: the obstacles in the newest frame, and those seen before."""
        state = self._state
        return (
            action if state is None or self._eye is None else self._avoidance.around(action, state[:3], float(state[3]))
        )

    def fork(self) -> Self:
        """As `Policy.fork`."""
        other = copy.copy(self)
        other.last, other._state, other._text, other._threads = None, None, "", None
        other._avoidance = Avoidance()
        other._presence, other.declines = Presence(), False
        other._opinions = None if self._opinions is None else self._opinions.fork()
        return other

    def act_batch(
        self, sessions: Sequence[Policy], observations: Sequence[Observation]
    ) -> Sequence[ActionChunk | Exception]:
        """As `Policy.act_batch`, on all cores; see the class."""
        forks = cast(Sequence[Small], sessions)
        frames = [attempt(fork._frame, seen) for fork, seen in zip(forks, observations, strict=True)]
        outputs = iter(self._outputs([frame for frame in frames if isinstance(frame, _Frame)]))
        return [
            frame if isinstance(frame, Exception) else fork._decided(frame, next(outputs))
            for fork, frame in zip(forks, frames, strict=True)
        ]

    def close(self) -> None:
        """End the threads of `act_batch`."""
        if self._threads is not None:
            self._threads.shutdown()

    def _frame(self, observation: Observation) -> _Frame:
        """The network's inputs for an observation."""
        if observation.instruction != self._text:
            self._listen(observation.instruction)
            self._forget()
        state = state_of(observation)
        return _Frame(_checked(observation.image), state, self._text, self._opinions, observation.time)

    def _forget(self) -> None:
        """What earlier frames have shown."""
        self._presence = Presence()
        if self._opinions is not None:
            self._opinions.reset()

    def _outputs(self, frames: Sequence[_Frame]) -> Sequence[Output | Exception]:
        """The network's outputs for frames of several flights, n = 1 each."""
        number = cores()
        size = max(1, min(self._stack, -(-len(frames) // number)))
        groups = [frames[first : first + size] for first in range(0, len(frames), size)]
        if len(groups) < 2:
            return [output for group in groups for output in _run(self.model, self._eye, group)]
        self._threads = self._threads or ThreadPoolExecutor(number, "small")
        return [output for group in self._threads.map(partial(_run, self.model, self._eye), groups) for output in group]

    def _decided(self, frame: _Frame, output: Output | Exception) -> ActionChunk | Exception:
        return output if isinstance(output, Exception) else attempt(partial(self._decide, frame), output)

    def _decide(self, frame: _Frame, output: Output) -> ActionChunk:
        """The action for a frame, from the network's output (n = 1)."""
        self.last, self._state = output, frame.state
        action: ActionChunk = output.action[0]
        if not np.isfinite(action).all():
            raise NonFiniteAction(f"the model answered {action[0].tolist()} to the state {frame.state.tolist()}")
        if name := output.without_numbers():  # the drone would look for a gate until its time is over
            raise NonFiniteAction(
                f"the model's {name} holds values that are not numbers, for the state {frame.state.tolist()}; if it is"
                " so for every frame, its weights are damaged: train or download it again"
            )
        self.declines = self._presence.update(output)
        action = self._around(action, frame, output)
        return np.zeros_like(action) if self.declines else action

    def _around(self, action: ActionChunk, frame: _Frame, output: Output) -> ActionChunk:
        """The commands that fly around the obstacles of a frame, and those seen before."""
        if output.occupied is None or output.depth is None:
            return action
        velocity, height, yaw_rate = frame.state[:3], float(frame.state[3]), float(frame.state[4])
        self._avoidance.see(output.occupied[0], output.depth[0], velocity, yaw_rate, frame.time)
        return np.stack([self._avoidance.around(each, velocity, height) for each in action])

    def _listen(self, text: str) -> None:
        if not text.strip():
            raise PolicyError("the instruction is empty; say which gate to fly through")
        if len(text) > LONGEST_INSTRUCTION:
            raise PolicyError(
                f"the instruction has {len(text)} characters; the small model reads at most {LONGEST_INSTRUCTION}"
            )
        self._text = text


@dataclass(frozen=True, slots=True)
class _Frame:
    """The network's inputs."""

    image: Image
    state: FloatArray
    text: str
    opinions: Opinions | None
    """Of the frame's flight."""
    time: float
    """Since the start of the flight, s."""


def _run(model: SmallModel, eye: ObstacleEye | None, frames: Sequence[_Frame]) -> Sequence[Output | Exception]:
    """The outputs, n = 1, for frames that go through the networks together; then their panels are looked at again."""
    images, states = (np.stack([getattr(frame, name) for frame in frames]) for name in ("image", "state"))
    opinions = [frame.opinions for frame in frames]
    outputs = attempt(partial(model.run, images, states, opinions=opinions), [frame.text for frame in frames])
    if isinstance(outputs, Exception):
        return [outputs] * len(frames)
    if outputs.panels is not None:
        for frame, gates, panels in zip(frames, outputs.gates, outputs.panels, strict=True):
            there = panels[gates[:, 2] > _VISIBLE]
            if frame.opinions is not None:
                frame.opinions.look(frame.image, there[:, :3], there[:, 3].astype(int).tolist(), _LOOKS)
    if eye is not None:
        seen = attempt(eye.look, images)
        if isinstance(seen, Exception):
            return [seen] * len(frames)
        outputs = replace(outputs, occupied=seen[0], depth=seen[1])
    values = {field.name: getattr(outputs, field.name) for field in fields(Output)}
    return [
        replace(outputs, **{name: value[row : row + 1] for name, value in values.items() if value is not None})
        for row in range(len(frames))
    ]


class Race(Small):
    """The racing model, for single gates of any kind. It reads no instruction: it is for "Fly through the gates"."""

    weights = "race.onnx"

    def __init__(self, path: Path | str | None = None, *, stack: int = 1) -> None:
        super().__init__(path, stack=stack, avoid=False)


def state_of(observation: Observation) -> FloatArray:
    """The network's motion input, (5,) float32.

    Velocity x, y, z in the heading frame, m/s, height, m, and yaw rate, rad/s.
    """
    return np.array([*observation.velocity, observation.height, observation.yaw_rate], dtype=np.float32)


def _checked(image: Image) -> Image:
    if image.dtype != np.uint8 or image.shape != _SHAPE:
        raise PolicyError(f"the small model needs a uint8 image of shape {_SHAPE}, got {image.dtype} {image.shape}")
    return image
