"""What a shared folder may hold: models and data sets of known kinds, in files that are data and never code."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from cognitivedrone.data.disk import read_json
from cognitivedrone.data.layout import MANIFEST, read_manifest
from cognitivedrone.errors import HubError
from cognitivedrone.models.eyes.obstacle_eye import EYE_FILE, ObstacleEye
from cognitivedrone.models.eyes.picture_classifier import CLASSIFIER_FILE, PictureClassifier
from cognitivedrone.models.reasoner_file import (
    LANGUAGE_FILE,
    READER_FILE,
    SELECTOR_FILE,
    GateSelectorModel,
    LanguageModel,
    PanelReaderModel,
)
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.models.words.text_encoder import FILE as ENCODER_FILE
from cognitivedrone.models.words.text_encoder import TextEncoderModel

RepoType = Literal["model", "dataset"]
SUFFIXES: Final = (".json", ".jsonl", ".md", ".mp4", ".onnx", ".parquet", ".png")
"""Of files that may be shared, beside `SHA256SUMS` and the shards of TFRecord. None of them can hold code."""
MODEL_NOTES: Final = ("README.md", "recipe.json", "metrics.jsonl", "curves.png")
"""What is shared of a training run beside its models."""
_NAME: Final = re.compile(r"(?:\w[\w.-]*/){0,8}\w[\w.-]*", re.ASCII)
_TFRECORD: Final = re.compile(r".*\.tfrecord-\d{5}-of-\d{5}")
_LONGEST: Final = 200


def check_names(names: Iterable[str]) -> None:
    """Raise `HubError` for the first name, relative to its folder, that may not be shared."""
    for name in names:
        if not _NAME.fullmatch(name) or ".." in name or len(name) > _LONGEST:
            raise HubError(f"{name!r} is not shared: names are of letters, digits, '_', '-' and '.', in folders")
        if not (name.endswith(SUFFIXES) or _TFRECORD.fullmatch(name) or name == "SHA256SUMS"):
            raise HubError(
                f"{name!r} is not shared: it may hold code; models and data sets have files of {', '.join(SUFFIXES)}, "
                "SHA256SUMS and TFRecord shards"
            )


def kind_of(folder: Path) -> tuple[RepoType, str]:
    """What is in a folder, in the Hub's and in our words, once its manifest or models are checked.

    Raises `HubError` for a folder of another kind, `DataError` and `ModelError` for damaged ones.
    """
    models = sorted(path for path in folder.glob("*.onnx") if path.is_file())
    if models:
        for path in models:
            _LOADERS.get(path.name, SmallModel.load)(path)
        has = {path.name for path in models}
        policy, reasoner = bool(has - set(_LOADERS)), has >= {READER_FILE, SELECTOR_FILE, LANGUAGE_FILE}
        if not reasoner and (SELECTOR_FILE in has or not policy):
            raise HubError(
                f"{folder}: a reasoner needs {READER_FILE}, {SELECTOR_FILE} and {LANGUAGE_FILE}; add what is missing"
            )
        return "model", {(True, True): "policy and reasoner", (False, True): "reasoner"}.get(
            (policy, reasoner), "policy"
        )
    if (folder / MANIFEST).is_file():
        read_manifest(folder)
        return "dataset", "data set"
    if _described(folder / "meta" / "info.json", {"codebase_version": str, "features": dict, "fps": int}):
        return "dataset", "LeRobot data set"
    if any(_described(path, {"fileFormat": str, "splits": list}) for path in _rlds(folder)):
        return "dataset", "RLDS data set"
    raise HubError(
        f"{folder}: holds nothing to share; a model has model.onnx, or {READER_FILE}, {SELECTOR_FILE} and "
        f"{LANGUAGE_FILE}, a data set {MANIFEST}, meta/info.json (LeRobot) or dataset_info.json (RLDS)"
    )


@dataclass(frozen=True, slots=True)
class Contents:
    """What of a folder is shared."""

    repo_type: RepoType
    kind: str
    files: dict[str, int]
    """Names and bytes."""

    @property
    def bytes(self) -> int:
        """Of all files."""
        return sum(self.files.values())


def contents_of(folder: Path) -> Contents:
    """What is shared: of a model the known files, of a data set all; raises `HubError` if one must not be."""
    if not folder.is_dir():
        raise HubError(f"{folder}: there is no such folder; give one with a model or a data set")
    repo_type, kind = kind_of(folder)
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if repo_type == "model" and name not in MODEL_NOTES and not ("/" not in name and path.suffix == ".onnx"):
            continue
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise HubError(f"{path}: is a link or no file; links are not shared, put the file itself there")
        if path.is_file():
            found[name] = path.stat().st_size
    check_names(found)
    return Contents(repo_type, kind, found)


def size_text(size: int) -> str:
    """Bytes for people."""
    power = max(0, min(3, (len(str(size)) - 1) // 3))
    return f"{size / 1000**power:.3g} {('B', 'kB', 'MB', 'GB')[power]}"


def _rlds(folder: Path) -> list[Path]:
    return [folder / "dataset_info.json", *folder.glob("*/dataset_info.json"), *folder.glob("*/*/dataset_info.json")]


def _described(path: Path, fields: Mapping[str, type]) -> bool:
    """Whether a JSON file has these fields; false if there is none."""
    if not path.is_file():
        return False
    table: Any = read_json(path)
    return isinstance(table, dict) and all(isinstance(table.get(name), kind) for name, kind in fields.items())


_LOADERS: Final[dict[str, Any]] = {
    READER_FILE: PanelReaderModel.load,
    SELECTOR_FILE: GateSelectorModel.load,
    LANGUAGE_FILE: LanguageModel.load,
    ENCODER_FILE: TextEncoderModel.load,
    CLASSIFIER_FILE: PictureClassifier.load,
    EYE_FILE: ObstacleEye.load,
}
