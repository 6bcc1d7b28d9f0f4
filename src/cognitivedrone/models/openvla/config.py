"""Sizes of an OpenVLA, and the published `config.json` that contains them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from cognitivedrone.errors import ModelError
from cognitivedrone.files.schema import decode

IMAGE = 224
"""Height and width of the towers' input, pixels."""
PATCH = 14
"""Height and width of a patch, pixels."""
PATCHES = (IMAGE // PATCH) ** 2
ACTION_SIZE = 4
"""vx, vy, vz, yaw rate."""
WORDS = 32_000
"""Vocabulary size of Llama's tokenizer; the embedding has 64 more rows, for padding."""
PADDING = 32_000
"""Id of the padding token."""
LARGEST_SIZE = 1_000_000
"""Of any width, vocabulary or number of layers; OpenVLA-7B's largest is 32,064."""
MOST_LAYERS = 1000
KEY = "cognitivedrone"
"""Key of our own entries in `config.json`, beside the published ones."""


@dataclass(frozen=True, slots=True)
class TowerSize:
    """Size of one vision transformer. The last of its `depth` blocks exists in checkpoints and is never run."""

    width: int
    depth: int
    heads: int
    hidden: int
    """Width inside the two-layer perceptron of a block."""
    registers: int | None = None
    """Number of register tokens, beside a class token; None for a tower without either."""
    layer_scale: bool = False


@dataclass(frozen=True, slots=True)
class LanguageSize:
    """Size of the Llama. The defaults are those of Llama-2-7B that published OpenVLA configurations imply."""

    hidden_size: int = 4096
    intermediate_size: int = 11008
    num_hidden_layers: int = 32
    num_attention_heads: int = 32
    num_key_value_heads: int = 32
    vocab_size: int = 32_064
    max_position_embeddings: int = 2048
    rms_norm_eps: float = 1e-6
    rope_theta: float = 10_000.0


DINO = TowerSize(width=1024, depth=24, heads=16, hidden=4096, registers=4, layer_scale=True)
"""DINOv2 ViT-L/14 with registers (Darcet et al. 2023, arXiv 2309.16588)."""
SIGLIP = TowerSize(width=1152, depth=27, heads=16, hidden=4304)
"""SigLIP So400m/14 (Zhai et al. 2023, arXiv 2303.15343)."""
PUBLISHED_TOWERS = {
    "vit_large_patch14_reg4_dinov2.lvd142m": DINO,
    "vit_so400m_patch14_siglip_224": SIGLIP,
}


@dataclass(frozen=True, slots=True)
class Config:
    """Sizes of both towers and the Llama, and our own additions."""

    dino: TowerSize = DINO
    siglip: TowerSize = SIGLIP
    language: LanguageSize = LanguageSize()
    chunk: int | None = None
    """Number of actions that the parallel decoder's head outputs; None for a checkpoint without that head."""

    @property
    def vision_width(self) -> int:
        """Width of a patch's features, from both towers."""
        return self.dino.width + self.siglip.width


def tiny_config(chunk: int | None = None) -> Config:
    """The same architecture in small, of 2.3 million weights, for tests; two million are the vocabulary's."""
    return Config(
        dino=TowerSize(width=48, depth=3, heads=4, hidden=192, registers=4, layer_scale=True),
        siglip=TowerSize(width=36, depth=3, heads=4, hidden=134),
        language=LanguageSize(
            hidden_size=32, intermediate_size=88, num_hidden_layers=3, num_attention_heads=4, num_key_value_heads=4
        ),
        chunk=chunk,
    )


def read_config(table: Mapping[str, Any]) -> Config:
    """The sizes in a `config.json`; raises `ModelError` for another architecture."""
    expected = {
        "model_type": "openvla",
        "arch_specifier": "no-align+fused-gelu-mlp",
        "image_resize_strategy": "resize-naive",
        "n_action_bins": 256,
    }
    for key, value in expected.items():
        if table.get(key) != value:
            raise ModelError(f"config.json: {key} is {table.get(key)!r}; an OpenVLA-7B that can be flown has {value!r}")
    own = table.get(KEY, {})
    try:
        if own.get("chunk") is not None and type(own["chunk"]) is not int:
            raise TypeError(f"{KEY}.chunk is {own['chunk']!r:.40}")
        dino, siglip = _towers(table, own)
        config = Config(dino, siglip, _language(table["text_config"]), own.get("chunk"))
        _check(config)
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        raise ModelError(f"config.json does not describe an OpenVLA: {type(error).__name__} {error}") from None
    return config


def write_config(config: Config, norm_stats: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `read_config`, with the published keys and the action statistics."""
    language = asdict(config.language)
    return {
        "model_type": "openvla",
        "arch_specifier": "no-align+fused-gelu-mlp",
        "image_resize_strategy": "resize-naive",
        "image_sizes": [IMAGE, IMAGE],
        "n_action_bins": 256,
        "pad_token_id": PADDING,
        "pad_to_multiple_of": config.language.vocab_size - WORDS,
        "timm_model_ids": list(PUBLISHED_TOWERS),
        "use_fused_vision_backbone": True,
        "text_config": {"model_type": "llama", **language},
        "norm_stats": dict(norm_stats),
        KEY: {"towers": [asdict(config.dino), asdict(config.siglip)], "chunk": config.chunk},
    }


def _towers(table: Mapping[str, Any], own: Mapping[str, Any]) -> tuple[TowerSize, TowerSize]:
    if "towers" in own:
        dino, siglip = decode(tuple[TowerSize, TowerSize], own["towers"], "config.json: towers", ModelError)
        return dino, siglip
    names = list(table["timm_model_ids"])
    if names != list(PUBLISHED_TOWERS):
        raise ValueError(f"timm_model_ids are {names}, not {list(PUBLISHED_TOWERS)}")
    return DINO, SIGLIP


def _language(table: Mapping[str, Any]) -> LanguageSize:
    known = asdict(LanguageSize())
    given = {key: table[key] for key in known if table.get(key) is not None}
    if "num_key_value_heads" not in given and "num_attention_heads" in given:
        given["num_key_value_heads"] = given["num_attention_heads"]
    nested = table.get("rope_parameters") or {}
    sizes = {**given, **({"rope_theta": nested["rope_theta"]} if "rope_theta" in nested else {})}
    return decode(LanguageSize, sizes, "config.json: text_config", ModelError)


def _check(config: Config) -> None:
    """Raises `ModelError` for sizes that no network can have."""
    for part in (config.dino, config.siglip, config.language):
        for name, size in asdict(part).items():  # before anything is counted or made by them
            if type(size) is int and not 0 <= size <= LARGEST_SIZE:
                raise ModelError(f"config.json: {name} is {size}; it must be from 0 to {LARGEST_SIZE:,}")
    depth = max(config.dino.depth, config.siglip.depth, config.language.num_hidden_layers)
    if depth > MOST_LAYERS:
        raise ModelError(f"config.json: a part has {depth} layers; at most {MOST_LAYERS} are read")
    language = config.language
    sizes = {
        "dino.width / heads": config.dino.width / config.dino.heads,
        "siglip.width / heads": config.siglip.width / config.siglip.heads,
        "hidden_size / num_attention_heads": language.hidden_size / language.num_attention_heads,
        "num_attention_heads / num_key_value_heads": language.num_attention_heads / language.num_key_value_heads,
    }
    for name, value in sizes.items():
        if value <= 0 or not math.isclose(value, round(value)):
            raise ModelError(f"config.json: {name} is {value:g}; it must be a whole number above 0")
    if min(config.dino.depth, config.siglip.depth) < 2:
        raise ModelError("config.json: a tower has fewer than 2 blocks; the second-to-last one is read")
    if language.vocab_size < WORDS:
        raise ModelError(f"config.json: vocab_size is {language.vocab_size}; Llama's words alone are {WORDS}")
    if config.chunk is not None and not 1 <= config.chunk <= 100:
        raise ModelError(f"config.json: {KEY}.chunk is {config.chunk}; it is 1 to 100 actions")
