"""What a sentence asks for, and what it says that it does not mean: "not the cat", "anything but a pear", "no wait".

Everything here is about form. What the words mean is for others.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator

_SHORTENED = (
    (r"\b(do|does|did|is|are|was|were|would|should|could|must|have|has)n'?t\b", r"\1 not"),
    (r"\b(?:ca|wo)n'?t\b|\bcannot\b", "can not"),
    (r"'(?:s|re|ve|ll|d|m)\b", ""),
    (r"\bnon(?:[- ]|(?=red\b|green\b|blue\b|round\b))", "not "),
    (r"\bfly (?=(?:to|through|towards?|over|at|into)\b)", "go "),  # it is no insect
    (r"\b(?:some|any)thing (?:to eat|edible|(?:that )?(?:i|you|we|one|people) (?:can |could )?eat)\b", "food"),
    (r"\b(go|fly|head|on|over|thru|through|me) 2 (?=(?:the|teh|that|this|a|an|my)\b)", r"\1 to "),
)
_REFUSALS = re.compile(
    r"\b(?:any(?:thing|where) but|everything but|all but|any (?:gate|one) but|any(?:thing)? except|other than|"
    r"instead of|rather than|(?:stay|keep) away from|away from|(?:stay|steer|keep) clear of|except(?: for)?|leave out|"
    r"(?:avoid|skip(?:p)?|bypass|exclud|ignor|omit(?:t)?|(?<!not )forget)(?:e|ing)?|not(?! forget)|no|never|without|"
    r"neither|nor|none of|dont|hate|past|nicht|niemals|nie|kein\w*|ohne|au(?:ss|ß)er|"
    r"(?:ver)?meide|pas|jamais|sans|sauf|[eé]vite[rz]?|sin|senza|anstatt|"
    r"nunca|excepto|salvo|mai|tranne)\b"
)
_FORBIDDEN = re.compile(
    r"\b(?:(?:must|may|should|can|is|are) ?(?:not|n't|never)|cannot|never) (?:to )?be \w+|"
    r"\b(?:is|are) (?:not allowed|no go|forbidden|off limits|taboo|banned|prohibited|out of bounds)\b"
)
"""After what is refused: "dogs are forbidden"."""
_CLAUSE_ENDS = re.compile(
    r"[,.;:!?()]+|\s[-\u2013\u2014]+\s|\b(?:(?<!anything )(?<!anywhere )(?<!everything )(?<!all )(?<!any gate )"
    r"(?<!any one )but|and then|then|just|"
    r"and (?=go|fly|take|choose|pick|find|head|aim)|sondern|mais|sino)\b|"
    r"(?<!not )(?<!to )\b(?=(?:go|fly|head) (?:to|through|thru|for)\b|(?:choose|pick|take) the\b)"
)
_CORRECTIONS = re.compile(
    r"\b(?:(?:no+|oh)[ ,.!-]+wait|wait[ ,.!-]+no+|no,? sorry|i meant?(?! to\b)|scratch that|strike that|make that|"
    r"(?:or|no,?) rather|forget (?:that|it|about it)(?=\W*(?:[,.;!?]|$))|never ?mind(?=\W*(?:[,.;!?]|$))|nvm|"
    r"(?:i )?changed my mind|on second thoughts?|cancel (?:that|it)|my (?:bad|mistake)|let me rephrase(?: that)?|"
    r"no(?= ?[,!;])|(?<![^,.;:!?-] )(?:wait(?! (?:for|until|till|here|there|at|outside)\b)|sorry|actually|correction|"
    r"nope|nah|o+ps|whoops|hang on|hold on|no(?=\.| -| (?:the|an?|to|go|fly|i want)\b)))(?!\w)|(?<!\S)\*(?=[a-z])|"
    r"[,.;!?]+\s(?=[^,.;!?]*\binstead\b(?! of))",
    re.IGNORECASE,
)
_MENTIONED = re.compile(r"\s*(?:(?:want|like|need|mean|take|choose|pick)\s+)?(?:the|an?|any|one|that|this)\b")
_OF_A_THING = re.compile(
    r"\b(?:can|could|does|did|is|are|was|were|would|will|has|have|had|with|that|which|who|it|i|you|we|they|he|she|people)"
    r"(?: do)?\s+$"
)
_MOST = 8  # things denied
_BETWEEN = re.compile(r"\b(?:and|or|as well as|also)\b")


def normalised(sentence: str) -> str:
    """In lower case, without accents and short forms, with emoji as words, and without drawn-out letters."""
    named = "".join(_spelled(sign) for sign in unicodedata.normalize("NFKC", sentence))
    text = "".join(sign for sign in unicodedata.normalize("NFKD", named.casefold()) if not unicodedata.combining(sign))
    text = text.replace("\u2019", "'").replace("`", "'").replace("\u2044", "/")  # the bar of a fraction
    for pattern, shown in _SHORTENED:
        text = re.sub(pattern, shown, text)
    return re.sub(r"([a-z])\1{2,}", r"\1\1", text)


def corrects(text: str) -> bool:
    """Whether a text takes back something that it has said."""
    return _CORRECTIONS.search(text) is not None


def corrected_parts(text: str) -> list[tuple[int, str]]:
    """What is left of a text after each correction ("no wait", "I mean"), the last correction first, and where it
    begins; at least the text itself.
    """
    found = [*_CORRECTIONS.finditer(text)]
    begins, ends = [0, *(each.end() for each in found)], [*(each.start() for each in found), len(text)]
    parts = [(begin, text[begin:end]) for begin, end in zip(begins, ends, strict=True)]
    return [(begin, part) for begin, part in reversed(parts) if part.strip(" ,.!?-")] or [(0, text)]


def wanted_and_refused(text: str) -> tuple[str, str]:
    """The clauses of a normalised text that ask for something, and what the others refuse, each joined."""
    wanted, refused = zip(*_clauses(text), strict=True)
    return " , ".join(filter(str.strip, wanted)), " , ".join(filter(str.strip, refused))


def things_denied(sentence: str) -> tuple[str, tuple[str, ...]]:
    """What a sentence asks for, and what it names only to say that it is not meant; as typed, and nothing, of others.

    "No pizza, and not the koala, the horse" is ("the horse", ("pizza", "the koala")). What a thing is not or does not
    tells of the thing that is meant: "the bird that cannot fly".
    """
    wanted, refused = zip(*_clauses(normalised(sentence), things=True), strict=True)
    phrases = (phrase for clause in refused for phrase in _BETWEEN.split(clause))
    parts = (part.strip() for phrase in phrases for part in _REFUSALS.split(phrase))
    denied = tuple(filter(None, parts))[:_MOST]
    return (", ".join(filter(None, map(str.strip, wanted))), denied) if denied else (sentence, ())


def _clauses(text: str, *, things: bool = False) -> Iterator[tuple[str, str]]:
    """What every clause of a normalised text asks for and refuses; of `things`, not what they are not or do not."""
    for clause in _CLAUSE_ENDS.split(text):
        if forbidden := _FORBIDDEN.search(clause):
            clause = f"not {clause[: forbidden.start()]}"
        refusals = _REFUSALS.finditer(clause)
        if things:
            refusals = (
                each
                for each in refusals
                if each[0] != "past"  # on the way to something
                and (_MENTIONED.match(clause, each.end()) or not _OF_A_THING.search(clause[: each.start()]))
            )
        refusal = next(refusals, None)
        yield (clause[: refusal.start()], clause[refusal.end() :]) if refusal else (clause, "")


def _spelled(sign: str) -> str:
    """An emoji by its name, anything else as it is."""
    return f" {unicodedata.name(sign, '').lower()} " if unicodedata.category(sign) == "So" else sign
