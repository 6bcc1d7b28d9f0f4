"""Label references: `kind/concept@style`, the strings that connect tasks and label packs."""

from __future__ import annotations

from dataclasses import dataclass

from cognitivedrone.errors import LabelError


@dataclass(frozen=True, slots=True)
class Reference:
    """A parsed label reference."""

    kind: str
    concept: str
    style: str | None
    """None means the kind's first style."""

    def __str__(self) -> str:
        return f"{self.kind}/{self.concept}" + (f"@{self.style}" if self.style else "")


def parse_reference(text: str) -> Reference:
    """Parse `kind/concept@style`; the concept may contain further slashes, the style is optional.

    Raises `LabelError` if there is no kind, or an `@` without a style.
    """
    body, at, style = text.rpartition("@") if "@" in text else (text, "", "")
    kind, slash, concept = body.partition("/")
    if not (kind and slash) or (at and not style):
        raise LabelError(f"label {text!r} is not of the form kind/concept@style, such as animal/zebra@noto")
    return Reference(kind, concept, style or None)
