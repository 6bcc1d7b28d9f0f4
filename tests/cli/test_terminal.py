"""What is printed is text: brackets are no markup, and nothing in data reaches the terminal as a command."""

import io
import re
from pathlib import Path

import pytest
from rich.console import ColorSystem, Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

import cognitivedrone
from cognitivedrone.terminal import console

EVIL = "[/f] [bold]x[/bold] :smile: \x1b]0;title \u202e \ud800"
SHOWN = r"[/f] [bold]x[/bold] :smile: \x1b]0;title \u202e \ud800"
SOURCES = Path(cognitivedrone.__file__).parent


@pytest.fixture
def screen() -> Console:
    made = console()
    made.file, made.width = io.StringIO(), 200
    return made


def table(text: str) -> Table:
    drawn = Table(text, title=text, caption=text)
    drawn.add_row(text)
    return drawn


@pytest.mark.parametrize(
    ("thing", "times"), [(EVIL, 1), (Text(EVIL), 1), (table(EVIL), 4), (Panel(Text(EVIL), title=Text(EVIL)), 2)]
)
def test_data_is_shown_as_it_is(screen: Console, thing: object, times: int) -> None:
    screen.print(thing)
    printed = screen.file.getvalue()
    # In a cell, an escape sequence may be cut where it is longer than what it stands for.
    assert printed.count(SHOWN[:12]) == times
    assert SHOWN in printed or times == 2
    printed.encode("utf-8")
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f]", printed)


def test_styles_of_the_program_stay(screen: Console) -> None:
    coloured = console()
    coloured.file, coloured._color_system, coloured._force_terminal = screen.file, ColorSystem.STANDARD, True
    coloured.print(Text("told\x1b[0m", style="bold"))
    assert screen.file.getvalue() == "\x1b[1mtold\\x1b[0m\x1b[0m\n"


def test_no_module_makes_a_console_of_its_own() -> None:
    made = [
        path.relative_to(SOURCES).as_posix()
        for path in SOURCES.rglob("*.py")
        if re.search(r"\bConsole\(", path.read_text(encoding="utf-8"))
    ]
    assert not made


def test_a_file_gets_plain_text_also_in_a_notebook(monkeypatch):
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    file = io.StringIO()
    console(file=file).print(Text("passed", style="bold"))
    assert file.getvalue() == "passed\n"
