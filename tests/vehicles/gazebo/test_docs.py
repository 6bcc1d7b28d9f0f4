"""The commands of docs/gazebo.md, as far as they go on a machine without Gazebo."""

import re
import shlex
from pathlib import Path

import pytest

from cognitivedrone.cli import main

PAGE = (Path(__file__).parents[3] / "docs" / "gazebo.md").read_text(encoding="utf-8")
COMMANDS = [
    shlex.split(line.replace("\\\n", " "))[1:]
    for block in re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    for line in re.findall(r"^ *(cognitivedrone (?:[^\n]|(?<=\\)\n)*)", block, flags=re.MULTILINE)
]


def command(*start: str) -> list[str]:
    """The one command of the page that starts like this."""
    (found,) = [words for words in COMMANDS if tuple(words[: len(start)]) == start]
    return found


def test_the_export_command_of_the_page_works(tmp_path, capsys):
    words = command("gazebo", "export")
    main([*words[: words.index("--out")], "--out", str(tmp_path / "w")])
    assert "world.sdf" in capsys.readouterr().out


@pytest.mark.parametrize("start", [("bench", "--link", "gazebo"), ("fly",)])
def test_the_other_commands_are_understood_and_say_what_is_missing(start, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SystemExit, match=r"^2$"):
        main(command(*start))
    assert "Python bindings are not installed" in capsys.readouterr().err
