"""From the checkpoint of a small VLA to its model files: self-describing ONNX graphs with half-precision weights."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cognitivedrone import checkout
from cognitivedrone.files import read_regular, replace_file, replacing
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import SLOTS
from cognitivedrone.models.eyes.panel_reader import ReaderConfig
from cognitivedrone.models.eyes.sight import FEATURES
from cognitivedrone.models.onnx_file import LARGEST_BYTES, Provenance
from cognitivedrone.models.small_file import STATE, ActionStatistics, Description, SmallModel, describe
from cognitivedrone.models.small_vla import FlightHead, SmallVLA, SmallVLAConfig
from cognitivedrone.models.words.concepts import CONCEPTS_FILE
from cognitivedrone.models.words.gate_selector import SelectorConfig
from cognitivedrone.models.words.language import LanguageConfig
from cognitivedrone.models.words.text_encoder import FILE, packaged_encoder
from cognitivedrone.models.words.word_pieces import PIECES_FILE
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.training.small_vla.concepts import write_concepts
from cognitivedrone.training.small_vla.graph import write_encoder, write_eyes, write_language, write_onnx
from cognitivedrone.training.small_vla.language import LanguageLoss, LanguageNetwork
from cognitivedrone.training.small_vla.sampling import StreamRecipe
from cognitivedrone.training.small_vla.stream import training_batches
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore, save_checkpoint
from cognitivedrone.training.trainer.start import StartingPoint, read_start
from cognitivedrone.training.trainer.training_task import Batch, to_tensors


def load_trained(path: Path | None) -> tuple[SmallVLA, StartingPoint]:
    """A policy from its checkpoint or model file, or the packaged one; ready to fly."""
    start = read_start(path, "policy")
    return trained(start), start


def trained(start: StartingPoint) -> SmallVLA:
    """The policy in `start`, ready to fly."""
    facts: dict[str, Any] = start.facts
    network = SmallVLA(SmallVLAConfig.of(facts["recipe"]["network"]), AttributeSchema(tuple(facts["attributes"])))
    start.restore(network)
    network.eval()
    return network


_STATISTICS_FRAMES = 2_000
_SHOWN_FRAMES = 100
_STATISTICS_SEED = (0, 10**6 + 1)


def export(checkpoint: Path, out: Path, *, data: Path | None = None, encoder: Path | None = None) -> Description:
    """Write the network of a checkpoint as self-describing ONNX files, its head to `out`; returns their description.

    `data` is the training data set, if there was one; the text encoder in `encoder` is copied beside the file, if it is
    not the packaged one. Raises `TrainingError` for a bad checkpoint.
    """
    network, start = load_trained(checkpoint)
    stream = stream_of(start.facts)
    action = action_statistics(network, stream, encoder, data)
    copy_encoder(encoder, out.parent)
    images = shown(stream, data)
    return write_policy(network, start.facts["encoder"], action, provenance_of(start.facts), out, images)


def copy_encoder(encoder: Path | None, folder: Path) -> None:
    """Put the text encoder, its word pieces and the concepts that it read beside a policy's file, if it is not the
    packaged one or there already.
    """
    if encoder is not None and encoder.resolve() not in (packaged_encoder().resolve(), (folder / FILE).resolve()):
        for path in (encoder, encoder.with_name(PIECES_FILE), encoder.with_name(CONCEPTS_FILE)):
            if path.is_file():
                replace_file(folder / path.name, read_regular(path, LARGEST_BYTES))


def write_policy(
    network: SmallVLA,
    encoder: str,
    action: ActionStatistics,
    provenance: Provenance,
    out: Path,
    images: NDArray[Any],
    *,
    classifier: bool = True,
) -> Description:
    """Write the files of a policy that was trained with the text encoder of a digest: eyes, by `images` as `shown`,
    language, and its head, to `out`; returns its description.

    `classifier` says whether it shall ask the picture classifier.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    description = Description(
        name=provenance.recipe,
        encoder=encoder,
        chunk=network.config.chunk,
        action=action,
        network=network.config.facts(),
        attributes=network.schema.names,
        provenance=provenance,
    )
    write_eyes(network, provenance, out.parent, images, classifier=classifier)
    if network.language is not None:
        write_language(network.language, network.schema, encoder, provenance, out.parent)
    width = network.config.backbone[2]
    example = {
        "slots": torch.zeros(2, SLOTS, width + FEATURES),
        "whole": torch.zeros(2, width),
        "state": torch.zeros(2, STATE),
    }
    with replacing(out) as beside:
        write_onnx(FlightHead(network), example, ("options", "inclination"), beside)
        describe(beside, description)
    SmallModel.load(out)
    return description


