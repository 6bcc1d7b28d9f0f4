"""OpenVLA-7B as a policy: a checkpoint with four-number actions, run on a GPU, or on the CPU if it is small."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, NonFiniteAction, PluginError, PolicyError, import_extra
from cognitivedrone.interfaces import Policy, attempt
from cognitivedrone.models.compiling import EMULATED, compiled_or_plain, in_memory, shortage, warn, why_none
from cognitivedrone.models.openvla import checkpoint as checkpoints
from cognitivedrone.models.openvla.actions import Flying, to_tokens
from cognitivedrone.models.openvla.checkpoint import Checkpoint, DecoderName, Quantisation
from cognitivedrone.models.openvla.config import IMAGE
from cognitivedrone.models.openvla.prepare import BEGIN, prompt_ids, read_encoder
from cognitivedrone.terminal.progress import counted
from cognitivedrone.types import IMAGE_SIZE, ActionChunk, EpisodeContext, FloatArray, Image, Observation

if TYPE_CHECKING:
    from cognitivedrone.models.openvla.decode import Autoregressive, Decoder

_SHAPE = (IMAGE_SIZE, IMAGE_SIZE, 3)
SMALL = 2_000_000_000
"""Largest network, in bytes, that runs on the CPU without an explicit device=cpu."""
_USUAL_LENGTHS = (32, 64)
"""Prompt lengths, in tokens, for which the GPU graphs are captured before take-off."""


@dataclass(frozen=True, slots=True)
class Options:
    """The policy's arguments."""

    folder: Path
    decoder: DecoderName = "ar"
    quant: Quantisation = "none"
    device: str | None = None
    """None: a GPU if there is one."""
    unnorm_key: str | None = None
    flying: Flying | None = None
    """Which of the checkpoint's numbers fly; None: it has a drone's four."""
    stack: int = 1
    """Largest number of observations in one pass of the network, where several flights are flown at once."""
    compiled: bool | None = None
    """Whether the network's blocks are compiled before take-off. None: on a GPU."""


