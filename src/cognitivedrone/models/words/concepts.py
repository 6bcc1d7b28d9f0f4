"""What a sentence may mean, in concepts: how well every thing and class that can be seen fits the words.

The concepts are the things of the panel reader and the classes of the picture classifier, with their names and
definitions (`training/language/concepts.csv`). Contract of the graph; the batch is a dynamic axis: input `meaning`
float32 (batch, W), what a sentence means to the text encoder; output `fits` float32 (batch, T + C), the mean cosine
with name and definition of T things, then of C classes. The description holds their names, the width, and the digest
of the text encoder that read the table.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError
from cognitivedrone.models.onnx_file import beside, check_graph, count_of, field_of, numbers_of, open_model
from cognitivedrone.models.words.refusals import corrected_parts, corrects, normalised, things_denied
from cognitivedrone.models.words.text_encoder import TextEncoderModel

CONCEPTS: Final = "concepts"
CONCEPTS_FILE: Final = "concepts.onnx"
_ENGLISH = 3.1  # standard deviations: what is no English stays below
STANDS_OUT: Final = 3.5
"""Standard deviations from which a sentence means a thing."""
CLEAR: Final = 1.43
"""Standard deviations times cosine, for what a sentence means that names nothing known: "which of these has a trunk"
1.71, "what is the weather like" 1.41, "kill all humans" 1.19."""
_NEAR = 0.04  # difference in cosine at which a concept counts e times less than one that fits better
_NAMED = 0.4  # cosine from which a phrase names a concept
_LEAST = 1e-6  # likelihood that no panel falls below

Floats = NDArray[np.float32]


class ConceptsModel:
    """The table of concepts, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, things: Sequence[str], classes: Sequence[str], digest: str) -> None:
        self._session = session
        self.things = tuple(things)
        """Attribute values ("concept/thing:koala")."""
        self.classes = tuple(classes)
        """Names, in the picture classifier's order."""
        self.digest = digest

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> ConceptsModel:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, CONCEPTS, threads=threads, optimise=True)
        where = str(path)
        things, classes = (field_of(table, name, list, where) for name in ("things", "classes"))
        if not all(isinstance(name, str) for name in (*things, *classes)) or len(set(things)) < len(things):
            raise ModelError(f"the concepts in {where} contain an entry that is not a name, or one thing twice")
        check_graph(
            session,
            {"meaning": ("tensor(float)", (count_of(table, "size", where),))},
            {"fits": ("tensor(float)", (len(things) + len(classes),))},
            where,
        )
        return cls(session, things, classes, field_of(table, "digest", str, where))

    def fits(self, meaning: Floats) -> Floats:
        """(n, T + C) for the meanings (n, W) of sentences."""
        (fits,) = numbers_of(self._session, ("fits",), {"meaning": meaning}, "the table of concepts")
        found: Floats = fits
        return found


class Fits(NamedTuple):
    """How well concepts fit a sentence: cosines."""

    things: Floats
    """(T,) of the reader's things."""
    classes: Floats
    """(C,)."""

    @property
    def best(self) -> float:
        """Of the concept that fits best."""
        return float(max(self.things.max(), self.classes.max()))


class Concepts:
    """The concepts for one reader: its things in its own order, whether they stand in the table or were taught."""

    def __init__(self, model: ConceptsModel, encoder: TextEncoderModel, things: Sequence[str]) -> None:
        """`things` are attribute values. Raises `ModelError` where another text encoder read the table."""
        if model.digest != encoder.digest:
            raise ModelError(
                f"{CONCEPTS_FILE} was made with another text encoder; take both from one release, or export again"
            )
        self._model, self._encoder = model, encoder
        known = {name: place for place, name in enumerate(model.things)}
        self._places = np.array([known.get(name, 0) for name in things], np.intp)
        self._taught = [row for row, name in enumerate(things) if name not in known]
        names = [things[row].partition(":")[2].replace("_", " ") for row in self._taught]
        self._meanings = encoder.meanings(names) if names else np.zeros((0, encoder.size), np.float32)
        self._names = [*(name.partition(":")[2] for name in things), *model.classes]
        self._heard: tuple[str | None, Fits | None, tuple[Fits, ...]] = (None, None, ())

    @property
    def heard(self) -> tuple[tuple[str, float], ...]:
        """What the last sentence was taken for: the concepts that fit it best, with their cosines."""
        best: dict[str, float] = {}
        if (wanted := self._heard[1]) is not None:
            fits = np.concatenate(wanted)
            for place in np.argsort(-fits).tolist()[:6]:
                best.setdefault(self._names[place].replace("_", " "), float(fits[place]))
        return tuple(best.items())[:3]

    def hear(self, instruction: str) -> tuple[Fits | None, tuple[Fits, ...]]:
        """What fits that which a sentence asks for, and each thing that it says is not meant; none where it asks for
        nothing else that is known.
        """
        if self._heard[0] != instruction:  # flights that fork share it
            parts = corrected_parts(normalised(instruction)) if corrects(instruction) else ()
            said = next((part for _, part in parts if self.fits(part).best > _NAMED), instruction)
            wanted, denied = things_denied(said)
            asked, *others = self._fits([wanted or said, *denied])
            named = tuple(fits for fits in others if fits.best > _NAMED)
            self._heard = instruction, asked if not named or (wanted and asked.best > _NAMED) else None, named
        return self._heard[1:]

    def meant(
        self, sentence: str, least: float | None = None, among: Collection[str] | None = None
    ) -> tuple[str, tuple[str, ...]] | None:
        """The thing of the table, or of those `among`, that a sentence means, and those that it does not; none where
        none stands out by `STANDS_OUT`, or, of `least`, by so many standard deviations times its cosine.
        """
        things, _ = self.fits(sentence)
        above = (things - things.mean()) / things.std()
        others = [row for row, name in enumerate(self._names[: len(above)]) if among is not None and name not in among]
        above[self._taught + others] = above.min()
        best = above.argmax()
        if above[best] < (STANDS_OUT if least is None else _ENGLISH) or above[best] * things[best] < (least or 0.0):
            return None
        return self._names[best], tuple(self._names[row] for row in np.flatnonzero(above < np.median(above)))

    def fits(self, instruction: str) -> Fits:
        """How well the things and the classes fit a sentence."""
        return self._fits([instruction])[0]

    def _fits(self, texts: Sequence[str]) -> list[Fits]:
        meanings = self._encoder.meanings(texts)
        fits = self._model.fits(meanings)
        things = fits[:, self._places]
        things[:, self._taught] = meanings @ self._meanings.T
        return [Fits(*both) for both in zip(things, fits[:, len(self._model.things) :], strict=True)]


def evidence(shares: Floats, fits: Floats) -> Floats:
    """(n,): log sum_v p(v | panel) exp((s(v) - max s) / t), for what panels may show (n, V) and how it fits (V,)."""
    told: Floats = np.log(shares @ np.exp((fits - fits.max()) / np.float32(_NEAR)) + np.float32(_LEAST))
    return told


def concepts_of(model: Path) -> Path:
    """The table of concepts of a model's file: the one beside it, or the packaged one."""
    return beside(model, CONCEPTS_FILE)
