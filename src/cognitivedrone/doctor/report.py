"""The examination of a policy by name, printed as it goes on."""

from __future__ import annotations

from contextlib import closing

from rich.text import Text

from cognitivedrone.doctor.examination import examine
from cognitivedrone.doctor.subject import Subject, Verdict, look_around
from cognitivedrone.policies import make_policy
from cognitivedrone.system.interrupts import watched
from cognitivedrone.terminal import console

MARKS: dict[Verdict, tuple[str, str]] = {
    "good": ("ok", "green"),
    "wrong": ("WRONG", "bold red"),
    "unknown": ("?", "dim"),
}


def examined(name: str, seed: int = 0) -> int:
    """Examine the policy of this name and print a line for each question; returns how many things are wrong.

    Raises `PolicyError` if it cannot be made or cannot fly, `RenderError` without OpenGL.
    """
    screen = console()
    wrong = 0
    with watched(), closing(make_policy(name)) as policy:
        policy.check()
        with console(stderr=True).status("looking around"):
            views = look_around(seed=seed)
        for finding in examine(Subject(policy), views):
            mark, style = MARKS[finding.verdict]
            wrong += finding.verdict == "wrong"
            screen.print(
                Text(f"{mark:<6}{finding.question:<14} ", style=style) + Text(finding.sentence, style="default")
            )
    verdict = (
        f"{wrong} thing{'s are' if wrong > 1 else ' is'} wrong with {name}"
        if wrong
        else f"nothing wrong was found with {name}"
    )
    screen.print(Text(verdict, style="bold"))
    return wrong
