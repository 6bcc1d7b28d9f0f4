"""Names and shapes of the published tensors, which of them are unused, and their names here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeAlias

from cognitivedrone.errors import ModelError
from cognitivedrone.models.openvla.config import ACTION_SIZE, PATCH, PATCHES, Config, LanguageSize, TowerSize

Shapes: TypeAlias = dict[str, tuple[int, ...]]

PREFIXES = {
    "vision_backbone.featurizer.": "vision.dino.",
    "vision_backbone.fused_featurizer.": "vision.siglip.",
    "projector.": "projector.",
    "language_model.": "language_model.",
}
"""Prefixes of published names and the prefixes here; the rest is the same."""
HEAD_BLOCKS = 2
"""Residual blocks of the parallel decoder's head."""
_SHOWN = 4


def own_name(published: str) -> str:
    """The name here of a published tensor; raises `KeyError` for an unknown part."""
    for theirs, ours in PREFIXES.items():
        if published.startswith(theirs):
            return ours + published.removeprefix(theirs)
    raise KeyError(published)


def published_name(own: str) -> str:
    """The inverse of `own_name`."""
    for theirs, ours in PREFIXES.items():
        if own.startswith(ours):
            return theirs + own.removeprefix(ours)
    raise KeyError(own)


def used_tensors(config: Config) -> Shapes:
    """Shapes of the tensors that the network uses, by their published names."""
    dino, siglip, *_ = PREFIXES
    return {
        **_prefixed(dino, _tower(config.dino, range(config.dino.depth - 1))),
        **_prefixed(siglip, _tower(config.siglip, range(config.siglip.depth - 1))),
        **_prefixed("projector.", _projector(config.vision_width, config.language.hidden_size)),
        **_prefixed("language_model.", _language(config.language)),
    }


def unused_tensors(config: Config) -> Shapes:
    """Shapes of the other tensors of a published checkpoint: last blocks, final norms and SigLIP's pooling."""
    dino, siglip, *_ = PREFIXES
    found: Shapes = {}
    for prefix, size in ((dino, config.dino), (siglip, config.siglip)):
        found |= _prefixed(f"{prefix}blocks.{size.depth - 1}.", _block(size))
        found |= _prefixed(f"{prefix}norm.", _norm(size.width))
    return found | _prefixed(f"{siglip}attn_pool.", _pool(config.siglip))


def head_tensors(config: Config) -> Shapes:
    """Shapes of the parallel decoder's head, which has its own file; empty if there is none."""
    if config.chunk is None:
        return {}
    width = config.language.hidden_size
    found: Shapes = {**_prefixed("norm.", _norm(ACTION_SIZE * width)), **_linear("enter.", ACTION_SIZE * width, width)}
    for index in range(HEAD_BLOCKS):
        found |= _prefixed(f"blocks.{index}.norm.", _norm(width)) | _linear(f"blocks.{index}.linear.", width, width)
    return found | _prefixed("leave_norm.", _norm(width)) | _linear("leave.", width, ACTION_SIZE)


def check_tensors(found: Mapping[str, tuple[int, ...]], needed: Shapes, spare: Shapes, where: str) -> None:
    """Raises `ModelError` that lists the first missing, extra or misshapen tensors; all of `spare` may be missing."""
    known = needed | spare
    faults = [f"{name} is missing" for name in needed if name not in found]
    faults += [f"{name} is extra" for name in found if name not in known]
    faults += [
        f"{name} is {list(shape)} and should be {list(known[name])}"
        for name, shape in found.items()
        if name in known and tuple(shape) != known[name]
    ]
    if faults:
        more = f", and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
        count = "1 tensor does" if len(faults) == 1 else f"{len(faults)} tensors do"
        raise ModelError(
            f"{where}: {count} not fit its config.json: {'; '.join(faults[:_SHOWN])}{more};"
            " give a whole checkpoint of this architecture, with adapters merged"
        )


def elements(shapes: Iterable[tuple[int, ...]]) -> int:
    """Number of elements in all tensors of these shapes."""
    total = 0
    for shape in shapes:
        product = 1
        for side in shape:
            product *= side
        total += product
    return total


def _prefixed(prefix: str, shapes: Shapes) -> Shapes:
    return {prefix + name: shape for name, shape in shapes.items()}


def _linear(prefix: str, inputs: int, outputs: int) -> Shapes:
    return {f"{prefix}weight": (outputs, inputs), f"{prefix}bias": (outputs,)}


def _norm(width: int) -> Shapes:
    return {"weight": (width,), "bias": (width,)}


def _tower(size: TowerSize, blocks: Iterable[int]) -> Shapes:
    shapes: Shapes = {}
    if size.registers is not None:
        shapes |= {"cls_token": (1, 1, size.width), "reg_token": (1, size.registers, size.width)}
    shapes |= {
        "pos_embed": (1, PATCHES, size.width),
        "patch_embed.proj.weight": (size.width, 3, PATCH, PATCH),
        "patch_embed.proj.bias": (size.width,),
    }
    for index in blocks:
        shapes |= _prefixed(f"blocks.{index}.", _block(size))
    return shapes


def _block(size: TowerSize) -> Shapes:
    shapes = _prefixed("norm1.", _norm(size.width)) | _prefixed("norm2.", _norm(size.width))
    shapes |= _linear("attn.qkv.", size.width, 3 * size.width) | _linear("attn.proj.", size.width, size.width)
    shapes |= _mlp(size)
    if size.layer_scale:
        shapes |= {"ls1.scale_factor": (size.width,), "ls2.scale_factor": (size.width,)}
    return shapes


def _mlp(size: TowerSize) -> Shapes:
    return _linear("mlp.fc1.", size.width, size.hidden) | _linear("mlp.fc2.", size.hidden, size.width)


def _pool(size: TowerSize) -> Shapes:
    shapes: Shapes = {"latent": (1, 1, size.width)}
    shapes |= _linear("q.", size.width, size.width) | _linear("kv.", size.width, 2 * size.width)
    return shapes | _linear("proj.", size.width, size.width) | _prefixed("norm.", _norm(size.width)) | _mlp(size)


def _projector(vision: int, words: int) -> Shapes:
    return _linear("fc1.", vision, 4 * vision) | _linear("fc2.", 4 * vision, words) | _linear("fc3.", words, words)


def _language(size: LanguageSize) -> Shapes:
    width, values = size.hidden_size, size.hidden_size // size.num_attention_heads * size.num_key_value_heads
    shapes: Shapes = {"model.embed_tokens.weight": (size.vocab_size, width)}
    for index in range(size.num_hidden_layers):
        layer = {
            "self_attn.q_proj.weight": (width, width),
            "self_attn.k_proj.weight": (values, width),
            "self_attn.v_proj.weight": (values, width),
            "self_attn.o_proj.weight": (width, width),
            "mlp.gate_proj.weight": (size.intermediate_size, width),
            "mlp.up_proj.weight": (size.intermediate_size, width),
            "mlp.down_proj.weight": (width, size.intermediate_size),
            "input_layernorm.weight": (width,),
            "post_attention_layernorm.weight": (width,),
        }
        shapes |= _prefixed(f"model.layers.{index}.", layer)
    return shapes | {"model.norm.weight": (width,), "lm_head.weight": (size.vocab_size, width)}
