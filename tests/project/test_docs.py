"""The commands that the pages of docs/ tell people to type: each exists and takes the flags that it is given."""

import contextlib
import io
import json
import re
import shlex
from functools import lru_cache
from pathlib import Path

import pytest

from cognitivedrone.cli import main
from cognitivedrone.errors import TaskError
from cognitivedrone.tasks.format import task_from_json

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def commands(page: Path) -> list[list[str]]:
    """Words after `cognitivedrone`, of every command line of a page's code blocks and of its text."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^ *```(\w*)[^\n]*\n(.*?)^ *```", text, flags=re.DOTALL | re.MULTILINE)
    typed = [block for language, block in blocks if language in ("", "sh", "bash")]
    lines = [line for block in typed for line in block.replace("\\\n", " ").splitlines() if "cognitivedrone " in line]
    lines += [line.replace("\n", " ") for line in re.findall(r"`(cognitivedrone [^`]+)`", text)]
    found = []
    for line in lines:
        words = shlex.split(line, comments=True)
        while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
            words = words[1:]
        if words and words[0] == "cognitivedrone":
            found.append(words[1:])
    return found


@lru_cache
def help_of(*names: str) -> str:
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown), pytest.raises(SystemExit) as stop:
        main([*names, "--help"])
    assert stop.value.code in (0, None), names
    return shown.getvalue()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_flag_of_every_command_exists(page):
    for words in commands(page):
        names = words[:2] if words[0] in ("data", "gazebo", "hub") else words[:1]
        known = set(re.findall(r"--[a-z][\w-]*", help_of(*names)))
        flags = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert flags <= known, f"{page.name}: {shlex.join(words)}: no {sorted(flags - known)}"


@pytest.mark.parametrize("page", [*PAGES, *ROOT.glob("*.md")], ids=lambda page: page.stem)
def test_every_script_and_page_that_is_named_exists(page):
    text = page.read_text(encoding="utf-8")
    linked = [(page.parent / link).resolve() for link in re.findall(r"\]\(([\w./-]+)(?:#[\w-]*)?\)", text)]
    scripts = {
        ROOT / script
        for script in re.findall(r"(?<![\w/-])((?:benchmarks|scripts|examples|tests)/[\w/-]+\.(?:py|md))\b", text)
    }
    missing = [str(path) for path in (*linked, *scripts) if not path.exists()]
    assert not missing


def test_the_page_of_tasks_names_every_key_that_a_task_file_needs():
    page = (ROOT / "docs" / "suites.md").read_text(encoding="utf-8")
    example = json.loads(re.search(r"```json\n(.*?)```", page, flags=re.DOTALL).group(1))
    output = set(
        re.findall(
            r"`(\w+)`", re.search(r"Required keys are (.*?), and `category` where", page, flags=re.DOTALL).group(1)
        )
    )
    needed = set()
    for key in example:
        try:
            task_from_json({k: v for k, v in example.items() if k != key}, where="example", kind="mine")
        except TaskError:
            needed.add(key)
    assert needed - {"category"} == output
