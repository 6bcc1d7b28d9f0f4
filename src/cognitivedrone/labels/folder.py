"""Label pack of a folder of images: `<kind>/<concept>.png` or `<concept>@<style>.png`.

The folders of the published benchmark are read as they are: a checkout, its `model_for_data_collection`, or a category
there (`Reasoning/Food/Healthy/healthy_13.dae`): the kind is the type's folder, and a panel shows the picture that its
model names. Their names vary in case, and some files carry the `dae` of the panel's model (`cheetahdae.jpg`); both are
ignored, as are blanks around names and how accents are stored (`texts.folded`). A number may be a word or digits.

The pictures of COLLADA panels, as the published collector stores them: `fox.dae`, which names a picture beside it.

A model's content takes precedence over its file name: some show a picture of another name, and some misspell the name
of their picture slightly.
"""

from __future__ import annotations

import hashlib
import os
import unicodedata
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from itertools import islice
from pathlib import Path, PurePath
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from cognitivedrone import types
from cognitivedrone.errors import LabelError, did_you_mean
from cognitivedrone.files import check_regular, is_hidden, own_files, read_regular, reason_of
from cognitivedrone.files.texts import folded
from cognitivedrone.labels.extended import ExtendedPack
from cognitivedrone.labels.images import SUFFIXES, draw_several, frozen_array, read_image
from cognitivedrone.pictures import MAX_FILE_BYTES, OTHER_SUFFIXES
from cognitivedrone.references import Reference, parse_reference

MODEL = ".dae"
MAX_MODEL_BYTES = 20_000_000
_COLLADA = "{http://www.collada.org/2005/11/COLLADASchema}"


def picture_of(model: Path) -> str:
    """The path of the picture that a COLLADA panel shows, as written there, relative to its folder.

    Raises `LabelError` if it is not COLLADA, or shows no picture.
    """
    try:
        root = ET.fromstring(read_regular(model, MAX_MODEL_BYTES))  # noqa: S314 - expat bounds what entities expand to
    except (OSError, ET.ParseError) as error:
        raise LabelError(f"{model}: cannot be read as a COLLADA model ({reason_of(error)})") from None
    named = {image.get("id"): image.findtext(f"{_COLLADA}init_from") for image in root.iter(f"{_COLLADA}image")}
    used = [surface.findtext(f"{_COLLADA}init_from") for surface in root.iter(f"{_COLLADA}surface")]
    found = [named[key] for key in used if key in named] + list(named.values())
    picture = next((text.strip() for text in found if text and text.strip()), None)
    if picture is None:
        raise LabelError(f"{model}: shows no picture; expected a texture in its library_images")
    return unquote(picture.removeprefix("file://"))


def shown_by(model: Path, pictures: Sequence[Path]) -> Path | None:
    """Which of the pictures beside a model it shows: the one that it names, whatever the case and suffix.

    Raises `LabelError` as `picture_of`.
    """
    named = Path(picture_of(model).replace("\\", "/"))
    exact = [picture for picture in pictures if picture.name == named.name]
    for wanted in (folded(named.name), folded(named.stem), folded(model.stem)):
        exact += [picture for picture in pictures if wanted in (folded(picture.name), folded(picture.stem))]
    return exact[0] if exact else None


MAX_FILES = 50_000
"""Of a folder: images of a pack, and files of any kind that are hashed."""
_CACHED_IMAGES = 128
PANELS_FOLDER = "model_for_data_collection"
"""Of a published checkout: the only part of it that holds panels."""
RECORDING = "data.csv"
"""A folder with such a file is a recorded flight, whose frames are no label images."""
_CATEGORIES = frozenset(category.replace("_", " ") for category in types.CATEGORIES)
_TYPES = frozenset({"celebrities", "patterns", "animals", "digits", "letters", "logos", "food", "math_desk"})
_NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
_NOT_READ = (*OTHER_SUFFIXES, ".bmp")
_MOST_NAMED = 5


