"""The local VLM reasoner: Qwen2.5-VL or Qwen3-VL in this process, through Transformers.

The inputs are assembled here from the image processor and the tokenizer: the combined processor of Transformers 5 also
loads a video processor, which requires torchvision even without any video.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any, Literal

from cognitivedrone.errors import MissingExtra, ModelError, did_you_mean, import_extra
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.models.compiling import shortage, warn
from cognitivedrone.reasoners.prompt import MAX_TOKENS, answers, checked_tokens, load_prompt, write_prompt
from cognitivedrone.reasoners.reply import read_reply
from cognitivedrone.types import Guidance, Image

FAMILIES: dict[str, str] = {
    "qwen2_5_vl": "<|im_start|>system\nYou are a helpful assistant.<|im_end|>\n",
    "qwen3_vl": "",
    "qwen3_vl_moe": "",
}
"""Start of a conversation in each family, by the configuration's `model_type`; from its chat template."""
IMAGE_TOKEN = "<|image_pad|>"  # noqa: S105 - a word of the model's vocabulary
_EMULATED = "which is emulated, several times slower: dtype=float32 may be faster"
_END = "<|im_end|>"
_BEFORE_IMAGE = "<|im_start|>user\n<|vision_start|>"
_AFTER_IMAGE = "<|vision_end|>"
_CLOSING = "<|im_end|>\n<|im_start|>assistant\n"


class LocalVlm(Reasoner):
    """Image and instruction to the answer of a model in this process.

    `model` is a folder, or a name on the hub. Nothing is downloaded unless `download` is true. Weights are read from
    safetensors, and code shipped with a model is never run. `bits` are quantised by bitsandbytes. `tokens` limits an
    answer with its thinking; a reply that reaches it is no answer. With `schema`, an answer is one of the schema's; by
    default with the package's prompt and no thinking.

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
        return read_reply(*self.answer(image, instruction))

    def answer(self, image: Image, instruction: str) -> tuple[str, str]:
        """The model's text, greedily decoded, and whether it ended itself ("stop") or at the limit ("length").

        Raises `ReasonerError` for an invalid instruction.
        """
        inputs = self.inputs(image, instruction)
        begin = inputs["input_ids"].shape[1]

        def allowed(_: int, ids: Any) -> list[int]:
            begun = ids[begin:].tolist()
            return sorted({form[len(begun)] for form in self._forms if form[: len(begun)] == begun})

        with self._torch.inference_mode():
            tokens = self._model.generate(
                **inputs,
                generation_config=self._decoding,
                prefix_allowed_tokens_fn=allowed if self._forms else None,
            )
        answered = tokens[0, begin:].tolist()
        text = str(self._tokenizer.decode(answered, skip_special_tokens=True))
        return text, "stop" if self._decoding.eos_token_id in answered else "length"

    def inputs(self, image: Image, instruction: str) -> dict[str, Any]:
        """The model's inputs, as tensors with one row: the image, then the prompt.

        Raises `ReasonerError` if the instruction is empty or too long.
        """
        seen = self._image_processor(images=[image], return_tensors="pt", input_data_format="channels_last")
        merged = self._image_processor.merge_size**2
        patches = int(seen["image_grid_thw"][0].prod()) // merged
        # The instruction is plain text: a "<|im_end|>" in it must not end the conversation.
        words = self._encode(write_prompt(self._template, instruction), special=False)
        before = self._encode(self._beginning + _BEFORE_IMAGE)
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
        extra = _quantised(library, self._torch, bits, device) if bits else {}
        model = library.AutoModelForImageTextToText.from_pretrained(
            name, config=config, dtype=getattr(self._torch, dtype), use_safetensors=True, **extra, **loading
        )
        self._model = (model if extra else model.to(device)).eval()
        # Our own configuration: those shipped with models enable sampling.
        self._decoding = library.GenerationConfig(
            max_new_tokens=self._tokens,
            do_sample=False,
            eos_token_id=self._tokenizer.convert_tokens_to_ids(_END),
            pad_token_id=self._tokenizer.pad_token_id,
        )
        forms = [self._encode(text) + self._encode(_END) for text in answers()]
        self._forms = forms if self._schema and max(map(len, forms)) <= self._tokens else []


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
