"""Models and data sets on the Hugging Face Hub: what may go there and come from there, and both ways.

A shared folder holds models and data sets of known kinds, in files that are data and never code. The token is the
affair of `huggingface_hub`: it comes from HF_TOKEN or from `hf auth login`, and is never read or shown here.
"""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import urlsplit

from cognitivedrone.data.manifest import MANIFEST, read_json, read_manifest
from cognitivedrone.errors import CognitiveDroneError, HubError, import_extra
from cognitivedrone.files import check_no_link, reason_of, remove, replace_file, writing
from cognitivedrone.files.locks import LOCK_FILE, holds_files, sole_writer
from cognitivedrone.models.eyes.obstacle_eye import EYE_FILE, ObstacleEye
from cognitivedrone.models.eyes.picture_classifier import CLASSIFIER_FILE, PictureClassifier
from cognitivedrone.models.eyes.sight import EYES_FILE, EyesModel
from cognitivedrone.models.mind import LANGUAGE_FILE, Mind
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.models.words.concepts import CONCEPTS_FILE, ConceptsModel
from cognitivedrone.models.words.selector_file import SELECTOR_FILE, GateSelectorModel
from cognitivedrone.models.words.text_encoder import FILE as ENCODER_FILE
from cognitivedrone.models.words.text_encoder import TextEncoderModel
from cognitivedrone.models.words.word_pieces import PIECES_FILE, WordPieces
from cognitivedrone.system import move_folder
from cognitivedrone.system.imports import switch_off

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
        policy, reasoner = bool(has - set(_LOADERS)), has >= {EYES_FILE, SELECTOR_FILE, LANGUAGE_FILE}
        if not reasoner and (SELECTOR_FILE in has or not policy):
            raise HubError(
                f"{folder}: a reasoner needs {EYES_FILE}, {SELECTOR_FILE} and {LANGUAGE_FILE}; add what is missing"
            )
        return "model", {(True, True): "policy and reasoner", (False, True): "reasoner"}.get(
            (policy, reasoner), "policy"
        )
    if (folder / MANIFEST).is_file():
        read_manifest(folder)
        return "dataset", "data set"
    if _described(folder / "meta" / "info.json", {"codebase_version": str, "features": dict, "fps": int}):
        return "dataset", "LeRobot data set"
    described = (path for levels in ("", "*/", "*/*/") for path in folder.glob(f"{levels}dataset_info.json"))
    if any(_described(path, {"fileFormat": str, "splits": list}) for path in described):
        return "dataset", "RLDS data set"
    raise HubError(
        f"{folder}: holds nothing to share; a model has model.onnx, or {EYES_FILE}, {SELECTOR_FILE} and "
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


def _described(path: Path, fields: Mapping[str, type]) -> bool:
    """Whether a JSON file has these fields; false if there is none."""
    if not path.is_file():
        return False
    table: Any = read_json(path)
    return isinstance(table, dict) and all(isinstance(table.get(name), kind) for name, kind in fields.items())


_LOADERS: Final[dict[str, Any]] = {
    EYES_FILE: EyesModel.load,
    SELECTOR_FILE: GateSelectorModel.load,
    LANGUAGE_FILE: Mind.load,
    PIECES_FILE: WordPieces.load,
    ENCODER_FILE: TextEncoderModel.load,
    CLASSIFIER_FILE: PictureClassifier.load,
    CONCEPTS_FILE: ConceptsModel.load,
    EYE_FILE: ObstacleEye.load,
}


ENDPOINT: Final = "https://huggingface.co"
_SLACK_BYTES: Final = 10_000_000
"""A part that is sent again counts twice."""
MOST_FILES: Final = 50_000
_COMMIT: Final = re.compile(r"[0-9a-f]{40}")
_OF_THE_HUB: Final = (".gitattributes", "README.md")
"""Files that the Hub adds by itself; a data set's folder must not hold them."""
_REPLACED: Final = [*(f"*{suffix}" for suffix in SUFFIXES if suffix != ".md"), "*.tfrecord-*", "SHA256SUMS"]
"""What a new commit deletes, unless it brings it again."""


@dataclass(frozen=True, slots=True)
class Transfer:
    """What was pushed or pulled."""

    name: str
    """USER/NAME; of a data set datasets/USER/NAME."""
    kind: str
    """In words."""
    revision: str
    """Commit."""
    endpoint: str
    files: int
    bytes: int


def push(folder: Path, name: str, *, public: bool = False) -> Transfer:
    """Upload the model or data set in a folder as one commit; the repository is made if there is none, private unless
    `public`. Files that the folder no longer has are deleted there.

    Raises `HubError`, `MissingExtra`, and for a damaged folder `ModelError` or `DataError`.
    """
    shared = contents_of(folder)
    repo_type, kind = shared.repo_type, shared.kind
    stated, short = _typed(name)
    if stated not in (None, repo_type):
        raise HubError(f"{folder} holds a {kind}, and {name} names a data set; write {short}")
    api, endpoint = _api()
    with _refusals(name, endpoint):
        made = api.create_repo(short, repo_type=repo_type, private=not public, exist_ok=True)
        done = api.upload_folder(
            repo_id=made.repo_id, repo_type=repo_type, folder_path=folder,
            allow_patterns=list(shared.files) if repo_type == "model" else None, delete_patterns=_REPLACED,
            commit_message=f"Upload a {kind}",
        )  # fmt: skip
    return Transfer(_shown(made.repo_id, repo_type), kind, done.oid, endpoint, len(shared.files), shared.bytes)


def pull(name: str, folder: Path, *, revision: str = "main", max_gb: float = 20.0) -> Transfer:
    """Download a model or data set into a new folder, at one commit, which is recorded in FOLDER.hub.json beside it.

    What may hold code, is too large or of no known kind is refused, and leaves no folder; an interrupted download goes
    on the next time. Raises `HubError`, `MissingExtra`, and for damaged files `ModelError` or `DataError`.
    """
    if folder.exists() and not (folder.is_dir() and not holds_files(folder)):
        raise HubError(f"{folder}: is not empty; give a new folder")
    api, endpoint = _api()
    with _refusals(name, endpoint):
        repo_type, short, commit = _find(api, name, revision)
        tree = api.list_repo_tree(short, recursive=True, revision=commit, repo_type=repo_type)
        listed = {
            entry.path: int(entry.size)
            for entry in itertools.islice(tree, MOST_FILES + 1)
            if hasattr(entry, "size") and entry.path not in _OF_THE_HUB
        }
    if len(listed) > MOST_FILES:
        raise HubError(f"{name}: has more than {MOST_FILES:,} files; no model or data set of this package has")
    check_names(listed)
    if (size := sum(listed.values())) > max_gb * 1e9:
        raise HubError(f"{name}: has {size_text(size)}, more than {max_gb:g} GB; allow more with --max-gb")
    with sole_writer(folder, HubError, "pulling into it"):
        return _download(api, endpoint, repo_type, short, commit, listed, folder)


def _download(
    api: Any, endpoint: str, repo_type: RepoType, short: str, commit: str, listed: dict[str, int], folder: Path
) -> Transfer:
    name = _shown(short, repo_type)
    part = folder.with_name(f"{folder.name}.part")
    with _refusals(name, endpoint), writing(part, HubError):
        part.mkdir(parents=True, exist_ok=True)
        check_no_link(part.parent, part.name)  # of an interrupted download, which goes on
        api.snapshot_download(
            short, repo_type=repo_type, revision=commit, local_dir=part, cache_dir=part / ".cache",
            ignore_patterns=list(_OF_THE_HUB), tqdm_class=_limited(name, sum(listed.values())),
        )  # fmt: skip
    try:
        kind = _check(part, listed, repo_type, name)
    except CognitiveDroneError:
        with suppress(OSError):
            remove(part)
        raise
    done = Transfer(name, kind, commit, endpoint, len(listed), sum(listed.values()))
    with writing(folder, HubError):
        remove(folder, LOCK_FILE)
        move_folder(part, folder)
        record = json.dumps(asdict(done), indent=2) + "\n"
        replace_file(folder.with_name(f"{folder.name}.hub.json"), record.encode())
    return done


def _limited(name: str, size: int) -> Any:
    """The library's progress bar, which ends a download of more bytes than were listed while they arrive."""
    bar: Any = import_extra("huggingface_hub.utils", "hub").tqdm

    class Limited(bar):  # type: ignore[misc]  # a class of the library's
        def __init__(self, *args: Any, **options: Any) -> None:
            self.received, self.counts_bytes = 0.0, options.get("unit") == "B"
            super().__init__(*args, **options)

        def update(self, n: float | None = 1) -> bool | None:
            self.received += n or 0
            if self.counts_bytes and self.received > size + _SLACK_BYTES:
                raise HubError(f"{name}: sends more than the {size_text(size)} that it lists; it was not kept")
            more: bool | None = super().update(n)
            return more

    return Limited


def _check(part: Path, listed: dict[str, int], repo_type: RepoType, name: str) -> str:
    """The kind of what was downloaded, once it is nothing but what was listed."""
    with writing(part, HubError):
        remove(part, ".cache")
    there = {path.relative_to(part).as_posix(): path for path in part.rglob("*") if not path.is_dir()}
    if any(path.is_symlink() for path in there.values()):
        raise HubError(f"{name}: holds a link; links are not shared")
    if {each: path.stat().st_size for each, path in there.items()} != listed:
        raise HubError(f"{name}: sent other files than it lists; try again, or ask whom it belongs to")
    found, kind = kind_of(part)
    if found != repo_type:
        raise HubError(f"{name}: is a {repo_type} on the Hub, but holds a {kind}")
    return kind


def _find(api: Any, name: str, revision: str) -> tuple[RepoType, str, str]:
    """Type, name without its type, and commit; a name without a type is a model's, or else a data set's."""
    from huggingface_hub.errors import RepositoryNotFoundError

    stated, short = _typed(name)
    types: tuple[RepoType, ...] = ("model", "dataset") if stated is None else (stated,)
    for repo_type in types:
        try:
            commit = str(api.repo_info(short, repo_type=repo_type, revision=revision).sha)
            if not _COMMIT.fullmatch(commit):  # it becomes part of paths
                raise HubError(f"{name}: the server names the commit {commit[:60]!r}; expected 40 hexadecimal digits")
            return repo_type, short, commit
        except RepositoryNotFoundError:
            if repo_type == types[-1]:
                raise
    raise AssertionError


def _typed(name: str) -> tuple[RepoType | None, str]:
    short = name.removeprefix("datasets/")
    return (None if short == name else "dataset"), short


def _shown(short: str, repo_type: RepoType) -> str:
    return f"datasets/{short}" if repo_type == "dataset" else short


def _api() -> tuple[Any, str]:
    """The library's client, and the address of the Hub: HF_ENDPOINT, or the public one."""
    switch_off()
    endpoint = (os.environ.get("HF_ENDPOINT") or ENDPOINT).rstrip("/")
    try:
        place = urlsplit(endpoint)
    except ValueError as error:
        raise HubError(f"HF_ENDPOINT is {endpoint}, which is no address ({error}); correct or unset it") from None
    if place.scheme != "https" and place.hostname not in ("127.0.0.1", "::1", "localhost"):
        raise HubError(f"HF_ENDPOINT is {endpoint}, where a token could be read on its way; give an https address")
    return import_extra("huggingface_hub", "hub").HfApi(endpoint=endpoint, library_name="cognitivedrone"), endpoint


@contextmanager
def _refusals(name: str, endpoint: str) -> Iterator[None]:
    """Turn the errors of library, server and network into one sentence with the way out."""
    from huggingface_hub import errors

    try:
        yield
    except errors.RevisionNotFoundError:
        raise HubError(f"{name}: has no such revision at {endpoint}; give a branch, tag or commit of it") from None
    except (errors.RepositoryNotFoundError, errors.LocalTokenNotFoundError):
        raise HubError(f"{name}: {_ACCESS.format(endpoint)}") from None
    except errors.HfHubHTTPError as refused:
        status = refused.response.status_code
        reason = _ACCESS.format(endpoint) if status in (401, 403) else f"{endpoint} answered {status}; try again later"
        raise HubError(f"{name}: {reason}") from None
    except errors.HFValidationError:
        raise HubError(f"{name!r} is no name on the Hub; write USER/NAME") from None
    except CognitiveDroneError:
        raise
    except OSError as failed:
        raise HubError(f"{name}: {endpoint} cannot be reached or read: {reason_of(failed)}") from None
    except Exception as failed:
        # The library wraps what breaks an upload off; the errors of its HTTP client have no common public type.
        if not (isinstance(failed, RuntimeError) or type(failed).__module__.startswith(("httpx", "hf_xet"))):
            raise
        reason = f"cannot be reached, or broke off: {type(failed.__cause__ or failed).__name__}"
        raise HubError(f"{name}: {endpoint} {reason}; check the network and try again") from None


_ACCESS: Final = "is not at {}, or not open to you; check the name, and log in with `hf auth login` or set HF_TOKEN"
