"""The files of a taught pilot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cognitivedrone.models.small_file import statistics_of
from cognitivedrone.training.common.checkpoint import read_checkpoint, restore
from cognitivedrone.training.reasoner.export import write_panel_reader, write_selector
from cognitivedrone.training.small_vla.export import provenance_of, write_policy

if TYPE_CHECKING:
    from cognitivedrone.training.teach.training import TeachTraining


def export_pilot(training: TeachTraining, checkpoint: Path, folder: Path) -> None:
    """Write `model.onnx`, the panel reader and the gate selector of a lesson's checkpoint."""
    tensors, facts = read_checkpoint(checkpoint)
    pilot = training.network()
    restore(tensors, pilot, None)
    pilot.eval()
    provenance = provenance_of(facts)
    action = statistics_of(training.policy.facts["action"], str(training.policy.path))
    write_policy(pilot.policy, training.lexicon(training.policy), action, provenance, folder / "model.onnx")
    write_panel_reader(pilot.policy, provenance, folder)
    write_selector(pilot.selector, training.names, training.lexicon(training.selector), provenance, folder)
