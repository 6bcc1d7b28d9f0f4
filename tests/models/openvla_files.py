"""Checkpoints of OpenVLA in small: a folder with every file that a published one has, made in a moment."""

import json
from pathlib import Path

from cognitivedrone.models.openvla.actions import ActionStatistics
from cognitivedrone.models.openvla.config import WORDS, tiny_config
from cognitivedrone.models.openvla.prepare import PIECES

STATISTICS = ActionStatistics((-0.2, -0.6, -0.4, -0.9), (2.0, 0.6, 0.4, 0.9))
LETTERS = "abcdefghijklmnopqrstuvwxyzIOWA0123456789*?."


def write_tokenizer(folder: Path) -> None:
    """Llama's ids, of which those that are known by number are the real words; the rest are letters and fill."""
    by_id = {id_: piece for piece, id_ in PIECES.items()} | {30_000 + i: letter for i, letter in enumerate(LETTERS)}
    special = {"special": True, "single_word": False, "lstrip": False, "rstrip": False, "normalized": False}
    told = {
        "version": "1.0",
        "added_tokens": [{"id": id_, "content": by_id[id_], **special} for id_ in range(3)],
        "normalizer": {
            "type": "Sequence",
            "normalizers": [
                {"type": "Prepend", "prepend": "▁"},
                {"type": "Replace", "pattern": {"String": " "}, "content": "▁"},
            ],
        },
        "model": {
            "type": "BPE",
            "unk_token": "<unk>",
            "fuse_unk": True,
            "byte_fallback": True,
            "vocab": {by_id.get(id_, f"<fill{id_}>"): id_ for id_ in range(WORDS)},
            "merges": [],
        },
    }
    (folder / "tokenizer.json").write_text(json.dumps(told), encoding="utf-8")


def write_checkpoint(folder: Path, chunk: int | None = None, seed: int = 3) -> Path:
    """A tiny checkpoint with random weights; returns its folder."""
    from cognitivedrone.models.openvla.weights import random_network, save

    folder.mkdir(parents=True, exist_ok=True)
    write_tokenizer(folder)
    save(random_network(tiny_config(chunk), seed=seed), folder, {"cognitivedrone": STATISTICS}, folder)
    return folder
