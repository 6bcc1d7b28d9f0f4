"""The code of README, docs/ and the tutorials runs as it stands.

A line `<!-- not run: REASON -->` above a block leaves it out. In a tutorial, a block with a title is a file of that
name, and commands run in the page's order, in a folder of the page's own.
"""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from made_once import made_once
from published_checkout import make_checkout_with_flights
from typed_commands import typed

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
ELSEWHERE = {
    "gymnasium.md": "envs/test_gymnasium_page.py",
}
"""Pages whose Python another test runs, with what it needs."""
TUTORIALS = ("fly", "score", "train", "extend")
LONG = ("fly", "extend")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    title: str
    text: str
    not_run: str


def blocks_of(text: str) -> list[Block]:
    found = re.finditer(
        r"^(?:<!-- not run: (?P<why>.+) -->\n)? *```(?P<language>\w*)(?P<info>[^\n]*)\n(?P<text>.*?)^ *```$",
        text,
        flags=re.MULTILINE | re.DOTALL,
    )
    return [
        Block(
            block["language"],
            (re.search(r'title="([^"]+)"', block["info"]) or ["", ""])[1],
            block["text"],
            block["why"] or "",
        )
        for block in found
    ]


def python_of(page: Path) -> list[str]:
    return [b.text for b in blocks_of(page.read_text()) if b.language == "python" and not b.title and not b.not_run]


PAGES = [page for page in sorted(DOCS.glob("*.md")) if page.name not in ELSEWHERE and python_of(page)]


def run(arguments: Sequence[str], folder: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env={**os.environ, **environment}, capture_output=True,
        text=True, timeout=500, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{shlex.join(arguments)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def commands_of(block: str) -> list[tuple[dict[str, str], list[str]]]:
    """The environment and the arguments of every `cognitivedrone` line; any other line is an error."""
    found = []
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        environment = dict(word.split("=", 1) for word in words if re.match(r"[A-Z_]+=", word))
        name, *arguments = words[len(environment) :]
        assert name == "cognitivedrone", f"{line}: not a command of ours; say above the block why it is not run"
        found.append((environment, arguments))
    return found


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what pages take for granted: a run and a data set."""
    folder = tmp_path_factory.mktemp("finished")
    for command in (
        "collect --recipe debug --episodes 2 --workers 1 --out STORE",
        "bench --suite open-v1:smoke --policy oracle --episodes 1 --workers 0 --out results/smoke",
    ):
        typed(command.split(), folder)
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_python_of_a_page_runs(page, finished, monkeypatch):
    monkeypatch.chdir(finished)
    exec("\n".join(python_of(page)), {})  # noqa: S102 - ours


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in TUTORIALS])
def test_a_tutorial_works_from_top_to_bottom(name, tmp_path):
    ran = 0
    for block in blocks_of((DOCS / "tutorials" / f"{name}.md").read_text()):
        if block.title:
            (tmp_path / block.title).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / block.title).write_text(block.text)
            if block.title.startswith("src/"):  # of the package itself: that it can be imported
                run([block.title], tmp_path)
        elif block.not_run:
            continue
        elif block.language == "python":
            run(["-c", block.text], tmp_path)
        elif block.language == "sh":
            for environment, arguments in commands_of(block.text):
                path = os.pathsep.join([environment.get("PYTHONPATH", ""), os.environ.get("PYTHONPATH", "")])
                if arguments[0] == "bench":  # few flights, and no processes, which take longer to start
                    arguments += ["--episodes", "2"] * ("--episodes" in arguments) + ["--workers", "0"]
                typed(arguments, tmp_path, **{**environment, "PYTHONPATH": path})
                ran += 1
    assert ran


def test_the_page_of_the_paper_works_on_files_of_their_form(tmp_path_factory):
    """On a small checkout of the published form: every command, in the page's order."""
    folder = made_once(tmp_path_factory, "checkout", make_checkout_with_flights)
    work = tmp_path_factory.mktemp("paper")
    (work / "checkout").symlink_to(folder / "checkout", target_is_directory=True)
    ran = 0
    for block in blocks_of((DOCS / "paper.md").read_text()):
        if block.language != "sh" or block.not_run or block.text.startswith("git clone"):
            continue
        for _, arguments in commands_of(block.text):
            if arguments[0] == "bench":  # few flights, and no processes, which take longer to start
                drop = arguments.index("--episodes") if "--episodes" in arguments else len(arguments)
                arguments = [
                    *arguments[:drop],
                    *arguments[drop + 2 :],
                    *shlex.split("--episodes 1 --workers 0 --clips 0"),
                ]
            typed(arguments, work)
            ran += 1
    assert ran > 8


@pytest.mark.parametrize(("page", "test"), ELSEWHERE.items())
def test_what_is_run_elsewhere_is(page, test):
    assert f'"{page}"' in (ROOT / "tests" / test).read_text()
