"""What the picture classifier thinks of the panels of a flight, remembered by the colours of their gates, and joined
with what the panel reader reads.

The classifier costs as much as the rest of a policy, and a panel looks the same from one frame to the next. So each
panel is looked at again only once it has grown; its answers are averaged. Its log-probabilities of things and the
reader's, which knows drawings, are added. A picture without paper around it fills its panel as photographs do; for
those the reader, which was trained on drawings, counts for half. These weights are set, not trained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.picture_classifier import CLASSES, crop_of, paper_share
from cognitivedrone.models.onnx_file import shares_of
from cognitivedrone.types import COLORS, Image

_FLOOR = 0.005  # added to the classifier's probabilities, and that of a thing that it cannot name
_RAREST = 1e-6  # the same for one of its classes
_PAPER = (0.05, 0.2)  # share of paper up to which a picture fills its panel, and from which it is a drawing on paper
_SMALLEST_PX = 16.0  # lower panels are not looked at
_GROWN = 1.15  # since it was looked at last
_FILLED = 0.5  # weight of the reader for a picture that fills its panel
_LEAST = np.float32(1e-5)  # probability of a reading
_NO_KIND = ("kind/thing", "kind/unknown")

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
    """At least 1 from when it is remembered."""


class Opinions:
    """The opinions of one flight: `look` asks about the panels of a frame, `joined` makes use of what was answered."""

    def __init__(self, classifier: Classifier, attributes: AttributeSchema) -> None:
        self._classifier, self._attributes = classifier, attributes
        places = {attributes.names[index]: row for row, index in enumerate(attributes.things)}
        known = [(places[name], column) for column, name in enumerate(classifier.names) if name in places]
        self._into = np.array([row for row, _ in known], np.intp)
        self._from = np.array([column for _, column in known], np.intp)
        self._things = list(attributes.things)
        kinds = attributes.groups["kind"]
        self._others = [at for at in range(kinds.start, kinds.stop) if attributes.names[at] not in _NO_KIND]
        self._thing = attributes.names.index("kind/thing")
        self._panels: dict[int, _Panel] = {}

    def fork(self) -> Opinions:
        """Those of another flight: none yet."""
        return Opinions(self._classifier, self._attributes)

    def reset(self) -> None:
        """Forget all panels."""
        self._panels.clear()

    @property
    def asked(self) -> dict[int, float]:
        """The panels that there is an opinion on, by the colours of their gates: how surely the picture is a drawing on
        paper, 1, or fills its panel, 0.
        """
        return {color: panel.paper / panel.answers for color, panel in self._panels.items()}

    def joined(self, readings: Floats, looks: Floats) -> Floats:
        """(n, F): readings (n, F), probabilities, of panels at gates that look like `looks` (n, 8), with the opinions
        on them. A photograph that is recognised is one of a thing, unless the reader is sure of another kind.
        """
        found = readings.copy()
        for row, color in enumerate(looks[:, : len(COLORS)].argmax(axis=1).tolist()):
            panel = self._panels.get(color)
            if panel is None:
                continue
            paper = np.float32(panel.paper / panel.answers)
            shares = readings[row, self._things]
            mass = shares.sum()
            told = (_FILLED + (1 - _FILLED) * paper) * np.log(shares / max(mass, _LEAST) + _LEAST)
            together = shares_of(told + (panel.opinion / panel.answers).astype(np.float32))
            sure = (1 - paper) * together.max() * (1 - readings[row, self._others].max(initial=0.0))
            found[row] *= 1 - sure
            found[row, self._things] = (mass * (1 - sure) + sure) * together
            found[row, self._thing] += sure
        return found

    def classes(self, colors: Sequence[int]) -> Floats:
        """(n, CLASSES): what the panels of n gates show, as probabilities; all alike where there is no opinion."""
        told = np.zeros((len(colors), CLASSES))
        for row, color in enumerate(colors):
            if (panel := self._panels.get(color)) is not None:
                told[row] = panel.classes / panel.answers
        return shares_of(told).astype(np.float32)

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
