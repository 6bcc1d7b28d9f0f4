"""Words of a sentence, and the numbers that words name."""

from __future__ import annotations

import re
import unicodedata

_POSSESSIVE = re.compile(r"(?<=[a-z])'s\b")
_TOKEN = re.compile(r"[0-9]+|[a-z]+|[^\sa-z0-9]")
_ONES = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen"
    " eighteen nineteen twenty"
)
_TENS = "thirty forty fifty sixty seventy eighty ninety hundred"
NUMBER_WORDS: dict[str, str] = {
    **{word: str(number) for number, word in enumerate(_ONES.split())},
    **{word: str(10 * ten) for ten, word in enumerate(_TENS.split(), start=3)},
}


def words_of(text: str) -> list[str]:
    """The words of a sentence: runs of letters in lower case without accents, runs of digits, every other sign alone.

    The possessive 's is dropped: "McDonald's" is read as "mcdonald".
    """
    text = text.lower()
    if not text.isascii():
        folded = unicodedata.normalize("NFKD", text.replace("\u2019", "'"))
        text = "".join(sign for sign in folded if not unicodedata.combining(sign)).lower()
    return _TOKEN.findall(_POSSESSIVE.sub("", text) if "'" in text else text)
