"""The definition of the container's image installs what the package says that it needs, and nothing to build with."""

import ast
import fnmatch
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest

from cognitivedrone.cli import main
from cognitivedrone.remote.messages import TOKEN_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PROJECT["project"]["optional-dependencies"]


def stages() -> list[list[tuple[str, str]]]:
    """The instructions of every stage with their arguments, after what precedes the first stage."""
    text = re.sub(r"^#.*\n", "", (ROOT / "Dockerfile").read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    found: list[list[tuple[str, str]]] = [[]]
    for line in text.splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "FROM":
            found.append([])
        if word:
            found[-1].append((word, rest))
    return found


def given(stage: list[tuple[str, str]], instruction: str) -> list[str]:
    return [rest for word, rest in stage if word == instruction]


def packages(stage: list[tuple[str, str]]) -> set[str]:
    """Debian packages that a stage installs."""
    lines = re.findall(r"apt-get install ([^&]*)", " && ".join(given(stage, "RUN")))
    return {word for line in lines for word in line.split() if not word.startswith("-")}


def test_it_has_the_libraries_that_rendering_needs_and_no_tools():
    *_, final = stages()
    needed = re.search(r"GL_PACKAGES = (\[.*\])", (ROOT / "scripts" / "setup.py").read_text())[1]
    assert packages(final) == {"python3", *ast.literal_eval(needed)}
    (copied,) = given(final, "COPY")
    assert copied.startswith("--from=build /opt/cognitivedrone ")
    assert "pip uninstall --yes pip" in given(stages()[1], "RUN")[-1]


def test_its_extras_are_those_of_the_package():
    (extras,) = (text.partition("=")[2] for text in given(stages()[1], "ARG"))
    assert set(extras.split(",")) <= EXTRAS.keys()
    # PyTorch alone would make the image ten times as large.
    assert not {need for extra in extras.split(",") for need in EXTRAS[extra] if need.startswith("torch")}
    install = given(stages()[1], "RUN")[-1]
    line = re.search(r'"(/source\$\{.*\})"', install)[1]
    for value, target in (("a,b", "/source[a,b]"), ("", "/source")):
        shown = subprocess.run(["sh", "-c", f'echo "{line}"'], env={"EXTRAS": value}, capture_output=True, text=True)
        assert shown.stdout.strip() == target


def test_it_runs_the_command_as_an_ordinary_user():
    *_, final = stages()
    (entry,), (user,), (folder,) = (given(final, word) for word in ("ENTRYPOINT", "USER", "WORKDIR"))
    assert ast.literal_eval(entry)[0] in PROJECT["project"]["scripts"]
    assert user not in ("root", "0")
    made = " ".join(given(final, "RUN"))
    assert f"--create-home {user}" in made
    assert f"install -d -o {user} -g {user} {folder}" in made
    words = [word for word, _ in final]
    assert words.index("USER") > max(index for index, word in enumerate(words) if word in ("RUN", "COPY"))


def test_the_build_gets_all_that_the_package_is_built_from_and_nothing_else():
    rules = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and not line.startswith("#")]
    assert rules[0] == "*"
    sent = {rule.removeprefix("!") for rule in rules[1:]}
    project = PROJECT["project"]
    folders = {folder.split("/")[0] for folder in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]}
    assert sent == {"pyproject.toml", project["readme"], *project["license-files"], *folders}
    assert all((ROOT / name).exists() for name in sent)
    assert not any(fnmatch.fnmatch(name, rule) for name in (".venv", ".git") for rule in sent)


@pytest.mark.parametrize("page", ["docs/install.md", "Dockerfile"])
def test_the_commands_that_are_shown_exist(page, capsys):
    text = (ROOT / page).read_text().replace("\\\n", " ")
    shown = re.findall(r"docker run (.*)", text)
    assert shown
    for line in shown:
        words = shlex.split(line, comments=True)
        command, *options = words[words.index("cognitivedrone") + 1 :]
        with pytest.raises(SystemExit):
            main([command, "--help"])
        flags = {word for word in options if word.startswith("--")}
        assert flags <= set(re.findall(r"--[a-z][\w-]*", capsys.readouterr().out)), line


def test_the_page_names_the_variable_of_the_token():
    assert f"-e {TOKEN_VARIABLE} " in (ROOT / "docs" / "install.md").read_text()
