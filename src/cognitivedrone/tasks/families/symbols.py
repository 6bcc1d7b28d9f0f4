"""Symbol understanding: letters, numbers, logos and animals by name."""

from __future__ import annotations

from cognitivedrone.tasks import vocabulary, wording
from cognitivedrone.tasks.generate import Draw, Panel, Puzzle, article, words

_LOGO_NAMES = {
    "github": "GitHub",
    "javascript": "JavaScript",
    "typescript": "TypeScript",
    "php": "PHP",
    "vue": "Vue",
    "nodejs": "Node.js",
    "youtube": "YouTube",
    "whatsapp": "WhatsApp",
    "bmw": "BMW",
    "mcdonalds": "McDonald's",
    "paypal": "PayPal",
    "tiktok": "TikTok",
    "nvidia": "NVIDIA",
    "raspberry_pi": "Raspberry Pi",
    "vlc": "VLC",
    "playstation": "PlayStation",
    "gitlab": "GitLab",
    "mysql": "MySQL",
    "postgresql": "PostgreSQL",
    "mongodb": "MongoDB",
    "wordpress": "WordPress",
    "ebay": "eBay",
    "pytorch": "PyTorch",
    "tensorflow": "TensorFlow",
    "opencv": "OpenCV",
    "ros": "ROS",
    "arch_linux": "Arch Linux",
}
"""Logos whose name is not simply capitalised."""

RIVALS: dict[str, frozenset[str]] = {
    name: frozenset().union(*(g for g in vocabulary.LOOKALIKES if name in g)) for name in vocabulary.ANIMALS
}
"""Animals that are easily confused with an animal, including itself if there are any."""


def logo_name(logo: str) -> str:
    """A logo's name in its usual spelling."""
    return _LOGO_NAMES.get(logo, logo.capitalize())


def distinct_animals(draw: Draw, count: int, among: tuple[str, ...] = vocabulary.ANIMALS) -> list[str]:
    """Animals that are not easily confused with each other."""
    chosen: list[str] = []
    while len(chosen) < count:
        name = draw.pick(among)
        if name not in chosen and not RIVALS[name].intersection(chosen):
            chosen.append(name)
    return chosen


def letters(draw: Draw) -> Puzzle:
    """A capital letter."""
    panels = [draw.glyph("letter", letter) for letter in draw.sample(vocabulary.LETTERS, 3)]
    return _named(draw, panels, wording.LETTERS, x=panels[0].option)


def digits(draw: Draw) -> Puzzle:
    """A number from 0 to 20, in figures or in words."""
    panels = [draw.glyph("number", number) for number in draw.sample(range(21), 3)]
    word = wording.NUMBER_WORDS[int(panels[0].option)]
    return _named(draw, panels, wording.DIGITS, x=panels[0].option, word=word)


def logos(draw: Draw) -> Puzzle:
    """A brand or a technology."""
    names = draw.sample(vocabulary.LOGOS, 3)
    panels = [Panel(name, f"logo/{name}@{vocabulary.LOGO_STYLE}") for name in names]
    return _named(draw, panels, wording.LOGOS, x=logo_name(names[0]))


def animals(draw: Draw) -> Puzzle:
    """An animal."""
    panels = [draw.drawing("animal", name) for name in distinct_animals(draw, 3)]
    noun = words(panels[0].option)
    return _named(draw, panels, wording.ANIMALS, x=noun, a=article(noun))


def _named(draw: Draw, panels: list[Panel], nouns: tuple[str, ...], **fields: str) -> Puzzle:
    """A puzzle that asks for the first of the panels."""
    return draw.puzzle(draw.frame(draw.noun(nouns, **fields)), panels[0], panels[1:])