class OpenVla(Policy):
    """Flies the OpenVLA checkpoint in `folder`.

    `device` defaults to a GPU if there is one; `unnorm_key` selects the action statistics if there are several. Where
    an action has more numbers than a drone's, `dims` says which fly (`0+1+2+5`: vx, vy, vz, yaw rate), and `scale` by
    what they are multiplied; `tokenizer` is its folder, if that is not the weights'.

    With `stack`, up to so many flights go through the network together where there are several: faster, but rounded
    differently. Every decision depends only on its observation. `compiled` compiles the network's blocks before
    take-off, by default on a GPU; where that fails, it is said, and the network is run as it is.

    Raises `PolicyError` for an invalid argument or checkpoint, or too little memory, before the weights are loaded;
    `MissingExtra` if a package is missing.
    """

    on_card = True

    def __init__(
        self,
        folder: Path | str,
        *,
        decoder: DecoderName = "ar",
        quant: Quantisation = "none",
        device: Literal["cuda", "cpu"] | None = None,
        unnorm_key: str | None = None,
        dims: str | None = None,
        scale: str | None = None,
        tokenizer: Path | None = None,
        stack: int = 1,
        compiled: bool | None = None,
    ) -> None:
        if stack < 1:
            raise PluginError(f"policy 'openvla': stack is {stack}; it must be at least 1")
        flying = None if dims is None and scale is None else Flying.parse(dims, scale)
        self.options = Options(Path(folder), decoder, quant, device, unnorm_key, flying, stack, compiled)
        self.checkpoint = checkpoints.inspect(
            self.options.folder, self.options.unnorm_key, flying=flying, tokenizer=tokenizer and Path(tokenizer)
        )
        if self.options.decoder == "parallel" and self.checkpoint.head is None:
            raise ModelError(
                f"{self.options.folder} has no head for decoder=parallel; use decoder=ar, or fine-tune it in chunks"
            )
        with in_memory(ModelError, "policy openvla", ", or take quant=int8, which needs half as much"):
            self._decode = _decoder(self.options, self.checkpoint)
        self._encode = read_encoder(self.checkpoint.tokenizer)
        self._text: str | None = None
        self._ids: list[int] = []

    def reset(self, context: EpisodeContext) -> None:
        """Take a new instruction; raises `PolicyError` for one that is empty or too long."""
        self._listen(context.instruction)

    def act(self, observation: Observation) -> ActionChunk:
        """Commands (k, 4) for the observation's instruction: one, or the parallel decoder's chunk.

        Raises `PolicyError` for an invalid instruction, as `reset`, or an image that is not uint8 (256, 256, 3), and
        `NonFiniteAction` if the network's output is not finite.
        """
        frame = self._frame(observation)
        return self._decided(self._decode(*frame))

    def act_batch(
        self, sessions: Sequence[Policy], observations: Sequence[Observation]
    ) -> Sequence[ActionChunk | Exception]:
        """As `Policy.act_batch`, in passes of up to `stack` observations."""
        if self.options.stack == 1:
            return super().act_batch(sessions, observations)
        forks = cast(Sequence[OpenVla], sessions)
        found = [attempt(fork._frame, seen) for fork, seen in zip(forks, observations, strict=True)]
        frames = [frame for frame in found if not isinstance(frame, Exception)]
        passes = [frames[first : first + self.options.stack] for first in range(0, len(frames), self.options.stack)]
        answers = iter([answer for together in passes for answer in self._together(together)])
        return [
            frame if isinstance(frame, Exception) else attempt(fork._decided, next(answers))
            for fork, frame in zip(forks, found, strict=True)
        ]

    @property
    def has_tokens(self) -> bool:
        """Whether its actions are tokens of a drone's four numbers; those of the parallel decoder are numbers."""
        return self.options.decoder == "ar" and self.options.flying is None

    def token_answer(
        self, observation: Observation, action: FloatArray
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Of a true action's (4,) tokens, each given those before it: whether it is the likeliest one (4,), and its
        cross-entropy (4,), nats.
        """
        tokens = to_tokens(self.checkpoint.statistics.normalise(action[None]))[0]
        image, ids = self._frame(observation)
        logs = cast("Autoregressive", self._decode).log_probabilities(image, ids, tokens.tolist())
        return logs.argmax(axis=1) == tokens, -logs[np.arange(len(tokens)), tokens].astype(np.float64)

    def fork(self) -> Self:
        """As `Policy.fork`."""
        return copy.copy(self)

    def _frame(self, observation: Observation) -> tuple[Image, list[int]]:
        """The network's inputs for an observation: the image and the prompt."""
        image = observation.image
        if image.dtype != np.uint8 or image.shape != _SHAPE:
            raise PolicyError(f"OpenVLA needs uint8 images of shape {_SHAPE}, got {image.dtype} {image.shape}")
        if observation.instruction != self._text:
            self._listen(observation.instruction)
        return self.checkpoint.preparation.square(image), self._ids

    def _together(self, frames: Sequence[tuple[Image, list[int]]]) -> Sequence[FloatArray | Exception]:
        """The network's answers to some frames in one pass, or in smaller ones where the card's memory is full.

        An exception is that of all frames of its pass.
        """
        images, prompts = zip(*frames, strict=True)
        answers = attempt(lambda images: self._decode.together(images, prompts), np.stack(images))
        if not isinstance(answers, Exception):
            return list(answers)
        if len(frames) == 1 or not shortage(answers):
            return [answers] * len(frames)
        del answers  # with its traceback, which holds the tensors of the pass
        half = len(frames) // 2
        return [*self._together(frames[:half]), *self._together(frames[half:])]

    def _decided(self, answer: FloatArray | Exception) -> ActionChunk:
        """The commands by the network's answer (k, 4)."""
        if isinstance(answer, Exception):
            raise answer
        if not np.isfinite(answer).all():
            raise NonFiniteAction(f"the network answered {answer[0].tolist()} to {self._text!r}")
        chunk: ActionChunk = self.checkpoint.flown(answer).astype(np.float32)
        return chunk

    def _listen(self, text: str) -> None:
        self._ids = prompt_ids(self._encode, text)
        self._text = text


def _decoder(options: Options, checkpoint: Checkpoint) -> Decoder:
    """The loaded network with its decoder; memory is checked first."""
    torch = import_extra("torch", "openvla")
    for package in ("transformers", "safetensors", "tokenizers"):
        import_extra(package, "openvla")
    has_gpu = torch.cuda.is_available()
    device = options.device or ("cuda" if has_gpu else "cpu")
    if options.quant == "int4" and device == "cpu":
        raise ModelError("quant=int4 is for GPUs; on the host use quant=int8 or quant=none")
    stored = 2 if device == "cuda" else checkpoint.stored_bytes
    needed = checkpoints.needed_bytes(checkpoint.config, options.quant, stored)
    if not has_gpu and (device == "cuda" or (options.device is None and needed > SMALL)):
        raise ModelError(
            f"the network needs {needed / 1e9:.1f} GB of GPU memory, but this machine has no GPU that PyTorch can use,"
            f" and {checkpoints.free_memory() / 1e9:.1f} GB of free main memory; use a machine with a GPU, or"
            f" device=cpu, which takes seconds per action{why_none(torch)}"
        )
    if device == "cuda":
        warn(torch, "policy openvla", EMULATED)
    if options.quant != "none":
        whole = checkpoints.needed_bytes(checkpoint.config, "none", stored)
        checkpoints.check_reading(whole, checkpoints.free_memory(), options.quant)
    free = torch.cuda.mem_get_info()[0] if device == "cuda" else checkpoints.free_memory()
    checkpoints.check_memory(needed, free, device)

    from cognitivedrone.models.openvla.weights import load

    dtype = torch.float32 if stored == 4 else torch.bfloat16
    network = load(checkpoint, device, dtype, options.quant, fused=True)
    # Quantised weights are fast only if they are unpacked inside the multiplication, which takes a compiler.
    compiled = device == "cuda" if options.compiled is None else options.compiled
    lengths = _USUAL_LENGTHS if device == "cuda" or compiled else ()
    return warmed_up(network, checkpoint, options.decoder, lengths, compiled=compiled)


def warmed_up(
    network: Any,
    checkpoint: Checkpoint,
    name: DecoderName,
    lengths: Sequence[int],
    *,
    compiled: bool,
    backend: Any = "inductor",
) -> Decoder:
    """The decoder of a network, which has answered prompts of some lengths: compiled and recorded before take-off.

    Where compiling fails, a warning says so, and the network is run as it is.
    """
    from cognitivedrone.models.openvla.compiled import compile_blocks, uncompile
    from cognitivedrone.models.openvla.decode import Autoregressive, Parallel

    def made(shown: str) -> Decoder:
        width = len(checkpoint.statistics.q01)
        parallel = name == "parallel"
        decoder: Decoder = (
            Parallel(network, checkpoint.preparation)
            if parallel
            else Autoregressive(network, checkpoint.preparation, width)
        )
        for length in counted(lengths, shown, len(lengths), show=compiled):
            decoder(np.zeros((IMAGE, IMAGE, 3), np.uint8), [BEGIN] * length)
        return decoder

    if not compiled:
        return made("recording OpenVLA")

    def compiled_blocks() -> Decoder:
        compile_blocks(network, backend)
        return made("compiling OpenVLA (once; kept on disk)")

    def plain_blocks() -> Decoder:
        uncompile(network)
        return made("recording OpenVLA")

    return compiled_or_plain("policy openvla", compiled_blocks, plain_blocks, backend)
