"""A network that knows photographs, beside the panel reader: what a panel's picture may show, from its crop.

Policies and reasoners whose description says `classifier` ask it; `opinions` remembers its answers for a flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError
from cognitivedrone.models.onnx_file import beside, check_graph, field_of, numbers_of, open_model, shared
from cognitivedrone.types import IMAGE_SIZE, Image

CLASSIFIER_FILE: Final = "picture_classifier.onnx"
CLASSIFIER: Final = "picture-classifier"
CLASSES: Final = 1000
"""That it tells apart; some of them are things of our vocabulary."""
SIDE: Final = 144
"""Height and width of the crops that it sees, pixels."""
_MARGIN = 1.06  # of a crop around the panel's height
_CUT_PX = 3.0  # of a panel beyond the edge of the image that still counts as whole
_EDGE = 0.08  # of the crop's side that may show what is beside the panel
_SAME = 16  # of 255: as even as paper

Floats = NDArray[np.float32]


class PictureClassifier:
    """The network, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, names: Sequence[str]) -> None:
        self._session = session
        self.names = tuple(names)
        """Of the things that it distinguishes, as attribute values ("concept/thing:koala")."""

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> PictureClassifier:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, CLASSIFIER, threads=threads, optimise=True)
        names = field_of(table, "names", list, str(path))
        if not names or not all(isinstance(name, str) for name in names):
            raise ModelError(f"the names in {path} contain an entry that is not a name")
        check_graph(
            session,
            {"crops": ("tensor(uint8)", (SIDE, SIDE, 3))},
            {"shares": ("tensor(float)", (len(names),)), "classes": ("tensor(float)", (CLASSES,))},
            str(path),
        )
        return cls(session, names)

    @classmethod
    def of(cls, path: Path) -> PictureClassifier:
        """As `load`, one for policy and reasoner."""
        return shared(cls.load, path)

    def shares(self, crops: NDArray[np.uint8]) -> tuple[Floats, Floats]:
        """Probabilities (n, things) and (n, CLASSES) for crops (n, SIDE, SIDE, 3).

        What is missing to 1 in those of the things is something else; the classes are the network's own.
        """
        shares, classes = numbers_of(self._session, ("shares", "classes"), {"crops": crops}, "the picture classifier")
        return shares, classes


def classifier_of(model: Path) -> Path:
    """The picture classifier of a model's file: the one beside it, or the packaged one."""
    return beside(model, CLASSIFIER_FILE)


def crop_of(image: Image, u: float, v: float, height: float) -> NDArray[np.uint8] | None:
    """A panel's picture (SIDE, SIDE, 3), where it is wholly in the image: centre and height in pixels."""
    half = height / 2
    if min(u, v) < half - _CUT_PX or max(u, v) > IMAGE_SIZE - half + _CUT_PX:
        return None
    reach = _MARGIN * half
    cut = PIL.Image.fromarray(image).crop((round(u - reach), round(v - reach), round(u + reach), round(v + reach)))
    return np.asarray(cut.resize((SIDE, SIDE), PIL.Image.Resampling.BICUBIC))


def paper_share(crop: NDArray[np.uint8]) -> float:
    """How much of a picture is as bright and colourless as its paper, 0 to 1: little of a photograph that fills it."""
    edge = int(_EDGE * SIDE)
    pixels = crop[edge : SIDE - edge, edge : SIDE - edge].reshape(-1, 3).astype(np.int16)
    darkest = pixels.min(axis=1)
    paper = (darkest > np.percentile(darkest, 99) - _SAME) & (pixels.max(axis=1) - darkest < _SAME)
    return float(paper.mean())