def provenance_of(facts: Mapping[str, Any]) -> Provenance:
    """The provenance of a network, from the facts of its checkpoint."""
    recipe = facts["recipe"]
    made = "made while training, sha256:" + hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    return Provenance(
        recipe=recipe["name"],
        data=facts.get("data") or made,
        commit=checkout.commit() or "unknown",
        trained=datetime.now(UTC).isoformat(timespec="seconds"),
        steps=int(facts["step"]),
        scores={},
    )


def stream_of(facts: Mapping[str, Any]) -> StreamRecipe:
    """The rollout stream that a policy was trained from; the default one where that is not known."""
    recorded = facts["recipe"].get("stream")
    if recorded is None:  # a training run on language that started from a model file
        return StreamRecipe()
    return StreamRecipe(
        **{
            field.name: recorded[field.name]
            for field in fields(StreamRecipe)
            if field.name in recorded and field.name != "expert"
        },
        expert=ExpertConfig(**recorded["expert"]),
    )


def action_statistics(
    network: SmallVLA, stream: StreamRecipe, encoder: Path | None, data: Path | None = None
) -> ActionStatistics:
    """The distribution of the actions in a stream or a data set, and the network's output range."""
    taken = _drawn(stream, encoder, data, _STATISTICS_FRAMES)
    actions = np.concatenate([batch["action"][batch["valid"]][:, 0] for batch in taken]).astype(np.float64)

    def four(values: Any) -> tuple[float, float, float, float]:
        a, b, c, d = (round(float(value), 5) for value in values)
        return a, b, c, d

    return ActionStatistics(
        low=four(network.flight.low),
        high=four(network.flight.high),
        mean=four(actions.mean(axis=0)),
        std=four(actions.std(axis=0)),
        q01=four(np.quantile(actions, 0.01, axis=0)),
        q99=four(np.quantile(actions, 0.99, axis=0)),
    )


def shown(stream: StreamRecipe, data: Path | None = None) -> NDArray[Any]:
    """Frames (100, 256, 256, 3) of a stream or a data set, by whose ranges the numbers of eyes are rounded."""
    (batch,) = _drawn(stream, None, data, _SHOWN_FRAMES)
    images: NDArray[Any] = batch["image"]
    return images


def _drawn(stream: StreamRecipe, encoder: Path | None, data: Path | None, frames: int) -> list[Batch]:
    recipe = replace(stream, batch=100, sentences=1, learner=0.0)
    made = training_batches(recipe, encoder, data)(_STATISTICS_SEED)
    return list(islice(made, frames // recipe.batch))


def export_language(checkpoint: Path, folder: Path, temperature: Callable[[Callable[[Batch], Tensor]], float]) -> None:
    """Write the text encoder, and the concepts as it reads them, to `folder`; calibrate the language in the checkpoint
    by `temperature`.
    """
    tensors, facts = read_checkpoint(checkpoint)
    sizes = facts["recipe"]["network"]
    network = LanguageNetwork(
        SelectorConfig.of(sizes["encoder"]),
        LanguageConfig.of(sizes["language"]),
        ReaderConfig.of(sizes["reader"]),
        facts["attributes"],
    )
    restore(tensors, network, None)
    schema = AttributeSchema(tuple(facts["attributes"]))
    network.language.temperature.fill_(1.0)
    loss = LanguageLoss(network, schema).eval()
    network.language.temperature.fill_(temperature(lambda batch: loss.answers(to_tensors(batch))[1]))
    digest = write_encoder(network.encoder, facts["pieces"], provenance_of(facts), folder)
    write_concepts(folder)
    save_checkpoint(checkpoint, network, None, {**facts, "encoder": digest})
