"""The small VLA policy: image, drone motion and a sentence in, velocities out; ONNX Runtime runs it on one core."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, NonFiniteAction, PluginError, PolicyError
from cognitivedrone.interfaces import Policy, attempt
from cognitivedrone.models.eyes.obstacle_eye import ObstacleEye, eye_of
from cognitivedrone.models.eyes.opinions import Opinions
from cognitivedrone.models.eyes.picture_classifier import PictureClassifier, classifier_of
from cognitivedrone.models.eyes.sight import EYES_FILE, Sight
from cognitivedrone.models.mind import LANGUAGE_FILE, Mind, fits_of
from cognitivedrone.models.onnx_file import check_model_file, shares_of
from cognitivedrone.models.small_file import MODEL_FILE, Flown, SmallModel
from cognitivedrone.models.words.concepts import concepts_of
from cognitivedrone.models.words.text_encoder import encoder_of
from cognitivedrone.models.words.word_pieces import pieces_of
from cognitivedrone.policies.avoidance import Avoidance
from cognitivedrone.sim.drawing.views import FOCAL_PX, MOUNT
from cognitivedrone.system import cores
from cognitivedrone.tasks.directives import looks_asked
from cognitivedrone.types import COLORS, IMAGE_SIZE, Action, ActionChunk, EpisodeContext, FloatArray, Image, Observation

LONGEST_INSTRUCTION = 1000
"""Maximum length in characters."""
_VISIBLE, _BOARD = 0.3, 0.5  # minimum scores of a visible gate and board
_NEAR_M = 1.2  # nearer to a gate, panels leave the view
_ENOUGH = 4  # frames: soon the panels beside the chosen one leave the view
_NEWEST = 0.15  # minimum weight of the newest frame
_SURE = 4.0  # log-odds of a gate that looks as asked; one of another colour is worth less than to look for it
_LEAST = 1e-6  # probability of a gate that does not
_DECLINE, _RESUME = 0.2, 0.4  # mean probabilities
_WATCH_S = 0.15  # between frames in which obstacles are looked for
_LEVELS_M = (3.0, 4.0)  # from a gate: height is flown by its place in the image, and by the head alone from there
_CLIMB_PER_S, _FASTEST = 1.2, 0.8  # 1/s and m/s, to its middle
_LOOKS = 1  # of the picture classifier in a frame: it costs as much as the rest
_SHAPE = (IMAGE_SIZE, IMAGE_SIZE, 3)


@dataclass(frozen=True, slots=True)
class Decision:
    """What is decided on one frame, for viewers, too."""

    action: ActionChunk
    """(k, 4), heading frame, m/s and rad/s."""
    choice: FloatArray
    """(4,) probability that each gate in view is the right one; last, that none of them is."""
    gates: FloatArray
    """(3, 4) for each gate: centre u, v in pixels, detection score 0 to 1, distance in m."""
    present: float | None = None
    """Probability that one of them is what the sentence asks for; None of models that read no sentences."""
    occupied: FloatArray | None = None
    """(16, 16) for each part of the frame, rows from the top: probability of an obstacle; None where nobody asked, as
    in every other frame."""
    depth: FloatArray | None = None
    """(16, 16) its distance along the camera's axis, m, if there is one."""

    def without_numbers(self) -> str | None:
        """The name of the first part beside the action, which follows from them, that holds a value which is not a
        number; none if there is none.
        """
        parts = ((field.name, getattr(self, field.name)) for field in fields(self)[1:])
        return next((name for name, value in parts if value is not None and np.isnan(value).any()), None)


