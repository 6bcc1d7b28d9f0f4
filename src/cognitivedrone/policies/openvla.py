"""OpenVLA-7B as a policy: a checkpoint with an action of four numbers, flown on a GPU, or a small one on the host."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from cognitivedrone.errors import ModelError, NonFiniteAction, PolicyError, import_extra
from cognitivedrone.interfaces import Policy
from cognitivedrone.models.openvla import checkpoint as checkpoints
from cognitivedrone.models.openvla.checkpoint import Checkpoint, DecoderName, Quantisation
from cognitivedrone.models.openvla.config import IMAGE
from cognitivedrone.models.openvla.prepare import BEGIN, prompt_ids, read_encoder
from cognitivedrone.types import IMAGE_SIZE, ActionChunk, EpisodeContext, Observation

if TYPE_CHECKING:
    from cognitivedrone.models.openvla.decode import Decoder

_SHAPE = (IMAGE_SIZE, IMAGE_SIZE, 3)
SMALL = 2_000_000_000
"""Bytes up to which a network is flown without a GPU unasked."""
_USUAL_LENGTHS = (32, 64)
"""Of prompts, in tokens: what a GPU records once for each length, it records before take-off."""


@dataclass(frozen=True, slots=True)
class Options:
    """What "PATH,decoder=ar|parallel,quant=none|int8|int4,device=cuda|cpu,unnorm_key=NAME" says."""

    folder: Path
    decoder: DecoderName = "ar"
    quant: Quantisation = "none"
    device: str | None = None
    """None: a GPU where there is one."""
    unnorm_key: str | None = None


class OpenVla(Policy):
    """Flies the OpenVLA checkpoint in `folder`.

    `device` is a GPU by default where there is one; `unnorm_key` names the action statistics where there are several.

    Every decision depends on its observation alone. Raises `PolicyError` for an argument or a checkpoint that does not
    do, or a machine it does not fit on, before the weights are loaded, and `MissingExtra`.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        decoder: DecoderName = "ar",
        quant: Quantisation = "none",
        device: Literal["cuda", "cpu"] | None = None,
        unnorm_key: str | None = None,
    ) -> None:
        self.options = Options(Path(folder), decoder, quant, device, unnorm_key)
        self.checkpoint = checkpoints.inspect(self.options.folder, self.options.unnorm_key)
        if self.options.decoder == "parallel" and self.checkpoint.head is None:
            raise ModelError(
                f"{self.options.folder} has no head for decoder=parallel; use decoder=ar, or fine-tune it in chunks"
            )
        self._decode = _decoder(self.options, self.checkpoint)
        self._encode = read_encoder(self.checkpoint.tokenizer)
        self._text: str | None = None
        self._ids: list[int] = []

    def reset(self, context: EpisodeContext) -> None:
        """Take a new instruction; raises `PolicyError` for one that is empty or too long."""
        self._listen(context.instruction)

    def act(self, observation: Observation) -> ActionChunk:
        """Commands (k, 4) by the observation's own instruction: one, or those of the parallel decoder's chunk.

        Raises `PolicyError` for an instruction as in `reset`, or an image that is not uint8 (256, 256, 3), and
        `NonFiniteAction` where the network's answer is not finite.
        """
        image = observation.image
        if image.dtype != np.uint8 or image.shape != _SHAPE:
            raise PolicyError(f"OpenVLA is flown by images of uint8 {_SHAPE}; what came is {image.dtype} {image.shape}")
        if observation.instruction != self._text:
            self._listen(observation.instruction)
        answer = self._decode(self.checkpoint.preparation.pixel_values(image), self._ids)
        if not np.isfinite(answer).all():
            raise NonFiniteAction(f"the network answered {answer[0].tolist()} to {self._text!r}")
        return self.checkpoint.statistics.flown(answer).astype(np.float32)

    def _listen(self, text: str) -> None:
        self._ids = prompt_ids(self._encode, text)
        self._text = text


def _decoder(options: Options, checkpoint: Checkpoint) -> Decoder:
    """The loaded network behind its decoder, when it is known to fit."""
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
            f"the network needs {needed / 1e9:.1f} GB of GPU memory, and this machine has no GPU that PyTorch can use,"
            f" but {checkpoints.free_memory() / 1e9:.1f} GB of its own free; fly it on a machine with a GPU, or here"
            " with device=cpu, at seconds an action"
        )
    if options.quant != "none":
        whole = checkpoints.needed_bytes(checkpoint.config, "none", stored)
        checkpoints.check_reading(whole, checkpoints.free_memory(), options.quant)
    free = torch.cuda.mem_get_info()[0] if device == "cuda" else checkpoints.free_memory()
    checkpoints.check_memory(needed, free, device)

    from cognitivedrone.models.openvla.decode import Autoregressive, Parallel
    from cognitivedrone.models.openvla.weights import load

    dtype = torch.float32 if stored == 4 else torch.bfloat16
    network = load(checkpoint, device, dtype, options.quant)
    # Small weights become quick only where they are unpacked inside the multiplication, which takes a compiler.
    compiled = device == "cuda" and options.quant != "none"
    decoder = (Parallel if options.decoder == "parallel" else Autoregressive)(network, compiled=compiled)
    if device == "cuda":
        for length in _USUAL_LENGTHS:
            decoder(np.zeros((6, IMAGE, IMAGE), np.float32), [BEGIN] * length)
    return decoder
