"""Label references: `kind/concept@style`, the one string by which tasks name what label packs draw."""

from __future__ import annotations

from dataclasses import dataclass

from cognitivedrone.errors import LabelError


@dataclass(frozen=True, slots=True)
class Reference:
    """A label reference, taken apart."""

    kind: str
    concept: str
    style: str | None
    """None stands for the kind's first style."""

    def __str__(self) -> str:
        return f"{self.kind}/{self.concept}" + (f"@{self.style}" if self.style else "")


def parse_reference(text: str) -> Reference:
    """Take `kind/concept@style` apart; the concept may hold further slashes, the style may be left out.

    Raises `LabelError` where there is no kind, or an `@` with no style behind it.
    """
    body, at, style = text.rpartition("@") if "@" in text else (text, "", "")
    kind, slash, concept = body.partition("/")
    if not (kind and slash) or (at and not style):
        raise LabelError(f"label {text!r} is not of the form kind/concept@style, such as animal/zebra@noto")
    return Reference(kind, concept, style or None)
