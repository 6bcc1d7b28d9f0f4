"""What the README tells people to type exists and runs."""

import ast
import functools
import re
import shlex
import subprocess
import sys
import time
import urllib.request
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from typed_commands import typed
from waiting import free_port

import cognitivedrone

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def shell_lines() -> list[str]:
    blocks = re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)
    return [line.split("#")[0].strip() for block in blocks for line in block.splitlines() if line.strip()]


@pytest.mark.parametrize("target", ["bench", "test"])
def test_both_commands_of_the_first_screen_are_targets_of_make(target):
    assert f"make {target}" in "\n".join(README.splitlines()[:20])
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)


def test_what_must_be_there_is_what_the_set_up_would_ask_for():
    (line,) = (line for line in shell_lines() if line.startswith("sudo apt-get install"))
    packages = re.search(r"GL_PACKAGES = (\[.*\])", (ROOT / "scripts" / "setup.py").read_text())[1]
    assert {*ast.literal_eval(packages), "python3-venv", "git", "make"} == set(line.split()[3:])


def test_no_page_installs_from_an_index():
    """No index has the package: extras come from the checkout."""
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        assert not re.search(r"pip install '?cognitivedrone", page.read_text()), page


FIRST_FLIGHT = (ROOT / "docs" / "tutorials" / "fly.md").read_text()
"""Whose test also flies as the README does, in real time."""


def test_its_commands_run(tmp_path):
    """In the README's order, in a folder of their own, few tasks each; apt-get, make and pip came before."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    bench = re.search(r'^SMOKE = "(bench .*)"', (ROOT / "scripts" / "bench.py").read_text(), flags=re.MULTILINE)
    before = ("make", "sudo", "pip", "source")
    lines = [f"cognitivedrone {bench[1]}", *(line for line in shell_lines() if not line.startswith(before))]
    assert len(lines) >= 7
    with ExitStack() as servers:
        port = free_port()
        for line in lines:
            words = shlex.split(line.replace(":8000", f":{port}"))
            environment = dict(word.split("=", 1) for word in words if "=" in word and not word.startswith("-"))
            command = [sys.executable, "-m", "cognitivedrone", *words[words.index("cognitivedrone") + 1 :]]
            few = {"bench": ["--episodes", "2", "--workers", "0"], "collect": ["--episodes", "4", "--workers", "1"]}
            command += few.get(command[3], [])
            settings = {"cwd": tmp_path, "env": {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), **environment}}
            if command[3] == "play":  # until ctrl-C
                page = free_port()
                with served([*command, "--no-browser", "--port", str(page)], settings):
                    assert b"CognitiveDrone" in opened(page)
                continue
            if line in FIRST_FLIGHT:
                continue
            if command[-1] == "&":
                servers.enter_context(served([*command[:-1], "--port", str(port)], settings))
                continue
            typed(command[3:], tmp_path, **{"HOME": str(tmp_path), **environment})
    assert (tmp_path / "view.png").exists()
    assert (tmp_path / "results" / "remote" / "report.html").exists()


@contextmanager
def served(command, settings):
    """A server in the background; the bench that follows waits for it."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **settings)
    try:
        yield
        assert process.poll() is None
    finally:
        process.terminate()
        process.wait(60)


def opened(port, seconds=120):
    """A page of a server that is starting."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as page:
                return page.read()
        except OSError:
            assert time.monotonic() < deadline
            time.sleep(0.2)


@pytest.mark.parametrize("part", ["gymnasium.make", "evaluate("])
def test_its_python_runs(part, monkeypatch):
    """As it stands, a few tasks each."""
    monkeypatch.setattr("cognitivedrone.evaluate", functools.partial(cognitivedrone.evaluate, episodes=2))
    code = next(b for b in re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL) if part in b)
    exec(code, {"__name__": "__main__"})  # noqa: S102 - ours
