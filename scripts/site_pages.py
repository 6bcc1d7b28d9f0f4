"""Pages of the site that are not in docs/: a hook of mkdocs (mkdocs.yml), which writes them at every build.

Files that pages link to from outside docs/ become pages of their own; the reference comes
from docstrings (mkdocstrings) and from `--help`. Nothing of it is committed.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import posixpath
import re
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = {
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
    "CITATION.cff": "project/citation.md",
    "Dockerfile": "project/dockerfile.md",
    "leaderboard/README.md": "project/leaderboard-files.md",
    "src/cognitivedrone/tasks/knowledge/README.md": "project/knowledge.md",
    "tests/external/README.md": "project/external-tests.md",
}
"""Files outside docs/, from the root of the repository, and their pages. Examples are added: examples/NAME."""
COLUMNS = 100
LANGUAGES = {".py": "python", ".cff": "yaml", ".yaml": "yaml", "": "dockerfile"}
PYTHON = {
    "evaluate": ("benchmark.evaluate", "benchmark.config", "benchmark.scores.results", "benchmark.scores.scoring"),
    "interfaces": ("interfaces", "types", "registry"),
    "errors": ("errors",),
    "tasks": ("tasks.suites", "tasks.format", "tasks.generate", "tasks.families", "tasks.families.pictures", "layout"),
    "labels": ("labels", "labels.folder", "labels.shipped", "labels.extended", "references"),
    "environments": ("envs.gym", "envs.vector", "envs.wrappers", "envs.options"),
    "data": ("data.store", "data.episode", "data.formats", "collect.recipe", "collect.fleet"),
    "pilots": ("policies", "reasoners", "pilot", "plan"),
    "control": ("control.loop", "control.safety", "control.latency", "vehicles", "vehicles.contract"),
    "simulator": ("sim.simulator", "sim.airframe", "sim.autopilot", "frames"),
    "training": (
        "training.trainer.training_task",
        "models.small_file",
        "models.eyes.sight",
        "models.mind",
        "models.small_vla",
    ),
}
"""Pages of the Python reference and the modules of the package on each."""
_FENCE = re.compile(r"(^ *```.*?^ *```)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(\]\()([^)\s#]+)(#[^)\s]*)?(\))")


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the pages that are not in docs/."""
    from mkdocs.structure.files import File

    pages = {page: page_of(ROOT / source) for source, page in outside().items()}
    pages |= {f"reference/python/{name}.md": python_page(name) for name in PYTHON}
    pages["reference/commands.md"] = commands_page()
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Lead links to files outside docs/ to their pages, and links of such files to where their targets are."""
    return relinked(markdown, page.file.src_uri)


def outside() -> dict[str, str]:
    """Files outside docs/ and their pages."""
    examples = sorted(path for path in (ROOT / "examples").iterdir() if path.suffix in (".py", ".ipynb", ".yaml"))
    return OUTSIDE | {f"examples/{path.name}": f"examples/{path.stem}.md" for path in examples}


def relinked(markdown: str, page: str) -> str:
    """The text of a page with its links as the site has them. Code blocks stay as they are."""
    pages = outside()
    source = {at: name for name, at in pages.items()}.get(page, f"docs/{page}")

    def lead(found: re.Match[str]) -> str:
        before, link, anchor, after = found.groups(default="")
        if ":" in link:  # to another site
            return found[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
        at = pages.get(target) or target.removeprefix("docs/")
        return f"{before}{posixpath.relpath(at, posixpath.dirname(page) or '.')}{anchor}{after}"

    parts = _FENCE.split(markdown)
    parts[::2] = [_LINK.sub(lead, part) for part in parts[::2]]
    return "".join(parts)


def page_of(path: Path) -> str:
    """A file outside docs/ as a page."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return text
    if path.suffix == ".ipynb":
        return notebook_page(json.loads(text)["cells"])
    return f"# {path.name}\n\n```{LANGUAGES[path.suffix]}\n{text}```\n"


def notebook_page(cells: list[dict[str, Any]]) -> str:
    """The cells of a notebook, each with what it printed and showed."""
    parts = []
    for cell in cells:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        parts += [output_of(each) for each in cell.get("outputs", [])]
    return "\n\n".join(parts)


def output_of(output: dict[str, Any]) -> str:
    """One output of a notebook's cell: a picture, or text."""
    data = output.get("data", {})
    if "image/png" in data:
        return f'<img alt="Output" src="data:image/png;base64,{"".join(data["image/png"].split())}">'
    text = "".join(output.get("text", "") or data.get("text/plain", ""))
    return f"```text\n{text.rstrip()}\n```"


def python_page(name: str) -> str:
    """Modules of the package; mkdocstrings fills them in."""
    modules = "\n\n".join(f"::: cognitivedrone.{module}" for module in PYTHON[name])
    return f"# {name.capitalize()}\n\n{modules}\n"


def commands_page() -> str:
    """The help of every command, in lines of `COLUMNS` characters."""
    from cognitivedrone.cli import COMMANDS, help_text

    parts = ["# Commands", f"```\n{help_text()}\n```"]
    for commands in COMMANDS.values():
        parts += [f"## cognitivedrone {name}\n\n```\n{help_of(name)}\n```" for name in commands]
    return "\n\n".join(parts)


def help_of(command: str) -> str:
    """What `cognitivedrone COMMAND --help` prints."""
    from cognitivedrone.cli import main

    shown, columns = io.StringIO(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(COLUMNS)
    try:
        with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
            main([*command.split(), "--help"])
    finally:
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns
    return "\n".join(_wrapped(line.rstrip()) for line in shown.getvalue().strip().splitlines())


def _wrapped(line: str) -> str:
    """A line in as many as it needs; those after the first are indented where it is."""
    if len(line) <= COLUMNS:
        return line
    indent = " " * 4 if line.startswith(" ") else ""
    return textwrap.fill(line, COLUMNS, subsequent_indent=indent, break_on_hyphens=False)
