"""The prompt and the answer schema of both VLM reasoners."""

from __future__ import annotations

import errno
import itertools
import json
from importlib import resources
from pathlib import Path
from typing import Any

from cognitivedrone.errors import PluginError, ReasonerError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.files.texts import decoded
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import COLORS, SHAPES, SIZES

PLACEHOLDER = "{instruction}"
"""Placeholder of the instruction in a prompt. Other braces are plain text, so JSON examples need no escapes."""
UNKNOWN = "unknown"
"""The color of an answer that cannot tell the gate."""
MAX_INSTRUCTION = 1000
"""Maximum length in characters, as in task files."""
MAX_PROMPT_BYTES = 20_000
MAX_TOKENS = 40
"""Maximum length of an answer; those of the schema have about 20 tokens."""
THINKING_TOKENS = 4096
"""Maximum length of an answer with the thinking before it."""
MOST_TOKENS = 32_768
AGAIN = (
    "That answer could not be read. Answer in English, with one JSON object alone that has one value each for size"
    " (big, small), color (red, green, blue, unknown) and shape (round, square, triangle)."
)
"""Asks again after an answer that names no gate, such as one in another language."""

ANSWER_SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "size": {"type": "string", "enum": list(SIZES)},
        "color": {"type": "string", "enum": [*COLORS, UNKNOWN]},
        "shape": {"type": "string", "enum": list(SHAPES)},
    },
    "required": ["size", "color", "shape"],
    "additionalProperties": False,
}
"""JSON schema of the answer."""


def answers() -> list[str]:
    """Every answer of the schema."""
    parts = [properties["enum"] for properties in ANSWER_SCHEMA["properties"].values()]
    return [json.dumps(dict(zip(ANSWER_SCHEMA["properties"], each, strict=True))) for each in itertools.product(*parts)]


def constant_part(template: str) -> str:
    """The paragraphs of a prompt before the one with the instruction: the same for every question."""
    before = template.lstrip().partition(PLACEHOLDER)[0]
    return before[: before.rfind("\n\n") + 2] if "\n\n" in before else ""


def checked_tokens(reasoner: str, tokens: int) -> int:
    """The maximum length of an answer; raises `PluginError` if it is out of range."""
    if not 1 <= tokens <= MOST_TOKENS:
        raise PluginError(f"reasoner {reasoner!r}: tokens={tokens}; it must be from 1 to {MOST_TOKENS}")
    return tokens


def load_prompt(path: Path | None = None) -> str:
    """The prompt's text: the package's, or a user's file, which must contain `{instruction}`.

    Raises `PluginError` if the file cannot be read, is too long, or lacks the placeholder.
    """
    if path is None:
        return (resources.files("cognitivedrone.reasoners") / "prompts" / "gate.txt").read_text(encoding="utf-8")
    try:
        text = decoded(read_regular(path, MAX_PROMPT_BYTES))
    except OSError as error:
        way_out = "; a longer prompt is too slow" if error.errno == errno.EFBIG else ""
        raise PluginError(f"prompt file {path}: {reason_of(error)}{way_out}") from None
    except ValueError as error:
        raise PluginError(f"prompt file {path} cannot be read: {error}") from None
    if PLACEHOLDER not in text:
        raise PluginError(f"prompt file {path} lacks {PLACEHOLDER}; write it where the instruction belongs")
    return text


def load_extra(path: Path | None) -> dict[str, Any]:
    """Fields of a JSON file for every request. Raises `PluginError` if it cannot be read or holds anything else."""
    if path is None:
        return {}
    try:
        found = parse_json(decoded(read_regular(path, MAX_PROMPT_BYTES)))
    except (OSError, ValueError) as error:
        raise PluginError(f"extra file {path} cannot be read: {error}") from None
    if not isinstance(found, dict):
        raise PluginError(f'extra file {path} holds no object; write one such as {{"top_p": 0.9}}')
    return found


def write_prompt(template: str, instruction: str) -> str:
    """The template with every `{instruction}` replaced by the instruction, on one line.

    Raises `ReasonerError` if the instruction is empty or too long.
    """
    line = " ".join(instruction.split())
    if not line:
        raise ReasonerError("unsure", "the instruction is empty; there is nothing to look for")
    if len(line) > MAX_INSTRUCTION:
        raise ReasonerError(
            "too_long", f"the instruction has {len(line)} characters; shorten it to {MAX_INSTRUCTION} at most"
        )
    return template.replace(PLACEHOLDER, line).strip()
