"""The script in docs/gazebo.md: it compiles, and all that it takes from the package is there."""

from __future__ import annotations

import ast
import importlib
import re
import textwrap
from pathlib import Path

import pytest

from cognitivedrone.cli import main

PAGE = Path(__file__).parents[3] / "docs" / "gazebo.md"


def test_the_script_of_the_page_compiles_and_finds_what_it_imports():
    pytest.importorskip("pymavlink")
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    tree = ast.parse(textwrap.dedent(block))
    compile(tree, PAGE, "exec")
    taken = [
        (node.module, name.name) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for name in node.names
    ]
    assert len(taken) > 8
    for module, name in taken:
        assert hasattr(importlib.import_module(module), name), f"{module} has no {name}"


def test_the_export_command_of_the_page_works(tmp_path, capsys):
    (command,) = re.findall(
        r"cognitivedrone (gazebo export --suite \S+ --task \S+) --out", PAGE.read_text(encoding="utf-8")
    )
    main([*command.split(), "--out", str(tmp_path / "w")])
    assert "world.sdf" in capsys.readouterr().out
