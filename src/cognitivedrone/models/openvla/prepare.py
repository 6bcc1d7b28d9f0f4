"""Input preparation: pixels and text to the network's inputs, exactly as in the published model's training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.models.openvla.config import IMAGE, WORDS
from cognitivedrone.types import Image

Three: TypeAlias = tuple[float, float, float]

BEGIN = 1
"""Id of the token at the beginning of every text."""
END = 2
"""Id of the token at the end of an action in training."""
SPACE = 29_871
"""Id of the single space between "Out:" and the action tokens."""
PIECES = {"<unk>": 0, "<s>": BEGIN, "</s>": END, "<0x0A>": 13, "▁In": 512, ":": 29_901, "▁": SPACE}
"""Tokens that identify Llama's tokenizer."""
MAX_TOKENIZER_BYTES = 100_000_000
LONGEST_INSTRUCTION = 1000
"""Maximum length in characters."""


@dataclass(frozen=True, slots=True)
class ImagePreparation:
    """Shift and scale of each tower's three channels, for pixels in [0, 1]."""

    means: tuple[Three, Three] = ((0.485, 0.456, 0.406), (0.5, 0.5, 0.5))
    """DINOv2's (from ImageNet), SigLIP's."""
    deviations: tuple[Three, Three] = ((0.229, 0.224, 0.225), (0.5, 0.5, 0.5))

    def square(self, image: Image) -> Image:
        """An image (H, W, 3) as (224, 224, 3) uint8: bicubic to a square whatever its aspect ratio."""
        return np.array(Picture.fromarray(image).resize((IMAGE, IMAGE), Picture.Resampling.BICUBIC))

    def pixel_values(self, image: Image) -> NDArray[np.float32]:
        """An image (H, W, 3) as (6, 224, 224): its square, shifted and scaled once per tower."""
        pixels = self.square(image).astype(np.float32).transpose(2, 0, 1) / np.float32(255)
        towers = [
            (pixels - np.array(mean, np.float32)[:, None, None]) / np.array(deviation, np.float32)[:, None, None]
            for mean, deviation in zip(self.means, self.deviations, strict=True)
        ]
        return np.concatenate(towers)


def read_preparation(table: Mapping[str, Any]) -> ImagePreparation:
    """The settings in a published `preprocessor_config.json`; raises `ModelError` if it belongs to another model."""
    try:
        means, deviations = (
            tuple(tuple(float(value) for value in tower) for tower in table[name]) for name in ("means", "stds")
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(
            f"preprocessor_config.json lacks readable means and stds: {type(error).__name__} {error}"
        ) from None
    if [len(tower) for tower in (*means, *deviations)] != [3] * 4 or min(min(tower) for tower in deviations) <= 0:
        raise ModelError("preprocessor_config.json: means and stds are not three numbers for each of two towers")
    return ImagePreparation(means, deviations)  # type: ignore[arg-type]  # the lengths are checked above


def prompt(instruction: str) -> str:
    """The prompt that the network was trained on.

    Raises `PolicyError` for an instruction that is empty or longer than `LONGEST_INSTRUCTION`.
    """
    words = " ".join(instruction.split()).lower()
    if not words:
        raise PolicyError("the instruction is empty; say which gate to fly through")
    if len(words) > LONGEST_INSTRUCTION:
        raise PolicyError(f"the instruction has {len(words)} characters; OpenVLA reads at most {LONGEST_INSTRUCTION}")
    return f"In: What action should the robot take to {words}?\nOut:"


class Encoder(Protocol):
    """Text to token ids, without begin or end tokens."""

    def __call__(self, text: str) -> list[int]:
        """The ids of a text."""
        ...


def prompt_ids(encode: Encoder, instruction: str) -> list[int]:
    """Ids of the whole prompt, from the begin token to the single space; raises `PolicyError` like `prompt`."""
    return [BEGIN, *encode(prompt(instruction)), SPACE]


def check_tokenizer(table: Mapping[str, Any], where: str) -> None:
    """Raises `ModelError` where a `tokenizer.json` is not Llama's."""
    try:
        pieces = dict(table["model"]["vocab"])
    except (KeyError, TypeError, ValueError):
        raise ModelError(f"{where} has no vocabulary; copy the tokenizer.json of the published OpenVLA") from None
    wrong = [
        f"{piece!r} is {pieces.get(piece)}, not {id_}" for piece, id_ in PIECES.items() if pieces.get(piece) != id_
    ]
    if len(pieces) != WORDS:
        wrong.insert(0, f"it has {len(pieces)} pieces, not {WORDS}")
    if wrong:
        raise ModelError(
            f"{where} is not Llama's: {'; '.join(wrong[:3])}; the actions are words of Llama's vocabulary, so copy the"
            " tokenizer.json of the published OpenVLA"
        )


def read_encoder(path: Path) -> Encoder:
    """The tokenizer in a `tokenizer.json`; needs the library `tokenizers`. Raises `ModelError` for no file."""
    from tokenizers import Tokenizer

    try:
        tokenizer = Tokenizer.from_str(read_regular(path, MAX_TOKENIZER_BYTES).decode())
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {reason_of(error)}; copy the checkpoint again") from None
    # The user's text is plain text: a "</s>" in it must not end the text.
    tokenizer.encode_special_tokens = True
    tokenizer.no_padding()
    tokenizer.no_truncation()

    def encode(text: str) -> list[int]:
        ids: list[int] = tokenizer.encode(text, add_special_tokens=False).ids
        return ids

    return encode
