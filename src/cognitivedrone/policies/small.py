"""The small VLA policy: image, drone motion and a sentence in, velocities out; ONNX Runtime runs it on one core."""

from __future__ import annotations

import copy
import os
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from importlib import resources
from pathlib import Path
from string import punctuation
from typing import Self, cast

import numpy as np

from cognitivedrone.errors import ModelError, NonFiniteAction, PluginError, PolicyError
from cognitivedrone.interfaces import Policy, attempt
from cognitivedrone.models.small_file import Output, SmallModel
from cognitivedrone.types import IMAGE_SIZE, ActionChunk, EpisodeContext, FloatArray, Image, Observation

LONGEST_INSTRUCTION = 1000
"""Maximum length in characters."""
TOLD = 5
"""Maximum number of warnings about unknown words; whole suites are full of them."""
_VISIBLE = 0.3  # minimum score of a visible gate
_NEAR_M = 1.2  # nearer to a gate, panels leave the view
_ENOUGH = 8  # frames
_NEWEST = 0.15  # minimum weight of the newest frame
_DECLINE, _RESUME = 0.15, 0.4  # mean probabilities
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

    Its actions depend on the current observation only, but for one thing: it declines, and hovers, when the frames of a
    second agree that no gate matches the instruction. Raises `PolicyError` if the file is missing or unusable.

    For several flights at once it uses all cores, one frame at a time, so that each answer is that of `act` to the bit.
    With `stack`, up to so many frames go through the network together: faster, but rounded differently.
    """

    weights = "small.onnx"
    """The packaged file, in `cognitivedrone/models/weights`."""
    warns = True
    """Whether to warn about words that the model has never seen."""

    def __init__(self, path: Path | str | None = None, *, stack: int = 1) -> None:
        if stack < 1:
            raise PluginError(f"policy 'small': stack is {stack}; it must be at least 1")
        self._stack = stack
        self._threads: ThreadPoolExecutor | None = None
        self.model = SmallModel.load(self.file_of(path))
        self.last: Output | None = None
        """The network's output for the last frame, n = 1, for viewers; none before the first."""
        self._text = ""
        self._presence = Presence()
        self.declines = False
        self._words_told: set[str] = set()
        self._sentences_told = 0

    @property
    def present(self) -> float | None:  # type: ignore[override]
        """Mean over the frames so far that show three gates; none before the first, and for weights without it."""
        return self._presence.mean if self._presence.frames else None

    @classmethod
    def file_of(cls, path: Path | str | None = None, *, stack: int = 1) -> Path:  # noqa: ARG003
        """The model file of a policy made with `path`; raises `PolicyError` if it does not exist."""
        packaged = Path(str(resources.files("cognitivedrone.models") / "weights" / cls.weights))
        if path is None and not packaged.is_file():
            raise ModelError(
                f"this installation has no model {cls.weights}: reinstall cognitivedrone, or train one with"
                " `cognitivedrone train` and give its file, as in --policy small:model.onnx"
            )
        found = packaged if path is None else Path(path)
        if not found.is_file():
            raise ModelError(f"there is no model file {found}")
        return found

    def reset(self, context: EpisodeContext) -> None:
        """Take a new instruction.

        Raises `PolicyError` if it is empty or longer than `LONGEST_INSTRUCTION`. Warns once about each word that the
        model has never seen, for the first few sentences only.
        """
        self.last = None
        self._presence, self.declines = Presence(), False
        self._listen(context.instruction)

    def act(self, observation: Observation) -> ActionChunk:
        """Commands (k, 4) for the next k control steps, for the observation's instruction.

        Raises `PolicyError` for an invalid instruction, as `reset`, or an image that is not uint8 (256, 256, 3), and
        `NonFiniteAction` if the network's output is not finite.
        """
        frame = self._frame(observation)
        return self._decide(frame, self.model.run(frame.image[None], frame.state[None], (frame.text,)))

    def fork(self) -> Self:
        """As `Policy.fork`."""
        other = copy.copy(self)
        other.last, other._text, other._threads = None, "", None
        other._presence, other.declines = Presence(), False
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
            self._presence = Presence()
        return _Frame(_checked(observation.image), state_of(observation), self._text)

    def _outputs(self, frames: Sequence[_Frame]) -> Sequence[Output | Exception]:
        """The network's outputs for frames of several flights, n = 1 each."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        size = max(1, min(self._stack, -(-len(frames) // cores)))
        groups = [frames[first : first + size] for first in range(0, len(frames), size)]
        if len(groups) < 2:
            return [output for group in groups for output in _run(self.model, group)]
        self._threads = self._threads or ThreadPoolExecutor(cores, "small")
        return [output for group in self._threads.map(partial(_run, self.model), groups) for output in group]

    def _decided(self, frame: _Frame, output: Output | Exception) -> ActionChunk | Exception:
        return output if isinstance(output, Exception) else attempt(partial(self._decide, frame), output)

    def _decide(self, frame: _Frame, output: Output) -> ActionChunk:
        """The action for a frame, from the network's output (n = 1)."""
        self.last = output
        action: ActionChunk = output.action[0]
        if not np.isfinite(action).all():
            raise NonFiniteAction(f"the model answered {action[0].tolist()} to the state {frame.state.tolist()}")
        self.declines = self._presence.update(output)
        return np.zeros_like(action) if self.declines else action

    def _listen(self, text: str) -> None:
        if not text.strip():
            raise PolicyError("the instruction is empty; say which gate to fly through")
        if len(text) > LONGEST_INSTRUCTION:
            raise PolicyError(
                f"the instruction has {len(text)} characters; the small model reads at most {LONGEST_INSTRUCTION}"
            )
        if self.warns and text != self._text:
            self._warn_of(text)
        self._text = text

    def _warn_of(self, text: str) -> None:
        known = self.model.description.vocabulary
        words = [word for word in known.unknown(text) if word not in self._words_told and word not in punctuation]
        if not words or self._sentences_told == TOLD:
            return
        self._words_told.update(words)
        self._sentences_told += 1
        last = "; no further warnings about words" if self._sentences_told == TOLD else ""
        named = ", ".join(map(repr, sorted(words)))
        warnings.warn(f"the small model has never seen {named}; it flies by the other words{last}", stacklevel=4)


