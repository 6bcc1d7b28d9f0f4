"""Files about the project itself: they agree with the package and have the form that tools and hosts read."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import cognitivedrone

ROOT = Path(__file__).resolve().parents[1]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_citation_names_this_version_and_licence():
    fields = dict(re.findall(r"^([a-z-]+): *(.*)$", text("CITATION.cff"), flags=re.MULTILINE))
    assert {"cff-version", "message", "title", "authors"} <= set(fields)  # required by the format
    assert fields["version"] == cognitivedrone.__version__.partition(".dev")[0]
    assert fields["license"] == tomllib.loads(text("pyproject.toml"))["project"]["license"]


def test_the_change_log_has_the_form_of_keep_a_changelog():
    headings = re.findall(r"^(##+) (.+)$", text("CHANGELOG.md"), flags=re.MULTILINE)
    assert headings[0] == ("##", "[Unreleased]")
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    for level, title in headings[1:]:
        if level == "##":
            assert re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d{2}-\d{2}", title)
        else:
            assert level == "###"
            assert title in kinds
    released = [title.split("]")[0][1:] for level, title in headings[1:] if level == "##"]
    assert cognitivedrone.__version__ in released or not released


@pytest.mark.parametrize(
    "template", sorted((ROOT / ".github" / "ISSUE_TEMPLATE").iterdir()), ids=lambda path: path.stem
)
def test_an_issue_template_has_its_front_matter_and_asks_for_the_version(template):
    _, front, body = template.read_text().split("---\n", 2)
    assert {line.partition(":")[0] for line in front.splitlines()} >= {"name", "about", "labels"}
    assert body.strip()
    assert "cognitivedrone --version" in body or template.stem == "feature"


def test_every_target_of_make_that_is_named_exists():
    targets = set(re.findall(r"^([\w-]+):", text("Makefile"), flags=re.MULTILINE))
    named = set(re.findall(r"(?:^|`)make ([\w-]+)", text("CONTRIBUTING.md"), flags=re.MULTILINE))
    assert named
    assert named <= targets


WORKFLOWS = sorted((ROOT / ".github" / "workflows").iterdir())


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_may_only_read_and_names_its_actions_by_commit(workflow):
    content = workflow.read_text()
    assert re.search(r"^permissions:\n  contents: read\n\n", content, flags=re.MULTILINE)
    assert "write" not in content
    assert "secrets" not in content
    assert "pull_request_target" not in content
    used = re.findall(r"uses: (\S+)(.*)", content)
    assert used
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", action) for action, _ in used)
    assert all(re.fullmatch(r" # v\d+\.\d+\.\d+", version) for _, version in used)


def test_the_workflow_runs_the_one_check_with_the_packages_that_the_readme_names():
    commands = re.findall(
        r"^      - run: (.*)$", (ROOT / ".github/workflows/check.yml").read_text(), flags=re.MULTILINE
    )
    assert commands[-1] == ".ci/run"
    wanted = re.search(r"sudo apt-get install (.+?) +#", text("README.md"))[1]
    assert commands[:-1] == [f"sudo apt-get update && sudo apt-get install --yes {wanted}"]


def test_the_workflow_has_every_python_that_the_check_tries():
    tried = re.search(r"^for version in (.+); do$", text(".ci/run"), flags=re.MULTILINE)[1].split()
    given = re.findall(r"^            (3\.\d+)$", text(".github/workflows/check.yml"), flags=re.MULTILINE)
    assert sorted(given) == sorted(tried)