@dataclass(slots=True)
class Presence:
    """Whether a gate matches the instruction, from what was decided on all frames so far that show three gates."""

    frames: int = 0
    mean: float = 1.0
    """Mean probability that one of the gates is the right one; newer frames weigh more."""
    declining: bool = False

    def update(self, decision: Decision) -> bool:
        """Process what was decided on a frame; returns whether to decline."""
        scores, distances = decision.gates[:, 2], decision.gates[:, 3]
        if decision.present is None or (scores < _VISIBLE).any() or distances.min() < _NEAR_M:
            return self.declining
        self.frames += 1
        self.mean += max(_NEWEST, 1 / self.frames) * (decision.present - self.mean)
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

    weights = "small"
    """The folder of the packaged files, in `cognitivedrone/models/weights`."""

    def __init__(self, path: Path | str | None = None, *, stack: int = 1, avoid: bool = True) -> None:
        if stack < 1:
            raise PluginError(f"policy 'small': stack is {stack}; it must be at least 1")
        self._stack = stack
        self._threads: ThreadPoolExecutor | None = None
        file, *_ = self.file_of(path)
        self.model = SmallModel.load(file)
        self._eye = ObstacleEye.load(eye_of(file)) if avoid else None
        self._avoidance = Avoidance()
        asks = self.model.mind is not None and self.model.eyes.classifier
        classifier = PictureClassifier.of(classifier_of(file)) if asks else None
        self._opinions = None if classifier is None else Opinions(classifier, self.model.eyes.attributes)
        self.last: Decision | None = None
        """What was decided on the last frame; none before the first."""
        self._text = ""
        self._state: FloatArray | None = None
        self._watched = -np.inf
        """When obstacles were looked for last, s."""
        self._presence = Presence()
        self.declines = False

    @property
    def present(self) -> float | None:  # type: ignore[override]
        """Mean over the frames so far that show three gates; none before the first, and for weights without it."""
        return self._presence.mean if self._presence.frames else None

    @classmethod
    def file_of(cls, path: Path | str | None = None, *, stack: int = 1, avoid: bool = True) -> tuple[Path, ...]:  # noqa: ARG003
        """Every file that a policy made with `path` decides by, its head first; raises `ModelError` if one does not
        exist or is too large.
        """
        packaged = Path(str(resources.files("cognitivedrone.models") / "weights" / cls.weights / MODEL_FILE))
        if path is None and not packaged.is_file():
            raise ModelError(
                f"this installation has no model {cls.weights}: reinstall cognitivedrone, or train one with"
                " `cognitivedrone train` and give its file, as in --policy small:model.onnx"
            )
        head = packaged if path is None else Path(path)
        found = [head, head.with_name(EYES_FILE), *([eye_of(head)] if avoid else [])]
        if (language := head.with_name(LANGUAGE_FILE)).is_file():
            found += [language, classifier_of(head), concepts_of(head), encoder_of(head), pieces_of(head)]
        for file in found:
            check_model_file(file)  # a run hashes it before it is loaded
        return tuple(found)

    def reset(self, context: EpisodeContext) -> None:
        """Take a new instruction.

        Raises `PolicyError` if it is empty or longer than `LONGEST_INSTRUCTION`.
        """
        self.last = self._state = None
        self._forget()
        self._avoidance, self._watched = Avoidance(), -np.inf
        self.declines = False
        self._listen(context.instruction)

    def act(self, observation: Observation) -> ActionChunk:
        """Commands (k, 4) for the next k control steps, for the observation's instruction.

        Raises `PolicyError` for an invalid instruction, as `reset`, or an image that is not uint8 (256, 256, 3), and
        `NonFiniteAction` if the network's output is not finite.
        """
        frame = self._frame(observation)
        (decision,) = _run(self.model, self._eye, [frame])
        if isinstance(decision, Exception):
            raise decision
        return self._follow(frame, decision)

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
        other._avoidance, other._watched = Avoidance(), -np.inf
        other._presence, other.declines = Presence(), False
        other._opinions = None if self._opinions is None else self._opinions.fork()
        return other

    def act_batch(
        self, sessions: Sequence[Policy], observations: Sequence[Observation]
    ) -> Sequence[ActionChunk | Exception]:
        """As `Policy.act_batch`, on all cores; see the class."""
        forks = cast(Sequence[Small], sessions)
        frames = [attempt(fork._frame, seen) for fork, seen in zip(forks, observations, strict=True)]
        decisions = iter(self._decisions([frame for frame in frames if isinstance(frame, _Frame)]))
        return [
            frame if isinstance(frame, Exception) else fork._followed(frame, next(decisions))
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
        watch = self._eye is not None and not 0 <= observation.time - self._watched < _WATCH_S
        self._watched = observation.time if watch else self._watched
        return _Frame(_checked(observation.image), state, self._text, self._opinions, observation.time, watch)

    def _forget(self) -> None:
        """What earlier frames have shown."""
        self._presence = Presence()
        if self._opinions is not None:
            self._opinions.reset()

    def _decisions(self, frames: Sequence[_Frame]) -> Sequence[Decision | Exception]:
        """What is decided on frames of several flights."""
        number = cores()
        size = max(1, min(self._stack, -(-len(frames) // number)))
        groups = [frames[first : first + size] for first in range(0, len(frames), size)]
        if len(groups) < 2:
            return [made for group in groups for made in _run(self.model, self._eye, group)]
        self._threads = self._threads or ThreadPoolExecutor(number, "small")
        return [made for group in self._threads.map(partial(_run, self.model, self._eye), groups) for made in group]

    def _followed(self, frame: _Frame, decision: Decision | Exception) -> ActionChunk | Exception:
        return decision if isinstance(decision, Exception) else attempt(partial(self._follow, frame), decision)

    def _follow(self, frame: _Frame, decision: Decision) -> ActionChunk:
        """The action for a frame, from what was decided on it."""
        self.last, self._state = decision, frame.state
        if name := decision.without_numbers():  # the drone would look for a gate until its time is over
            raise NonFiniteAction(
                f"the model's {name} holds values that are not numbers, for the state {frame.state.tolist()}; if it is"
                " so for every frame, its weights are damaged: train or download it again"
            )
        if not np.isfinite(decision.action).all():
            raise NonFiniteAction(
                f"the model answered {decision.action[0].tolist()} to the state {frame.state.tolist()}"
            )
        self.declines = self._presence.update(decision)
        action = self._avoiding(frame, decision)
        return np.zeros_like(action) if self.declines else action

    def _avoiding(self, frame: _Frame, decision: Decision) -> ActionChunk:
        """The commands that fly around the obstacles of a frame, and those seen before."""
        if self._eye is None:
            return decision.action
        velocity, height, yaw_rate = frame.state[:3], float(frame.state[3]), float(frame.state[4])
        self._avoidance.move(velocity, yaw_rate, frame.time)
        if decision.occupied is not None and decision.depth is not None:
            self._avoidance.see(decision.occupied, decision.depth)
        return np.stack([self._avoidance.around(each, velocity, height) for each in decision.action])

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
    watch: bool = False
    """Whether to look for obstacles."""


def _run(model: SmallModel, eye: ObstacleEye | None, frames: Sequence[_Frame]) -> Sequence[Decision | Exception]:
    """What is decided on frames that go through the networks together."""
    try:
        images, states = (np.stack([getattr(frame, name) for frame in frames]) for name in ("image", "state"))
        sight = model.eyes.see(images)
        flown = model.fly(sight, states)
        seen: list[tuple[FloatArray, ...]] = [()] * len(frames)
        watched = [row for row, frame in enumerate(frames) if frame.watch]
        if watched and eye is not None:
            for row, *found in zip(watched, *eye.look(images[watched]), strict=True):
                seen[row] = tuple(found)
    except Exception as error:  # of every frame
        return [error] * len(frames)
    return [attempt(partial(_decide, model, sight, flown, seen[row], row), frame) for row, frame in enumerate(frames)]


def _decide(
    model: SmallModel,
    sight: Sight,
    flown: Flown,
    seen: tuple[FloatArray, ...],
    row: int,
    frame: _Frame,
) -> Decision:
    """Choose among the gates of a frame, and those alone that are surely there."""
    gates, logits = sight.gates[row], flown.inclination[row].copy()
    there, present = gates[:, 2] > _VISIBLE, None
    if model.mind is not None and sight.readings is not None and sight.boxes is not None:
        asked, present = _judged(model.mind, sight.readings[row], sight.boxes[row], sight.looks[row], there, frame)
        logits[:3] += asked
    choice = shares_of(np.where([*there, True], logits, -np.inf))
    best = int(choice.argmax())
    action = flown.options[row, best]
    if best < len(gates):
        action = _levelled(action, gates[best])
    return Decision(action, choice, gates, present, *seen)


def _judged(
    mind: Mind, readings: FloatArray, boxes: FloatArray, looks: FloatArray, there: NDArray[np.bool_], frame: _Frame
) -> tuple[FloatArray, float]:
    """Logits (3,) of the gates by what the sentence asks for, and the probability that one of them is it.

    A directive, and whatever else names a gate by its looks alone, is about nothing but the looks. Whoever gives a
    directive, which names all of them, knows that the gate is there: an obstacle before it hides its shape and size,
    and may itself be taken for a gate, of a colour that is there twice then.
    """
    colors = looks[:, : len(COLORS)].argmax(axis=1)
    if (asked := looks_asked(frame.text)) is not None:
        fits = fits_of(asked, looks) * there
        present = 1 - float((1 - (fits if None in asked else np.cbrt(fits))).prod())
        doubled = None not in asked and len({*colors[there].tolist()}) < there.sum()
        return _SURE + np.log(fits + _LEAST), 1.0 if doubled else present
    panels, classes = readings[:3], None
    if frame.opinions is not None:
        frame.opinions.look(frame.image, boxes[:3, :3][there], colors[there].tolist(), _LOOKS)
        panels, classes = frame.opinions.joined(panels, looks), frame.opinions.classes(colors.tolist())
    board = readings[3] if boxes[3, 3] > _BOARD else np.zeros_like(readings[3])
    heard = mind.weigh(frame.text, panels, looks, board)
    present = 1 - float(shares_of(np.where([*there, True], heard.match, -np.inf))[3])
    return heard.choice + mind.evidence(frame.text, panels, classes), present


def _levelled(action: ActionChunk, gate: FloatArray) -> ActionChunk:
    """Near a gate, climb or sink to the middle of its opening: the head, which has learnt from flights that were right
    long before, gets there too late.
    """
    _, v, _, distance = gate.tolist()
    share = float(np.interp(distance, _LEVELS_M, (1.0, 0.0)))
    above = distance * (IMAGE_SIZE / 2 - v) / FOCAL_PX + MOUNT[2]
    found = action.copy()
    found[:, 2] += share * (np.clip(_CLIMB_PER_S * above, -_FASTEST, _FASTEST) - action[:, 2])
    return found


class Race(Small):
    """The racing model, for single gates of any kind. It reads no instruction: it is for "Fly through the gates"."""

    weights = "race"

    def __init__(self, path: Path | str | None = None, *, stack: int = 1) -> None:
        super().__init__(path, stack=stack, avoid=False)

    @classmethod
    def file_of(cls, path: Path | str | None = None, *, stack: int = 1, avoid: bool = False) -> tuple[Path, ...]:
        """As `Small.file_of`: it sees no obstacles."""
        return super().file_of(path, stack=stack, avoid=avoid)


def state_of(observation: Observation) -> FloatArray:
    """The network's motion input, (5,) float32.

    Velocity x, y, z in the heading frame, m/s, height, m, and yaw rate, rad/s.
    """
    return np.array([*observation.velocity, observation.height, observation.yaw_rate], dtype=np.float32)


def _checked(image: Image) -> Image:
    if image.dtype != np.uint8 or image.shape != _SHAPE:
        raise PolicyError(f"the small model needs a uint8 image of shape {_SHAPE}, got {image.dtype} {image.shape}")
    return image
