"""What is to be taught: the concepts of a folder of pictures, and sentences about them.

A concept is named by its file: `birds/blue-tit.jpg` and `birds/blue_tit_2.jpg` are two pictures of a "blue tit". It is
asked for by its name, by what the user's tasks say ("the gate with healthy food"), and by facts in `facts.csv`.
"""

from __future__ import annotations

import hashlib
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from cognitivedrone.errors import LabelError, TrainingError
from cognitivedrone.files import read_regular
from cognitivedrone.files.texts import folded
from cognitivedrone.labels import load_pack
from cognitivedrone.labels.folder import FolderPack
from cognitivedrone.models.words.text_encoder import NUMBER_WORDS
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.format import MAX_FILE_BYTES, read_tasks
from cognitivedrone.tasks.knowledge import Claim, own_claims
from cognitivedrone.tasks.published import task_files
from cognitivedrone.tasks.vocabulary import LETTERS, LOGOS
from cognitivedrone.training.language.fact_phrasing import AS_NOUN
from cognitivedrone.training.perception.attributes import concept_name
from cognitivedrone.types import COLORS, SHAPES, Task


@dataclass(frozen=True, slots=True)
class Statement:
    """A way to ask, and the taught pictures for which it is right and clearly wrong."""

    phrases: tuple[str, ...]
    """Noun phrases, as in "the gate with ..."."""
    sentences: tuple[str, ...]
    """Whole instructions."""
    true: tuple[str, ...]
    """Names of attribute values, as in "concept/thing:violin"."""
    false: tuple[str, ...]
    by_name: bool = False
    """Whether it asks for a concept by its name."""


FACTS_FILE = "facts.csv"


def facts_file(labels: Path) -> Path | None:
    """The table of facts in a folder of pictures, if it has one."""
    path = labels / FACTS_FILE
    return path if path.exists() or path.is_symlink() else None  # a link to nothing is a mistake, not no table


def stated(path: Path, kinds: Mapping[str, str]) -> list[Statement]:
    """What the table in `path` says of the concepts of a lesson, given with the folder of each.

    Claims that single out none of the concepts are left out. Raises `TaskError` for a bad table.
    """
    names = {f"{kind}/{name.partition(':')[2]}": name for name, kind in kinds.items()}
    return [made for claim in own_claims(path, names) if (made := _statement(claim, names)) is not None]


def _statement(claim: Claim, names: Mapping[str, str]) -> Statement | None:
    true = tuple(sorted(names[thing] for thing in claim.true if thing in names))
    false = tuple(sorted(names[thing] for thing in claim.false if thing in names))
    if not true or len(false) < 2:
        return None
    phrases = tuple(frame.format(x=phrase.text) for phrase in claim.phrases for frame in AS_NOUN.get(phrase.form, ()))
    sentences = tuple(phrase.text for phrase in claim.phrases if phrase.form == "clause")
    return Statement(phrases, sentences, true, false) if phrases or sentences else None


LARGEST_LESSON = 5_000
"""Maximum number of concepts."""
_MOST_NOTES = 6
"""Maximum number of phrases that the reasoner gets for a concept: it reads them with every panel that shows it."""
_NUMBERED = re.compile(r"(.*[^\W\d_])[\s_-]*\d+")
_NOT_LETTERS = re.compile(r"[\W_]+")
_GATE_WITH = re.compile(r"^.*\bgate (?:with|of|that has|showing) (.+?)[.!]?$", re.IGNORECASE)


