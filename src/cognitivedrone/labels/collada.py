"""The pictures of COLLADA panels, as the published collector stores them: `fox.dae`, which names a picture beside it.

A model's content takes precedence over its file name: some show a picture of another name, and some misspell the name
of their picture slightly.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from cognitivedrone.errors import LabelError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.files.texts import folded

MODEL = ".dae"
MAX_MODEL_BYTES = 20_000_000
_COLLADA = "{http://www.collada.org/2005/11/COLLADASchema}"


def picture_of(model: Path) -> str:
    """The path of the picture that a COLLADA panel shows, as written there, relative to its folder.

    Raises `LabelError` if it is not COLLADA, or shows no picture.
    """
    try:
        root = ET.fromstring(read_regular(model, MAX_MODEL_BYTES))  # noqa: S314 - expat bounds what entities expand to
    except OSError as error:
        raise LabelError(f"{model}: cannot be read as a COLLADA model ({reason_of(error)})") from None
    except ET.ParseError as error:
        raise LabelError(f"{model}: cannot be read as a COLLADA model ({error})") from None
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
