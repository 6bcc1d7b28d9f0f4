"""The local VLM reasoner: Qwen2.5-VL or Qwen3-VL in this process, through Transformers.

Qwen2.5-VL is decoded by `models.qwen_decoder`, the others by Transformers' own `generate()`; the answers are the same.
The inputs are assembled here from the image processor and the tokenizer: the combined processor of Transformers 5 also
loads a video processor, which requires torchvision even without any video.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cognitivedrone.errors import MissingExtra, ModelError, did_you_mean, import_extra
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.models.card import shortage, warn
from cognitivedrone.models.compiling import compiled_or_plain
from cognitivedrone.reasoners.prompt import (
    MAX_TOKENS,
    answers,
    checked_tokens,
    constant_part,
    load_prompt,
    write_prompt,
)
from cognitivedrone.reasoners.reply import read_reply
from cognitivedrone.types import IMAGE_SIZE, Guidance, Image

FAMILIES: dict[str, str] = {
    "qwen2_5_vl": "<|im_start|>system\nYou are a helpful assistant.<|im_end|>\n",
    "qwen3_vl": "",
    "qwen3_vl_moe": "",
}
"""Start of a conversation in each family, by the configuration's `model_type`; from its chat template."""
IMAGE_TOKEN = "<|image_pad|>"  # noqa: S105 - a word of the model's vocabulary
_EMULATED = "which is emulated, several times slower: dtype=float32 may be faster"
_END = "<|im_end|>"
_OPENING = "<|im_start|>user\n"
_BEFORE_IMAGE = "<|vision_start|>"
_AFTER_IMAGE = "<|vision_end|>"
_CLOSING = "<|im_end|>\n<|im_start|>assistant\n"