class FolderPack:
    """Label pack of a folder of images; kinds that it lacks (sums, numbers, ...) come from the shipped pack."""

    def __init__(self, folder: Path, fallback: ExtendedPack) -> None:
        self.name = str(folder)
        self._folder = _panels_of(folder)
        self._fallback = fallback
        self._files, self.remarks = _scan(self._folder)
        """Kinds, concepts and styles with their files; and sentences about pictures that are not shown."""
        self._kinds = {folded(kind): kind for kind in self._files}
        self._cached = lru_cache(maxsize=_CACHED_IMAGES)(self._draw)

    def __reduce__(self) -> tuple[type[FolderPack], tuple[Path, ExtendedPack]]:
        return FolderPack, (Path(self.name), self._fallback)

    def image(self, reference: str) -> types.Image:
        """(H, W, 3) uint8 RGB, read-only, with the image's own aspect ratio, at most 256 px a side.

        An image without a style serves every style. Raises `LabelError` with the name of the missing file.
        """
        return self._cached(reference)

    def kinds(self) -> tuple[str, ...]:
        """The folder's kinds as spelled there, then those of the shipped pack."""
        own = tuple(self._files)
        return own + tuple(kind for kind in self._fallback.kinds() if kind not in self._kinds)

    def files(self) -> Iterator[tuple[str, str, str]]:
        """Kind, concept and style ("" for none) of every image of the folder, sorted."""
        for kind, concepts in sorted(self._files.items()):
            for concept, styles in sorted(concepts.items()):
                yield from ((kind, concept, style) for style in sorted(styles))

    def concepts(self, kind: str) -> tuple[str, ...]:
        """Concepts of a kind, `folded`; empty if the kind is open, such as sums."""
        if folded(kind) in self._kinds:
            return tuple(self._files[self._kinds[folded(kind)]])
        return self._fallback.concepts(kind)

    def styles(self, kind: str) -> tuple[str, ...]:
        """Styles of a kind; empty if its images have none."""
        if folded(kind) in self._kinds:
            concepts = self._files[self._kinds[folded(kind)]].values()
            return tuple(sorted({style for files in concepts for style in files if style}))
        return self._fallback.styles(kind)

    @cached_property
    def digest(self) -> str:
        """Hash of the names and contents of all images, and of the shipped pack."""
        digest = hashlib.sha256(self._fallback.digest.encode())
        paths = (path for concepts in self._files.values() for files in concepts.values() for path in files.values())
        for path in sorted(paths):
            digest.update(
                f"{path.relative_to(self._folder).as_posix()}\0{path.stat().st_size}\0".encode(errors="surrogateescape")
            )
            digest.update(_content(path))
        return digest.hexdigest()

    def _draw(self, text: str) -> types.Image:
        reference = parse_reference(text)
        if folded(reference.kind) in self._kinds:
            return frozen_array(read_image(self._path(reference)))
        if reference.kind == "several":
            return frozen_array(draw_several(reference.concept, reference.style, self.image))
        if reference.kind not in self._fallback.kinds():
            hint = did_you_mean(reference.kind, self.kinds())
            raise LabelError(f"label {text!r}: pack {self.name!r} has no kind {reference.kind!r}; {hint}")
        return self._fallback.image(text)

    def _path(self, reference: Reference) -> Path:
        kind = self._kinds[folded(reference.kind)]
        concept = folded(reference.concept).removesuffix(MODEL)
        files = self._files_of(kind, concept)
        if files is None:
            concepts = self._files[kind]
            wanted = f"{kind}/{reference.concept.removesuffix(MODEL)}.png (or .jpg, .jpeg, .webp)"
            hint = did_you_mean(concept, concepts)
            raise LabelError(f"label '{reference}' is not in pack {self.name!r}: no file {wanted} there; {hint}")
        style = folded(reference.style) if reference.style else min(files)
        path = files.get(style) or files.get("")
        if path is None:
            hint = did_you_mean(style, files)
            raise LabelError(f"label '{reference}' is not in pack {self.name!r} in style {style!r}; {hint}")
        return path

    def _files_of(self, kind: str, concept: str) -> dict[str, Path] | None:
        """The pictures of a concept by style: by its name or its model's, and of a number in whatever kind has it."""
        number = _NUMBERS.index(concept) if concept in _NUMBERS else int(concept) if concept.isdecimal() else None
        names = [concept, f"{concept}dae"]
        if number is not None and number < len(_NUMBERS):
            names += [str(number), _NUMBERS[number]]
        elsewhere = [other for other in self._files if other != kind] if number is not None else []
        for place in (kind, *elsewhere):
            for name in names:
                if files := self._files[place].get(name):
                    return files
        return None


def digest_of_labels(folder: Path) -> str:
    """SHA-256 over the names and contents of a label folder's files, hexadecimal; one file at a time is in memory.

    What `is_hidden` does not count. Of files that are no images and too large to be one, only names and sizes do.
    Raises `LabelError` for an image that is too large or cannot be read, and for what is no folder or has more than
    `MAX_FILES` files.
    """
    if not folder.is_dir():
        raise LabelError(f"--labels {folder} is not a folder of images")
    folder = _panels_of(folder)
    digest = hashlib.sha256()
    there = (path for path in folder.rglob("*") if path.is_file() and not is_hidden(path.relative_to(folder)))
    files = list(islice(there, MAX_FILES + 1))
    if len(files) > MAX_FILES:
        raise LabelError(f"label folder {folder} holds more than {MAX_FILES} files; give a folder of images alone")
    for file in sorted(files):
        size = file.stat().st_size
        read = size <= MAX_FILE_BYTES or file.suffix.lower() in SUFFIXES
        content = _content(file) if read else b""
        size = len(content) if read else size
        digest.update(f"{file.relative_to(folder).as_posix()}\0{size}\0".encode(errors="surrogateescape"))
        digest.update(content)
    return digest.hexdigest()


