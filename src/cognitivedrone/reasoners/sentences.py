"""Finds the gate that free text names: noun phrases of size, color and shape, and which of several statements counts.

A description is a run of words such as "the small blue square one" or "gate that is green and round". It describes a
gate if it contains a noun for one, or takes the place of a noun ("Go to the green triangle"). "The red hat" describes a
hat, and what follows "with", "shows" or "label" describes a panel.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

from cognitivedrone.errors import ReasonerError
from cognitivedrone.tasks.directives import parse_directive
from cognitivedrone.types import Color, Shape, Size


@dataclass(frozen=True, slots=True)
class Description:
    """The named parts of a gate; none for parts that are not named."""

    size: Size | None = None
    color: Color | None = None
    shape: Shape | None = None
    unknown_word: str | None = None
    """A color or shape that no gate has."""
    hedged: bool = False
    """Stated with doubt."""

    def adds_to(self, other: Description) -> bool:
        """Whether it does not contradict the other."""
        mine, theirs = (self.size, self.color, self.shape), (other.size, other.color, other.shape)
        agree = all(a is None or b is None or a == b for a, b in zip(mine, theirs, strict=True))
        return agree and (self.unknown_word is None or other.unknown_word in (None, self.unknown_word))

    def merged(self, other: Description) -> Description:
        """Both descriptions combined; they must not contradict each other."""
        return Description(
            self.size or other.size,
            self.color or other.color,
            self.shape or other.shape,
            self.unknown_word or other.unknown_word,
            self.hedged or other.hedged,
        )


Kind = Literal["gate", "refusal", "unsure"]


@dataclass(frozen=True, slots=True)
class _Finding:
    """The meaning of one sentence."""

    kind: Kind
    gates: tuple[Description, ...] = ()
    conclusive: bool = False
    """Says what to do, not only what is seen."""
    descriptive: bool = False


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_SHAPE_NOUNS = frozenset(("circle", "square", "box", "triangle", "ring", "rectangle"))
_MORE_WORDS: dict[str, Description] = {
    **dict.fromkeys(("box", "boxy", "squared", "squarish"), Description(shape="square")),
    **dict.fromkeys(("rounded", "circlular", "rings", "circles"), Description(shape="round")),
    **dict.fromkeys(("triangles", "triangled", "trianglular"), Description(shape="triangle")),
    "squares": Description(shape="square"),
    **dict.fromkeys(("reddish", "crimson"), Description(color="red")),
    "greenish": Description(color="green"),
    "bluish": Description(color="blue"),
}
_UNKNOWN_WORDS = _words(
    "yellow orange purple violet pink black white gray grey brown cyan magenta gold golden silver turquoise"
    " hexagon hexagonal pentagon pentagonal octagon octagonal oval ellipse elliptical star diamond heart rhombus"
    " trapezoid cross crescent"
)
_GATE_NOUNS = _words("gate gates one opening hoop frame border rim outline portal target")
_PART_NOUNS = _words("color colour shape size")
_FILLERS = _words(
    "and colored coloured shaped in that which is are it its a an the both of looking very bright dark light correct"
    " right left middle center centre first second third only final medium sized has with , ( )"
)
_ABOUT_PANEL = _words(
    "with wearing wears showing shows show shown displays displaying holding label labeled labelled panel picture image"
    " sign reads saying board hat shirt depicts depicting contains containing has having number letter"
)
_NO_NOUN = _words(
    "with on at to because since as for from under below beneath by where whose has having shows showing and or but is"
    " labeled labelled number which that , ( ) now instead please here there then directly ahead straight"
)
_CONCLUSION = re.compile(
    r"\b(so|therefore|thus|hence|answer|correct|fly|flying|go|choose|pick|select|target|final|finally|should|directive|"
    r"proceed|head|navigate|must|conclude|conclusion|means|pass|enter|move|take|aim)\b"
)
_DESCRIPTIVE = re.compile(
    r"\b(shows?|showing|displays?|has|have|contains?|depicts?|features?|there (is|are)|i (can )?see|label(l?ed)?|"
    r"reads?|on the (left|right)|in the (middle|center|centre)|sits|hangs|above)\b"
)
_REFUSES_PEOPLE = re.compile(
    r"\b(identify|recogni[sz]e|name)\b.{0,20}\b(people|persons?|individuals?|someone|faces?|anyone)\b|"
    r"facial|real people"
)
_REFUSAL = re.compile(
    r"\bi (can't|cannot|can not|won't|will not|am not able|am unable|must decline|refuse)\b|\bi'm (unable|not able)\b|"
    r"\bas an ai\b|\bagainst my\b|\bnot comfortable\b|\b(unable|able) to (help|assist|comply)\b|\b(help|assist) with\b|"
    r"\bdecline\b"
)
_APOLOGY = re.compile(r"\b(sorry|apologi[sz]e|apologies)\b")
_UNSURE = re.compile(
    r"\b(cannot|can't|can not|could not|couldn't|unable to|not able to|hard to|impossible to|difficult to) (be )?"
    r"(clearly )?(tell|determined?|decide|see|identify|identified|say|distinguish|make out|find|read|answer|know)\b|"
    r"\b(unknown|unsure|unclear|uncertain|ambiguous|none|undetermined|inconclusive|not sure|not certain|not visible|"
    r"not clear|not enough information|insufficient|no idea|no (such|matching|correct|suitable) gate|"
    r"no gate (matches|fits|has|shows|is)|(don't|do not) (know|see))\b|\bn/a\b"
)
_BUT = re.compile(r"\b(?:but|though|however|although)\b")
_NEGATED_CLAUSE = re.compile(
    r"\b(isn't|aren't|doesn't|don't|does not|do not|is not|are not|wrong|incorrect|cannot be|can't be|eliminated?|"
    r"ruled out|rule out|excluded?|never)\b"
)
_CONDITION = re.compile(r"(?:and |but |or )?(?:if|unless|whether|when)\b(?!.*\b(?:so|therefore|thus|hence)\b)")
_RETRACTION = re.compile(r"\b(?:wait|hmm+|let me (?:re-?)?(?:check|look|think|verify|see|count|examine))\b")
_NEGATED_REST = re.compile(r"\b(?:not|instead of|rather than|avoid|avoiding|ignore|unlike|except)\b[^,;]*")
_ENGLISH = _words("the is are of and with through gate fly answer it that this shows to correct go i not cannot one")
_FOREIGN = _words(
    "der das den dem und ist nicht ein eine durch zum zur tor le la les une est pas qui dans par porte vers et du des"
    " el los las una es por puerta hacia del pero il lo gli di non che porta o os um uma pelo pela het een niet poort"
    " och genom przez brama jest"
)
_SENTENCE = re.compile(r"(?<=[.!?:])\s+|[\n;]+|\.$")
_CLAUSE = re.compile(r",|\b(?:but|so|therefore|thus|hence|while|whereas|because|since)\b")


def describe(words: str) -> Description | None:
    """The gate described by a few words, such as the value of a JSON field; none if they say nothing or contradict."""
    found = Description()
    for word in re.findall(r"[a-z]+", words.lower()):
        part = _describe_word(word)
        if part is None:
            continue
        if not part.adds_to(found):
            return None
        found = found.merged(part)
    return found if found != Description() else None


def read_sentences(text: str, *, whole: bool = True) -> Description:
    """The gate that sentences conclude with.

    The last sentence that says what to do, admits that the model cannot tell, or refuses, counts. Without one, the
    other sentences count as far as they agree, but what is only seen does not if the text may not be `whole`. Raises
    `ReasonerError`.
    """
    if _is_foreign(text):
        raise ReasonerError("garbage", f"the reply is not in English: {_begin(text)}")
    sentences = _sentences(text)
    found = [finding for sentence in sentences if (finding := _read_sentence(sentence)) is not None]
    if found and _RETRACTION.search(sentences[-1]) and _read_sentence(sentences[-1]) is None:
        raise ReasonerError("unsure", f"the reply takes its answer back: {_begin(text)}")
    firm = [finding for finding in found if finding.conclusive or finding.kind != "gate"]
    plain = [finding for finding in found if not finding.descriptive]
    if not found:
        raise ReasonerError("garbage", f"the reply does not mention a gate: {_begin(text)}")
    last = firm[-1] if firm else plain[-1] if plain else found[-1]
    if firm and plain and plain[-1] is found[-1]:
        last = found[-1]
    if last.kind == "refusal":
        raise ReasonerError("refusal", f"the model refuses: {_begin(text)}")
    if last.kind == "unsure":
        raise ReasonerError("unsure", f"the model cannot tell: {_begin(text)}")
    gates = last.gates
    if not firm and not plain:
        if not whole:
            raise ReasonerError("unfinished", f"the reply ends before it says where to fly: {_begin(text)}")
        gates = _distinct([gate for finding in found for gate in finding.gates])
    elif not firm:
        gates = _distinct([gate for finding in plain for gate in finding.gates])
    if len(gates) > 1:
        raise ReasonerError("unsure", f"the reply names several gates: {_begin(text)}")
    gate = gates[0]
    if gate.unknown_word is not None:
        raise ReasonerError("no_such_gate", f"no gate is {gate.unknown_word!r}: {_begin(text)}")
    return _with_details(gate, found)


def contradicts(text: str, gate: Description) -> bool:
    """Whether the sentences after a gate was named conclude with another one, or with doubt."""
    found = [finding for sentence in _sentences(text) if (finding := _read_sentence(sentence)) is not None]
    firm = [finding for finding in found if finding.conclusive or finding.kind != "gate"]
    return bool(firm) and (firm[-1].kind != "gate" or not all(other.adds_to(gate) for other in firm[-1].gates))


def _is_foreign(text: str) -> bool:
    """Whether a text has more words of other languages, or letters of other scripts, than English ones."""
    words = re.findall(r"[^\W\d_]+", text.lower())
    foreign = sum(word in _FOREIGN or not word.isascii() for word in words)
    return foreign > sum(word in _ENGLISH for word in words)


def _with_details(gate: Description, found: list[_Finding]) -> Description:
    """A gate named by color, completed by other sentences about that color; colors are unique within a task."""
    if gate.color is None:
        return gate
    for finding in found:
        for other in finding.gates:
            if other.color == gate.color and other.unknown_word is None and other.adds_to(gate):
                gate = gate.merged(replace(other, hedged=False))
    return gate


def _sentences(text: str) -> list[str]:
    clean = re.sub(r"[*_`#\"<>|]+", " ", text.lower())
    return [part for sentence in _SENTENCE.split(clean) if (part := sentence.strip())]


def _read_sentence(sentence: str) -> _Finding | None:
    unsure = bool(_UNSURE.search(sentence))
    parts = _BUT.split(sentence)
    gates = _gates(parts[-1] if unsure else sentence)
    if _REFUSES_PEOPLE.search(sentence) and (_REFUSAL.search(sentence) or _APOLOGY.search(sentence)):
        return _Finding("refusal")
    if unsure and (len(parts) == 1 or not gates or _UNSURE.search(parts[-1])):
        return _Finding("unsure")
    if not unsure and _REFUSAL.search(sentence):
        return _Finding("refusal")
    if not gates:
        return _Finding("refusal") if _APOLOGY.search(sentence) else None
    if unsure:
        gates = tuple(replace(gate, hedged=True) for gate in gates)
    if sentence.endswith("?"):
        return None
    if _CONDITION.match(sentence):
        return _Finding("unsure")
    conclusive = bool(_CONCLUSION.search(sentence))
    # "Red gate: a cat" is a description of what is seen, as "The red gate shows a cat" is.
    descriptive = sentence.endswith(":") or bool(_DESCRIPTIVE.search(sentence))
    return _Finding("gate", gates, conclusive, not conclusive and descriptive)


def _gates(sentence: str) -> tuple[Description, ...]:
    """The distinct gates that a sentence names; with a conclusion ("..., so the green one"), only those in it."""
    clauses = _clauses(sentence)
    for index in range(len(clauses) - 1, 0, -1):
        if clauses[index].lstrip().startswith(("so ", "therefore", "thus", "hence")):
            after = _distinct(_mentions(" ".join(clauses[index:])))
            if after:
                return after
    # "The green one because the red gate shows a cat": reasons describe other gates.
    firm = [clause for clause in clauses if not clause.startswith(("because", "since", "while", "whereas"))]
    return _distinct(_mentions(" ".join(firm))) or _distinct(_mentions(" ".join(clauses)))


def _clauses(sentence: str) -> list[str]:
    """The clauses with their conjunctions, without negated ones."""
    starts = [0, *(match.start() for match in _CLAUSE.finditer(sentence)), len(sentence)]
    pieces = [sentence[a:b] for a, b in pairwise(starts)]
    kept = []
    for piece in pieces:
        if _NEGATED_CLAUSE.search(piece):
            continue
        rest = _NEGATED_REST.sub(" ", piece)
        kept.append(rest.lstrip(", ") if _CLAUSE.match(piece) and not rest.startswith(",") else rest)
    return kept


def _distinct(mentions: list[Description]) -> tuple[Description, ...]:
    """Mentions, each merged with the first that it does not contradict."""
    gates: list[Description] = []
    for mention in mentions:
        for index, gate in enumerate(gates):
            if mention.adds_to(gate):
                gates[index] = gate.merged(mention)
                break
        else:
            gates.append(mention)
    return tuple(gates)


def _mentions(text: str) -> list[Description]:
    """The descriptions of gates in a sentence, in order."""
    words = re.findall(r"[a-z]+(?:'[a-z]+)?|[,()]|\d+", text)
    mentions: list[Description] = []
    panel = False
    index = 0
    while index < len(words):
        if not _belongs(words[index]):
            panel = panel or words[index] in _ABOUT_PANEL
            panel = panel and words[index] not in (",", "(")
            index += 1
            continue
        end = index
        while end < len(words) and _belongs(words[end]):
            end += 1
        after = words[end] if end < len(words) else None
        mentions += _read_run(words[index:end], after, panel and bool(mentions), panel)
        panel = panel or any(word in _ABOUT_PANEL for word in words[index:end])
        index = end
    return mentions


def _belongs(word: str) -> bool:
    return word in _FILLERS or word in _GATE_NOUNS or word in _PART_NOUNS or _describe_word(word) is not None


def _read_run(run: list[str], after: str | None, panel_of_gate: bool, panel: bool) -> list[Description]:
    """The descriptions in a run of words that may describe a gate.

    `panel`: the run follows a word about panels; `panel_of_gate`: and a gate was named before that word.
    """
    has_noun = any(word in _GATE_NOUNS or word in _PART_NOUNS for word in run)
    if panel_of_gate and not any(word in _PART_NOUNS or word == "frame" for word in run):
        return []
    if panel and not has_noun:
        return []
    split = next((i for i, word in enumerate(run) if word in ("with", "has") and i > 0), len(run))
    rest = run[split:]
    if rest and not any(word in _PART_NOUNS or word == "frame" for word in rest):
        # "gate with the red" continues with the panel; "gate with a red frame" with the gate.
        run, after = run[:split], "with"
    found: list[Description] = []
    ends_in_noun = False
    current = Description()
    closed = False
    for word in run:
        part = _describe_word(word)
        if part is None:
            ends_in_noun = ends_in_noun or word in _GATE_NOUNS or word in _PART_NOUNS
            continue
        if not part.adds_to(current):
            found.append(current)
            current = Description()
        current = current.merged(part)
        closed = word in _SHAPE_NOUNS
    if current == Description():
        return []
    found.append(current)
    is_gate = ends_in_noun or closed or after is None or after in _NO_NOUN or after.isdigit()
    # A word after a shape that is not a noun for a gate may still belong to the panel: "the green triangle hat".
    if not ends_in_noun and after is not None and after not in _NO_NOUN and not after.isdigit():
        is_gate = closed and after in ("number", "labeled", "labelled")
    return found if is_gate else []


def _describe_word(word: str) -> Description | None:
    """The part of a gate that a word names; none if it names none."""
    if word in _UNKNOWN_WORDS:
        return Description(unknown_word=word)
    if word in _MORE_WORDS:
        return _MORE_WORDS[word]
    size, color, shape = parse_directive(word)
    return Description(size, color, shape) if size or color or shape else None


def _begin(text: str) -> str:
    line = " ".join(text.split())
    return repr(line if len(line) <= 80 else line[:77] + "...")
