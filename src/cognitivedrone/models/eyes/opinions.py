"""What the picture classifier thinks of the panels of a flight, remembered by the colours of their gates.

The classifier costs as much as the rest of a policy, and a panel looks the same from one frame to the next. So each
panel is looked at again only once it has grown; its answers are averaged. A network that takes opinions (`joined`)
gets, for each of the three colours of gates, `opinions` (3, T), log-probabilities of the things of its attribute
schema, and `paper` (3,): how surely the picture is a drawing on paper, 1, or fills its panel as photographs do, 0; -1
where there is no opinion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.picture_classifier import CLASSES, crop_of, paper_share
from cognitivedrone.types import COLORS, Image

NONE = -1.0
"""The `paper` of a gate without opinion."""
_FLOOR = 0.005  # added to the classifier's probabilities, and that of a thing that it cannot name
_RAREST = 1e-6  # the same for one of its classes
_PAPER = (0.05, 0.2)  # share of paper up to which a picture fills its panel, and from which it is a drawing on paper
_SMALLEST_PX = 16.0  # lower panels are not looked at
_GROWN = 1.15  # since it was looked at last

Floats = NDArray[np.float32]


class Classifier(Protocol):
    """`picture_classifier.PictureClassifier`, or another network that knows photographs."""

    @property
    def names(self) -> Sequence[str]:
        """Of the things that it distinguishes, as attribute values."""
        ...

    def shares(self, crops: NDArray[np.uint8]) -> tuple[Floats, Floats]:
        """Probabilities (n, names) and (n, CLASSES) for crops (n, SIDE, SIDE, 3)."""
        ...


@dataclass
class _Panel:
    """A panel: the sums of the answers so far."""

    opinion: NDArray[np.float64]
    classes: NDArray[np.float64]
    asked_px: float = 0.0
    """Height when it was looked at last; 0 if never."""
    paper: float = 0.0
    answers: int = 0


class Opinions:
    """The opinions of one flight. `arrays` are the inputs of a network; `look` asks about the panels that it found."""

    def __init__(self, classifier: Classifier, attributes: AttributeSchema) -> None:
        self._classifier, self._attributes = classifier, attributes
        places = {attributes.names[index]: row for row, index in enumerate(attributes.things)}
        known = [(places[name], column) for column, name in enumerate(classifier.names) if name in places]
        self._into = np.array([row for row, _ in known], np.intp)
        self._from = np.array([column for _, column in known], np.intp)
        self._panels: dict[int, _Panel] = {}

    def fork(self) -> Opinions:
        """Those of another flight: none yet."""
        return Opinions(self._classifier, self._attributes)

    def reset(self) -> None:
        """Forget all panels."""
        self._panels.clear()

    def arrays(self) -> dict[str, Floats]:
        """`opinions` (3, T) and `paper` (3,)."""
        opinions = np.zeros((len(COLORS), len(self._attributes.things)), np.float32)
        paper = np.full(len(COLORS), NONE, np.float32)
        for color, panel in self._panels.items():
            if panel.answers:
                opinions[color], paper[color] = panel.opinion / panel.answers, panel.paper / panel.answers
        return {"opinions": opinions, "paper": paper}

    def classes(self, colors: Sequence[int]) -> Floats:
        """(n, CLASSES): what the panels of n gates show, as probabilities; all alike where there is no opinion."""
        told = np.zeros((len(colors), CLASSES))
        for row, color in enumerate(colors):
            panel = self._panels.get(color)
            if panel is not None and panel.answers:
                told[row] = panel.classes / panel.answers
        shares = np.exp(told - told.max(axis=1, keepdims=True))
        found: Floats = (shares / shares.sum(axis=1, keepdims=True)).astype(np.float32)
        return found

    def look(self, image: Image, boxes: Floats, colors: Sequence[int], most: int = len(COLORS)) -> bool:
        """Ask about panels (n, 3) of a frame (256, 256, 3): centre and height, pixels, and their gates' colours.

        At most `most` of those that have grown since they were asked about, the most grown first. Returns whether there
        is a new opinion.
        """
        grown: list[tuple[float, int, float, NDArray[np.uint8]]] = []
        for (u, v, height), color in zip(boxes.tolist(), colors, strict=True):
            panel = self._panels.get(color)
            growth = height / max(panel.asked_px if panel else 0.0, 1.0)
            if height < _SMALLEST_PX or growth < _GROWN:
                continue
            crop = crop_of(image, u, v, height)
            if crop is not None:
                grown.append((growth, color, height, crop))
        asked = sorted(grown, key=lambda each: -each[0])[:most]
        if not asked:
            return False
        answers = self._classifier.shares(np.stack([crop for _, _, _, crop in asked]))
        things = len(self._attributes.things)
        for (_, color, height, crop), share, classes in zip(asked, *answers, strict=True):
            panel = self._panels.setdefault(color, _Panel(np.zeros(things), np.zeros(CLASSES)))
            found = np.full(things, _FLOOR)
            found[self._into] += share[self._from]
            panel.opinion += np.log(found)
            panel.classes += np.log(classes + _RAREST)
            panel.paper += on_paper(crop)
            panel.answers += 1
            panel.asked_px = height
        return True


def on_paper(crop: NDArray[np.uint8]) -> float:
    """Whether a picture is a drawing on paper, 1, or fills its panel, 0."""
    low, high = _PAPER
    return min(1.0, max(0.0, (paper_share(crop) - low) / (high - low)))