@dataclass(frozen=True)
class Lesson:
    """Pictures by what they show, and how they are asked for. Nothing in it is drawn at random."""

    folder: Path
    tasks: tuple[Task, ...]
    pictures: dict[str, tuple[str, ...]]
    """Label references of the folder, by the name of the attribute value that they show."""
    kinds: dict[str, str]
    """Name of the attribute value to the folder's kind, for choosing alike wrong panels."""
    statements: tuple[Statement, ...]
    facts: int
    """Number of statements from the user's own table."""
    digest: str
    """Hash of the folder, the task files and the table."""

    @property
    def names(self) -> tuple[str, ...]:
        """All attribute values that it teaches."""
        return tuple(self.pictures)

    def new(self, known: Iterable[str]) -> tuple[str, ...]:
        """Those that are not known yet."""
        there = set(known)
        return tuple(name for name in self.pictures if name not in there)

    def sentences(self) -> tuple[str, ...]:
        """All words that it brings, as sentences."""
        return tuple(text for each in self.statements for text in (*each.phrases, *each.sentences))

    def notes(self) -> dict[str, str]:
        """Statements about the concepts beside their names, by the names of their attribute values."""
        found: dict[str, list[str]] = {}
        for statement in self.statements:
            for name in statement.true if not statement.by_name else ():
                found.setdefault(name, []).extend((*statement.phrases, *statement.sentences)[:1])
        return {name: "; ".join(texts[:_MOST_NOTES]) for name, texts in found.items()}


def read_lesson(labels: Path, tasks: Path | None = None) -> Lesson:
    """The lesson in a folder of pictures, with their `facts.csv` if any, and in a task file or folder if given.

    Tasks about pictures that the folder lacks are left out, with a warning; names that can mean two things are put in
    another. Raises `TrainingError` for fewer than two concepts or too many, or if no task is left; `LabelError` for a
    broken picture, `TaskError` for a broken task file or table.
    """
    pack = load_pack(str(labels))
    if not isinstance(pack, FolderPack):
        raise TrainingError(f"{labels}: to teach, give a folder of pictures such as my-labels/birds/robin.jpg")
    pictures, kinds = _pictures(pack)
    if not 2 <= len(pictures) <= LARGEST_LESSON:
        raise TrainingError(
            f"{labels} shows {len(pictures)} concept(s); a lesson needs 2 to {LARGEST_LESSON}, so that there is"
            " something to tell apart"
        )
    for references in pictures.values():
        for reference in references:
            pack.image(reference)  # a broken picture is found before any training
    files = [] if tasks is None else task_files(tasks, training=True)
    read = _shown(pack, tuple(task for path in files for task in read_tasks(path)))
    table = facts_file(labels)
    facts = stated(table, kinds) if table else []
    _tell_collisions(pictures)
    digest = hashlib.sha256(pack.digest.encode())
    for path in (*files, *([table] if table else [])):
        digest.update(read_regular(path, MAX_FILE_BYTES))
    statements = (*_by_name(pictures, kinds), *_by_tasks(read, pictures), *facts)
    return Lesson(labels, read, pictures, kinds, statements, len(facts), digest.hexdigest())


def attribute_of(reference: str) -> str:
    """The name of the attribute value that a picture of a user's folder shows.

    Numbers up to 20, single letters, and the logos and things that are known already keep their names.
    """
    parsed = parse_reference(reference)
    kind, concept = folded(parsed.kind), spoken(parsed.concept)
    joined = concept.replace(" ", "_")
    number = NUMBER_WORDS.get(concept, concept)
    if number.isdigit() and int(number) <= 20:
        return concept_name("number", str(int(number)))
    if concept.upper() in LETTERS:
        return concept_name("letter", concept.upper())
    if joined in LOGOS and ("logo" in kind or "brand" in kind or joined not in KIND_OF):
        return concept_name("logo", joined)
    return concept_name("thing", joined)


def spoken(concept: str) -> str:
    """A concept as one says it: without folder, number of the picture, and marks of panel models."""
    name = folded(concept.rpartition("/")[2]).removesuffix(".dae")
    name = name.removesuffix("dae") if len(name) > len("dae") + 2 else name
    numbered = _NUMBERED.fullmatch(name)
    return re.sub(r"[\s_-]+", " ", numbered[1] if numbered else name).strip()


def _pictures(pack: FolderPack) -> tuple[dict[str, tuple[str, ...]], dict[str, str]]:
    found: dict[str, list[str]] = {}
    kinds: dict[str, str] = {}
    for kind, concept, style in pack.files():
        reference = f"{kind}/{concept}@{style}" if style else f"{kind}/{concept}"
        name = attribute_of(reference)
        found.setdefault(name, []).append(reference)
        kinds.setdefault(name, kind)
    return {name: tuple(references) for name, references in found.items()}, kinds