class LocalVlm(Reasoner):
    """Image and instruction to the answer of a model in this process.

    `model` is a folder, or a name on the hub. Nothing is downloaded unless `download` is true. Weights are read from
    safetensors, and code shipped with a model is never run. With `bits=8`, the layers of Qwen2.5-VL's language model
    hold one byte a weight, with a scale for each output; other models, and 4 bits, are quantised by bitsandbytes.
    `tokens` limits an answer with its thinking; a reply that reaches it is no answer. With `schema`, an answer is one
    of the schema's, and takes fewer passes of the network; by default with the package's prompt and no thinking.

    Raises `ModelError` for an invalid argument or a model that cannot be loaded, `MissingExtra` for a missing package.
    """

    on_card = True

    def __init__(
        self,
        model: str,
        *,
        bits: Literal[4, 8] | None = None,
        device: str | None = None,
        dtype: Literal["bfloat16", "float32"] | None = None,
        prompt: Path | None = None,
        download: bool = False,
        tokens: int = MAX_TOKENS,
        schema: bool | None = None,
    ) -> None:
        self._schema = (prompt is None and tokens == MAX_TOKENS) if schema is None else schema
        self._tokens = checked_tokens("vlm-local", tokens)
        self._template = load_prompt(prompt)
        self._torch = import_extra("torch", "vlm-local")
        self._transformers = import_extra("transformers", "vlm-local")
        if device is None or (device != "cpu" and self._torch.cuda.is_available()):
            warn(self._torch, "reasoner vlm-local", "" if dtype == "float32" else _EMULATED)
        device = device or ("cuda" if self._torch.cuda.is_available() else "cpu")
        dtype = dtype or ("float32" if device == "cpu" else "bfloat16")
        loading = {
            "local_files_only": not download,
            "trust_remote_code": False,
        }
        try:
            self._load(str(Path(model).expanduser()), loading, self._torch.device(device), dtype, bits)
        except (OSError, ValueError, RuntimeError, KeyError) as error:
            if short := shortage(error):
                raise ModelError(
                    f"reasoner 'vlm-local' cannot load {model!r} on {device!r}: {short}, or take a smaller model,"
                    " bits=8 or device=cpu"
                ) from None
            line = " ".join(str(error).split())[:300]
            raise ModelError(
                f"reasoner 'vlm-local' cannot load {model!r} on {device!r}: {line} (give a folder with config.json, the"
                " tokenizer's and the image processor's files and *.safetensors; or add download=yes)"
            ) from None

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The gate that the model names for `image`, (H, W, 3) uint8 RGB; raises `ReasonerError`."""
        return read_reply(*self._generated(image, instruction))

    def answer(self, image: Image, instruction: str) -> str:
        """The model's text, greedily decoded; raises `ReasonerError` for an invalid instruction."""
        return self._generated(image, instruction)[0]

    def _generated(self, image: Image, instruction: str) -> tuple[str, str]:
        """The model's text, and whether it ended itself ("stop") or at the limit ("length")."""
        answered = self._decode(self.inputs(image, instruction))
        text = str(self._tokenizer.decode(answered, skip_special_tokens=True))
        return text, "stop" if self._decoding.eos_token_id in answered else "length"

    def _generate(self, inputs: dict[str, Any]) -> list[int]:
        """The tokens of an answer, by Transformers' own loop."""
        begin, forms = inputs["input_ids"].shape[1], self._forms
        allowed = forms and (lambda _, ids: forms.after(ids[begin:].tolist()))
        with self._torch.inference_mode():
            tokens = self._model.generate(**inputs, generation_config=self._decoding, prefix_allowed_tokens_fn=allowed)
        answered: list[int] = tokens[0, begin:].tolist()
        return answered

    def inputs(self, image: Image, instruction: str) -> dict[str, Any]:
        """The model's inputs, as tensors with one row: what is the same for every question, the image, the rest.

        Raises `ReasonerError` if the instruction is empty or too long.
        """
        seen = self._image_processor(images=[image], return_tensors="pt", input_data_format="channels_last")
        merged = self._image_processor.merge_size**2
        patches = int(seen["image_grid_thw"][0].prod()) // merged
        # The instruction is plain text: a "<|im_end|>" in it must not end the conversation.
        constant = constant_part(self._template)
        words = self._encode(write_prompt(self._template, instruction)[len(constant) :], special=False)
        before = self._encode(self._beginning + _OPENING) + self._encode(constant, special=False)
        before += self._encode(_BEFORE_IMAGE)
        after = self._encode(_AFTER_IMAGE) + words + self._encode(_CLOSING)
        tokens = self._torch.tensor([before + [self._image_token] * patches + after])
        made = {
            "input_ids": tokens,
            "attention_mask": self._torch.ones_like(tokens),
            "mm_token_type_ids": (tokens == self._image_token).to(self._torch.int32),
            "pixel_values": seen["pixel_values"].to(self._model.dtype),
            "image_grid_thw": seen["image_grid_thw"],
        }
        return {key: value.to(self._model.device) for key, value in made.items()}

    def _encode(self, text: str, *, special: bool = True) -> list[int]:
        tokens: list[int] = self._tokenizer(text, add_special_tokens=False, split_special_tokens=not special).input_ids
        return tokens

    def _load(self, name: str, loading: dict[str, Any], device: Any, dtype: str, bits: int | None) -> None:
        """Set the model, its tokenizer and its image processor."""
        from cognitivedrone.models.openvla.weights import quantise
        from cognitivedrone.models.qwen_decoder import FAMILY, Forms, QwenDecoder

        library = self._transformers
        config = library.AutoConfig.from_pretrained(name, **loading)
        if config.model_type not in FAMILIES:
            raise ValueError(f"it is a {config.model_type!r}; {did_you_mean(config.model_type, FAMILIES)}")
        self._beginning = FAMILIES[config.model_type]
        self._image_token = int(config.image_token_id)
        self._tokenizer = library.AutoTokenizer.from_pretrained(name, **loading)
        if self._tokenizer.convert_tokens_to_ids(IMAGE_TOKEN) != self._image_token:
            raise ValueError(f"its tokenizer and its config.json disagree on the number of {IMAGE_TOKEN}")
        self._image_processor = library.AutoImageProcessor.from_pretrained(name, **loading)
        recorded = config.model_type == FAMILY and bits != 4
        extra = _quantised(library, self._torch, bits, device) if bits and not recorded else {}
        model = library.AutoModelForImageTextToText.from_pretrained(
            name, config=config, dtype=getattr(self._torch, dtype), use_safetensors=True, **extra, **loading
        )
        if recorded and bits:
            quantise(model.model.language_model.layers, "int8", device, "vlm-local")
        self._model = (model if extra else model.to(device)).eval()
        # Our own configuration: those shipped with models enable sampling.
        self._decoding = library.GenerationConfig(
            max_new_tokens=self._tokens,
            do_sample=False,
            eos_token_id=self._tokenizer.convert_tokens_to_ids(_END),
            pad_token_id=self._tokenizer.pad_token_id,
        )
        allowed = Forms([self._encode(text) + self._encode(_END) for text in answers()])
        self._forms = allowed if self._schema and allowed.longest <= self._tokens else None
        if recorded and model.config._attn_implementation == "sdpa":
            make = partial(
                QwenDecoder,
                self._model,
                end=self._decoding.eos_token_id,
                most=self._tokens,
                forms=self._forms,
            )
            self._decode: Callable[[dict[str, Any]], list[int]] = make()
            if device.type == "cuda":
                self._warm_up(make)
            return
        self._decode = self._generate
        if device.type == "cuda":
            what = f"{bits} bits" if bits else f"a {config.model_type}"
            warnings.warn(
                f"reasoner vlm-local: {name} is decoded by generate() ({what}); only Qwen2.5-VL without bits=4 is"
                " decoded by recorded CUDA graphs, several times faster",
                RuntimeWarning,
                stacklevel=3,
            )

    def _warm_up(self, make: Callable[..., Callable[[dict[str, Any]], list[int]]], compiler: str = "inductor") -> None:
        """Compile and record before take-off; where compiling fails, it is said, and the model is run as it is."""
        asked = self.inputs(np.zeros((IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8), "Fly through the gate")

        def made(compiler: str | None) -> Callable[[dict[str, Any]], list[int]]:
            decode = make(compiler=compiler)
            decode(asked)
            return decode

        self._decode = compiled_or_plain("reasoner vlm-local", lambda: made(compiler), lambda: made(None), compiler)


def _quantised(library: Any, torch: Any, bits: int, device: Any) -> dict[str, Any]:
    """Loading arguments for 8 or 4 bits; raises `MissingExtra`."""
    for package, extra in (("accelerate", "vlm-local"), ("bitsandbytes", None)):
        if importlib.util.find_spec(package) is None:
            raise MissingExtra(package, extra)
    config = library.BitsAndBytesConfig(
        load_in_8bit=bits == 8,
        load_in_4bit=bits == 4,
        bnb_4bit_quant_type="nf4",
        bnb_4bit_compute_dtype=torch.bfloat16,
    )
    return {"quantization_config": config, "device_map": {"": device}}
