"""The prompt and the answer schema of both VLM reasoners.

Missions planned by a language model: its prompt, the JSON schema of its answer, and how that is read.

The schema holds for every answer: unlike a reply about a gate, which is asked for twice a second, a plan is made once,
on the ground, and nothing of it is guessed.
"""

from __future__ import annotations

import errno
import itertools
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from cognitivedrone.errors import PluginError, ReasonerError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.files.texts import decoded
from cognitivedrone.reasoners.reply import answer_of, quote
from cognitivedrone.tasks.missions import LONGEST, pad_directive
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import COLORS, SHAPES, SIZES, Color, SubGoal

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


PLAN_TOKENS = 1200
"""Maximum length of an answer; that of the longest mission has about 700 tokens."""
LONGEST_PLAN = 20_000
"""Maximum length of an answer without its thinking, characters."""
LONGEST_TEXT = 300
"""Maximum length of a sub-goal's sentence, characters."""
_ANY, _NONE = "any", "none"
PLAN_AGAIN = (
    "That answer could not be read. Answer with one JSON object alone that has the list sub_goals, each with do, what,"
    " otherwise, pad and never_through."
)
"""Asks again after an answer that is no plan."""
PLAN_SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "sub_goals": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "do": {"type": "string", "enum": ["fly", "land"]},
                    "what": {"type": "string"},
                    "otherwise": {"type": "string"},
                    "pad": {"type": "string", "enum": [*COLORS, _ANY, _NONE]},
                    "never_through": {"type": "array", "items": {"type": "string", "enum": list(COLORS)}},
                },
                "required": ["do", "what", "otherwise", "pad", "never_through"],
                "additionalProperties": False,
            },
        }
    },
    "required": ["sub_goals"],
    "additionalProperties": False,
}
"""JSON schema of a plan."""
_KEYS = frozenset(PLAN_SCHEMA["properties"]["sub_goals"]["items"]["required"])


def plan_prompt() -> str:
    """The text of the prompt, with `{instruction}` for the mission."""
    return (resources.files("cognitivedrone.reasoners") / "prompts" / "mission.txt").read_text(encoding="utf-8")


def read_plan(text: str, finish_reason: str | None = None) -> tuple[SubGoal, ...]:
    """The sub-goals of a reply with the JSON of `PLAN_SCHEMA`, possibly after thinking and in a code block.

    Raises `ReasonerError` for anything else: no JSON, other keys, an empty list, more than `LONGEST` sub-goals, a
    place that there is not.
    """
    plain = answer_of(text, finish_reason, LONGEST_PLAN)
    start, end = plain.find("{"), plain.rfind("}")
    try:
        found = parse_json(plain[start : end + 1]) if start >= 0 else None
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise ReasonerError("garbage", f"the plan is not JSON: {quote(text)}")
    listed = found.get("sub_goals")
    if not isinstance(listed, list) or len(found) != 1:
        raise ReasonerError("schema", f"the plan has {', '.join(map(str, found))[:60] or 'no key'}; expected sub_goals")
    if not listed:
        raise ReasonerError("schema", "the plan is empty; there is nothing to fly")
    if len(listed) > LONGEST:
        raise ReasonerError("schema", f"the plan has {len(listed)} sub-goals; at most {LONGEST} are flown")
    return tuple(_sub_goal(entry, f"sub-goal {number} of the plan") for number, entry in enumerate(listed, 1))


def _sub_goal(entry: object, which: str) -> SubGoal:
    if not isinstance(entry, dict) or entry.keys() != _KEYS:
        raise ReasonerError("schema", f"{which} is {quote(json.dumps(entry))}; expected {', '.join(sorted(_KEYS))}")
    avoid = entry["never_through"]
    if not isinstance(avoid, list) or not all(color in COLORS for color in avoid):
        raise ReasonerError("schema", f"{which} avoids {quote(str(avoid))}; gates are {', '.join(COLORS)}")
    if entry["do"] == "land":
        return SubGoal("land", pad_directive(_pad(entry["pad"], which)))
    if entry["do"] != "fly":
        raise ReasonerError("schema", f"{which} is to {quote(str(entry['do']))}; a drone can fly and land")
    what, otherwise = _sentence(entry, "what", which), _sentence(entry, "otherwise", which)
    if not what:
        raise ReasonerError("schema", f"{which} does not say what to fly to")
    never = frozenset[str](color for color in COLORS if color in avoid)
    fly, other = (SubGoal("fly", said, avoid=never) for said in (what, otherwise))
    return SubGoal("if", what, (fly,), (other,), never) if otherwise else fly


def _pad(value: object, which: str) -> Color | None:
    if value in (_ANY, _NONE):
        return None
    known = next((color for color in COLORS if color == value), None)
    if known is None:
        raise ReasonerError("schema", f"{which} lands on {quote(str(value))}; pads are {', '.join(COLORS)}")
    return known


def _sentence(entry: Mapping[str, object], key: str, which: str) -> str:
    value = entry[key]
    text = " ".join(value.split()) if isinstance(value, str) else None
    if text is None or len(text) > LONGEST_TEXT or not text.isprintable():
        problem = f"one line of text of at most {LONGEST_TEXT} characters"
        raise ReasonerError("schema", f"{which} has {key} {quote(str(value))}; expected {problem}")
    return text