def _content(path: Path) -> bytes:
    """A file's content; raises `LabelError` if it is larger than an image may be, before it is read."""
    try:
        if (size := path.stat().st_size) > MAX_FILE_BYTES:
            raise LabelError(
                f"label image {path} has {size:,} bytes, and at most {MAX_FILE_BYTES:,} are read; save it smaller"
            )
        return read_regular(path, MAX_FILE_BYTES)
    except OSError as error:
        raise LabelError(f"label image {path} cannot be read: {reason_of(error)}; remove it from the folder") from None


def _check_image_file(path: Path) -> None:
    """Raise `LabelError` for a file with an image's name that is not a regular image file; it is not opened."""
    try:
        check_regular(path)
    except OSError as error:
        link = "it is a link to nothing" if path.is_symlink() and not path.exists() else reason_of(error)
        raise LabelError(f"label image {path} cannot be read: {link}; remove it from the folder") from None


def _panels_of(folder: Path) -> Path:
    """The part of a folder that holds label images: all of it, but of a published checkout the panels alone."""
    below = folder / PANELS_FOLDER
    return below if below.is_dir() else next(iter(own_files(folder, f"*/{PANELS_FOLDER}")), folder)


def _split(path: PurePath) -> tuple[str, str]:
    """Kind and the rest of a picture's path: a published type, what a category holds, or the first folder."""
    parts = path.parts[:-1]
    plain = [folded(part) for part in parts]
    first = next((i for i, part in enumerate(plain) if part in _TYPES), 0)
    if not first and len(parts) > 1 and plain[0].replace("_", " ") in _CATEGORIES:
        first = 1
    kind = parts[first] if parts else ""
    return kind, "/".join(path.parts[first + 1 :]) if parts else ""


def _scan(folder: Path) -> tuple[dict[str, dict[str, dict[str, Path]]], tuple[str, ...]]:
    """Kind to concept (`folded`) to style ("" for none) to file; and sentences about pictures that are not shown.

    Links that lead out of the folder, recorded flights and what `is_hidden` are ignored. Raises `LabelError` for a
    pipe, device, socket, folder or dangling link with an image's name.
    """
    root = folder.resolve()
    found: dict[str, dict[str, dict[str, Path]]] = {}
    spelled: dict[str, str] = {}
    twice: list[str] = []
    others: list[str] = []
    unshown: list[str] = []
    count = 0
    for parent, folders, names in os.walk(folder):
        if RECORDING in names:
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if not is_hidden(PurePath(name)))
        pictures: list[Path] = []
        for name in sorted([*names, *folders]):
            path = Path(parent) / name
            if is_hidden(PurePath(name)):
                continue
            if path.suffix.lower() not in SUFFIXES:
                if path.suffix.lower() in _NOT_READ:
                    others.append(path.relative_to(folder).as_posix())
                continue
            folder_name, rest = _split(path.relative_to(folder))
            _check_image_file(path)
            if not rest or not path.resolve().is_relative_to(root):
                continue
            count += 1
            if count > MAX_FILES:
                raise LabelError(f"label folder {folder} holds more than {MAX_FILES} images")
            pictures.append(path)
            concept, _, style = rest[: -len(path.suffix)].partition("@")
            kind = spelled.setdefault(folded(folder_name), unicodedata.normalize("NFC", folder_name).strip())
            styles = found.setdefault(kind, {}).setdefault(folded(concept), {})
            if (shown := styles.setdefault(folded(style), path)) != path:
                twice.append(f"{path.relative_to(folder)} beside {shown.relative_to(folder)}")
        models = {folded(Path(name).stem): name for name in sorted(names) if name.lower().endswith(MODEL) and pictures}
        for name in models.values():
            model = Path(parent) / name
            try:
                picture = shown_by(model, pictures)
            except LabelError:
                picture = None
            folder_name, rest = _split(model.relative_to(folder))
            if picture is None:
                unshown.append(model.relative_to(folder).as_posix())
            else:
                concepts = found[spelled[folded(folder_name)]]
                if folded(picture.stem) not in models:  # it is no concept of its own
                    concepts.pop(folded(_split(picture.relative_to(folder))[1][: -len(picture.suffix)]), None)
                concepts[folded(rest[: -len(MODEL)])] = {"": picture}
    unread = f"{_some(others)} cannot be read: save them as PNG, JPEG or WebP" if others else ""
    if not found:
        hint = f"; {unread}" if others else ""
        raise LabelError(f"label folder {folder} holds no images; expected files such as animal/cat.png in it{hint}")
    same = f"two files have one name, and the first is not shown: {_some(twice)}; rename or remove one of each"
    bare = f"the pictures of {_some(unshown)} are not beside them, or cannot be told; put them there"
    remarks = [*([same] if twice else []), *([unread] if others else []), *([bare] if unshown else [])]
    return found, tuple(f"label folder {folder}: {remark}" for remark in remarks)


def _some(names: list[str]) -> str:
    """The first of some names."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more