@dataclass(frozen=True, slots=True)
class _Frame:
    """The network's inputs."""

    image: Image
    state: FloatArray
    text: str


def _run(model: SmallModel, frames: Sequence[_Frame]) -> Sequence[Output | Exception]:
    """The outputs, n = 1, for frames that go through the network together."""
    images, states = (np.stack([getattr(frame, name) for frame in frames]) for name in ("image", "state"))
    outputs = attempt(partial(model.run, images, states), [frame.text for frame in frames])
    if isinstance(outputs, Exception):
        return [outputs] * len(frames)
    values = {field.name: getattr(outputs, field.name) for field in fields(Output)}
    return [
        replace(outputs, **{name: value[row : row + 1] for name, value in values.items() if value is not None})
        for row in range(len(frames))
    ]


class Race(Small):
    """The racing model, for single gates of any kind. The only instruction that it knows is "Fly through the gates"."""

    weights = "race.onnx"
    warns = False


def state_of(observation: Observation) -> FloatArray:
    """The network's motion input, (5,) float32.

    Velocity x, y, z in the heading frame, m/s, height, m, and yaw rate, rad/s.
    """
    return np.array([*observation.velocity, observation.height, observation.yaw_rate], dtype=np.float32)


def _checked(image: Image) -> Image:
    if image.dtype != np.uint8 or image.shape != _SHAPE:
        raise PolicyError(f"the small model needs a uint8 image of shape {_SHAPE}, got {image.dtype} {image.shape}")
    return image
