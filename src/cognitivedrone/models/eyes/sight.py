"""What a frame shows, as policy and reasoner see it: gates, panels and board, from one network that both share.

Contract of the graph; the batch is a dynamic axis, C the width of the network's features, F the number of attribute
values: input `image` uint8 (batch, 256, 256, 3); outputs `gates` float32 (batch, 3, 4), each one's centre u, v in
pixels, detection score 0 to 1, and distance in m; `slots` float32 (batch, 3, C + 16), each gate's features, geometry,
and probabilities of its colours, shapes and sizes, and `whole` float32 (batch, C), for the head that flies; and, of
eyes that read, `readings` float32 (batch, 4, F), probabilities of the attribute values of three panels and the board,
and `boxes` float32 (batch, 4, 4) of panels and board: centre u, v and height in pixels, and the score of gate or board.
Gates are unordered.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.onnx_file import check_graph, count_of, field_of, numbers_of, open_model, shared
from cognitivedrone.types import IMAGE_SIZE, Image

EYES_FILE: Final = "eyes.onnx"
EYES: Final = "eyes"
FORMER_EYES: Final = {
    "small-reasoner-eyes": "a panel reader of an earlier kind, which asks no picture classifier",
    "panel-reader": "a panel reader of an earlier kind, which was the reasoner's alone",
}
LOOKS: Final = 8
"""Colours, shapes and sizes of gates, in the order of `types`."""
FEATURES: Final = 8 + LOOKS
"""Of a gate beside those of the network's width: its geometry and its look."""
_KEPT = 4  # frames that are remembered: policy and reasoner are asked about the same one

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Sight:
    """What n frames show; see the contract for the arrays."""

    gates: Floats
    slots: Floats
    whole: Floats
    readings: Floats | None = None
    boxes: Floats | None = None

    @property
    def looks(self) -> Floats:
        """(n, 3, 8) probabilities of the gates' looks."""
        return self.slots[..., -LOOKS:]


class EyesModel:
    """The network, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, attributes: AttributeSchema, width: int, *, classifier: bool) -> None:
        self._session = session
        self.width = width
        """Of its features."""
        self.attributes = attributes
        """What it reads on panels; none of eyes that only find gates."""
        self.classifier = classifier
        """Whether the picture classifier is to be asked, too; not after a lesson, whose eyes know the user's own
        photographs."""
        self._outputs = ("gates", "slots", "whole", *(("readings", "boxes") if attributes.names else ()))
        self._seen: deque[tuple[Image, Sight]] = deque(maxlen=_KEPT)

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> EyesModel:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, EYES, threads=threads, optimise=True, former=FORMER_EYES)
        attributes = attributes_of(table, str(path)) if table.get("facets") else AttributeSchema(())
        image = {"image": ("tensor(uint8)", (IMAGE_SIZE, IMAGE_SIZE, 3))}
        width = count_of(table, "width", str(path))
        shapes: dict[str, tuple[int, ...]] = {"gates": (3, 4), "slots": (3, width + FEATURES), "whole": (width,)}
        if attributes.names:
            shapes |= {"readings": (4, len(attributes.names)), "boxes": (4, 4)}
        check_graph(session, image, {name: ("tensor(float)", shape) for name, shape in shapes.items()}, str(path))
        return cls(session, attributes, width, classifier=table.get("classifier") is True)

    @classmethod
    def of(cls, path: Path, *, threads: int = 1) -> EyesModel:
        """As `load`, one for policy and reasoner."""
        return shared(cls.load, path, threads=threads)

    def see(self, images: NDArray[np.uint8]) -> Sight:
        """Of frames (n, 256, 256, 3). A frame that was seen a moment ago is not looked at again.

        Raises `PolicyError` for other shapes or types, and `ModelError` where an answer is not a number.
        """
        if images.dtype != np.uint8 or images.shape[1:] != (IMAGE_SIZE, IMAGE_SIZE, 3):
            raise PolicyError(
                f"the small model needs images of uint8 (n, 256, 256, 3), not {images.dtype} {images.shape}"
            )
        if len(images) != 1:
            return self._look(images)
        for image, sight in tuple(self._seen):
            if np.array_equal(image, images[0]):
                return sight
        sight = self._look(images)
        self._seen.append((images[0].copy(), sight))
        return sight

    def _look(self, images: NDArray[np.uint8]) -> Sight:
        return Sight(*numbers_of(self._session, self._outputs, {"image": images}, "the eyes"))


def attributes_of(table: Mapping[str, Any], where: str) -> AttributeSchema:
    """The attribute values that a description names; raises `ModelError`."""
    names = field_of(table, "facets", list, where)
    if not names or not all(isinstance(name, str) and "/" in name for name in names):
        raise ModelError(f"the attributes (facets) in {where} must have the form group/value")
    return AttributeSchema(tuple(names))
