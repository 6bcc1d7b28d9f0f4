"""What several statements of a sentence hold of together: names, groups and facts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cognitivedrone.apps.understanding.lexicon import Predicate

DENIALS = frozenset({"not", "no", "without", "never", "nor", "neither"})


def says_more(fact: Predicate, named: Sequence[Predicate]) -> bool:
    """Whether a fact names what it is about: "a monkey's favourite" is no monkey."""
    return any(set(fact.words) > set(name.words) for name in named)


def close_together(words: Sequence[str], wanted: Sequence[str]) -> bool:
    """Whether the wanted words are together in a sentence."""
    places = [max(at for at, word in enumerate(words) if word == one) for one in wanted]
    return max(places) - min(places) <= 2 * len(wanted) + 3


def denied_alike(words: Sequence[str], wanted: Sequence[str]) -> bool:
    """Whether wanted words with a denial are in the same order: "an apple, not red" is not "red, not an apple"."""
    left = iter(words)
    return DENIALS.isdisjoint(wanted) or all(word in left for word in wanted)


def together(predicates: Iterable[Predicate]) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    """For which labels predicates hold together, for which clearly not, and the words that were of use.

    What contradicts an earlier one is dropped: "the monkey that eats the banana".
    """
    true: frozenset[str] | None = None
    wrong: frozenset[str] = frozenset()
    used: set[str] = set()
    for words, holds, false in predicates:
        if used.issuperset(words):
            continue
        if true is None:
            true, wrong = holds, false
        elif true & holds:
            true, wrong = true & holds, wrong | false
        else:
            continue
        used.update(words)
    return true or frozenset(), wrong - (true or frozenset()), frozenset(used)
