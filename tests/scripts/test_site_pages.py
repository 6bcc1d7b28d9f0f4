"""The site: every page is reached, every link leads somewhere, and it builds without a warning."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from cognitivedrone.cli import TARGETS
from cognitivedrone.tasks import FAMILIES

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def load(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


site_pages, gallery = load("site_pages"), load("gallery")
OUTSIDE = site_pages.outside()
WRITTEN = {path.relative_to(DOCS).as_posix(): path.read_text() for path in DOCS.rglob("*.md")}
MADE = {at: site_pages.page_of(ROOT / source) for source, at in OUTSIDE.items()}
GENERATED = {f"reference/python/{name}.md" for name in site_pages.PYTHON} | {"reference/commands.md"}


def test_the_navigation_has_every_page_once():
    nav = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    named = re.findall(r": (\S+\.md)$", nav, flags=re.MULTILINE)
    assert len(named) == len(set(named))
    assert {*named} == {*WRITTEN, *MADE, *GENERATED}


@pytest.mark.parametrize("page", [*WRITTEN, *(page for page, text in MADE.items() if "](" in text)])
def test_every_link_leads_to_a_page_of_the_site(page):
    text = {**WRITTEN, **MADE}[page]
    for link, _ in re.findall(r"\]\(([^)\s#:]+)(#[^)\s]*)?\)", site_pages.relinked(text, page)):
        target = os.path.normpath(Path(page).parent / link)
        assert target in {*WRITTEN, *MADE, *GENERATED} or (DOCS / target).is_file(), f"{page}: {link}"


@pytest.mark.parametrize(
    ("page", "text", "shown"),
    [
        ("tutorials/extend.md", "[t](../suites.md#x)", "[t](../suites.md#x)"),
        ("own_policy.md", "[e](../examples/own_policy.py)", "[e](examples/own_policy.md)"),
        (
            "project/changelog.md",
            "![p](docs/images/a.webp) [d](docs/data.md#time-and-size)",
            "![p](../images/a.webp) [d](../data.md#time-and-size)",
        ),
        ("project/contributing.md", "[a](docs/architecture.md)", "[a](../architecture.md)"),
        ("data.md", "```\n[x](../examples/own_policy.py)\n```", "```\n[x](../examples/own_policy.py)\n```"),
        ("data.md", "[far](https://arxiv.org/abs/2503.01378) [here](#top)", None),
    ],
)
def test_links_to_files_outside_docs_lead_to_their_pages(page, text, shown):
    assert site_pages.relinked(text, page) == (shown or text)


def test_the_reference_names_modules_that_are_there():
    for module in (module for modules in site_pages.PYTHON.values() for module in modules):
        assert importlib.util.find_spec(f"cognitivedrone.{module}"), module


def test_the_reference_has_the_help_of_every_command():
    page = site_pages.commands_page()
    assert re.findall(r"^## cognitivedrone (.+)$", page, flags=re.MULTILINE) == list(TARGETS)
    assert page.count("--help") >= len(TARGETS)
    assert max(map(len, page.splitlines())) <= 100


def test_the_gallery_shows_every_family():
    page = WRITTEN["suites.md"]
    shown = re.findall(r"!\[[^]]*\]\(images/gallery/(\w+)\.webp\)", page)
    assert sorted(shown) == sorted(FAMILIES) == sorted(gallery.TASKS)
    files = sorted((DOCS / "images" / "gallery").iterdir())
    assert [file.stem for file in files] == sorted(FAMILIES)
    assert sum(file.stat().st_size for file in files) < 600_000
    for file in files:
        with Image.open(file) as picture:
            assert picture.width == 548, file


@pytest.mark.slow  # .ci/run builds it, too
def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("material", reason="mkdocs-material is in the extra docs")
    pytest.importorskip("mkdocstrings", reason="mkdocstrings is in the extra docs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert 'id="cognitivedrone.interfaces.Policy.act"' in (tmp_path / "reference/python/interfaces.html").read_text()
    for page in tmp_path.rglob("*.html"):  # it is complete: nothing is loaded from elsewhere
        assert not re.findall(r'<(?:script|img|iframe)[^>]* src="?https?:', page.read_text()), page
        assert not re.findall(r'<link[^>]* rel="?(?:stylesheet|preconnect)[^>]* href="?https?:', page.read_text()), page