def _by_name(pictures: dict[str, tuple[str, ...]], kinds: dict[str, str]) -> list[Statement]:
    """Every concept by its name; "the letter A" and "the 7" besides. A name of two concepts appears with its kind."""
    made = []
    shared = _shared_names(pictures)
    for name in pictures:
        kind, _, concept = name.removeprefix("concept/").partition(":")
        noun = concept.replace("_", " ")
        if kind == "thing":
            folder = _NOT_LETTERS.sub(" ", folded(kinds[name])).strip()
            plain: tuple[str, ...] = (noun, f"the {noun}", f"a {noun}")
            phrases = (f"{noun} of {folder}", f"the {noun} among {folder}") if noun in shared else plain
        else:
            phrases = (f"the {kind} {noun}",) if noun in shared else (noun, f"the {kind} {noun}")
        others = tuple(other for other in pictures if other != name)
        alike = tuple(other for other in others if kinds[other] == kinds[name])
        made.append(Statement(phrases, (), (name,), alike if len(alike) > 1 else others, by_name=True))
    return made


def _shared_names(pictures: Iterable[str]) -> frozenset[str]:
    """Names of more than one concept, such as the fruit and the brand."""
    counted = Counter(name.partition(":")[2].replace("_", " ").casefold() for name in pictures)
    return frozenset(noun for noun, count in counted.items() if count > 1)


def _tell_collisions(pictures: dict[str, tuple[str, ...]]) -> None:
    """Warn of names that can mean two things."""
    if shared := sorted(_shared_names(pictures)):
        warnings.warn(
            f"{', '.join(shared[:5])}: one name, several concepts; each is asked for with its kind, as in"
            f' "the logo {shared[0]}". Rename a file to give it a name of its own',
            stacklevel=3,
        )
    looks = sorted({*COLORS, *SHAPES} & {name.partition(":")[2] for name in pictures})
    if looks:
        warnings.warn(
            f'{", ".join(looks)}: also a look of gates, so "the {looks[0]} one" can mean either; rename the file if you'
            " can",
            stacklevel=3,
        )


def _by_tasks(tasks: tuple[Task, ...], pictures: dict[str, tuple[str, ...]]) -> list[Statement]:
    """What the tasks' own sentences hold for: their right panels; and what was never right beside them."""
    right: dict[str, Counter[str]] = {}
    wrong: dict[str, Counter[str]] = {}
    for task in tasks:
        if task.board is not None or task.target is None:
            continue
        names = [attribute_of(label) for label in task.labels]
        right.setdefault(task.instruction, Counter())[names[task.target]] += 1
        for place, name in enumerate(names):
            if place != task.target:
                wrong.setdefault(task.instruction, Counter())[name] += 1
    made: dict[tuple[str, ...], Statement] = {}
    for sentence, true in right.items():
        false = tuple(sorted(name for name in wrong[sentence] if name not in true and name in pictures))
        phrase = _GATE_WITH.match(sentence)
        holds = tuple(sorted(name for name in true if name in pictures))
        if holds and len(false) > 1:
            key = (sentence,)
            made[key] = Statement((phrase[1],) if phrase else (), key, holds, false)
    return list(made.values())


def _shown(pack: FolderPack, tasks: tuple[Task, ...]) -> tuple[Task, ...]:
    """The tasks whose pictures are all there."""
    kept, missing = [], ""
    for task in tasks:
        try:
            for label in (*task.labels, *([task.board] if task.board else [])):
                pack.image(label)
        except LabelError as error:
            missing = missing or str(error)
        else:
            kept.append(task)
    if tasks and not kept:
        raise TrainingError(f"none of the {len(tasks)} tasks can be shown with these pictures: {missing}")
    if len(kept) < len(tasks):
        warnings.warn(f"{len(tasks) - len(kept)} of {len(tasks)} tasks are left out: {missing}", stacklevel=3)
    return tuple(kept)
