"""Files about the project itself: they agree with the package and have the form that tools and hosts read."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import cognitivedrone

ROOT = Path(__file__).resolve().parents[2]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_citation_names_this_version_and_licence():
    fields = dict(re.findall(r"^([a-z-]+): *(.*)$", text("CITATION.cff"), flags=re.MULTILINE))
    assert {"cff-version", "message", "title", "authors"} <= set(fields)  # required by the format
    assert fields["version"] == (released() or [cognitivedrone.__version__])[0]
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
    if newest := released()[:1]:  # this version is the newest released one, or on the way to the next
        number, dev, _ = cognitivedrone.__version__.partition(".dev0")
        assert (number == newest[0]) if not dev else (numbers(number) > numbers(newest[0]))


def released():
    """The versions in the change log, newest first."""
    return re.findall(r"^## \[(\d+\.\d+\.\d+)\]", text("CHANGELOG.md"), flags=re.MULTILINE)


def numbers(version):
    return tuple(map(int, version.split(".")))


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


def test_no_clone_changes_the_ends_of_lines():
    files = ["src/cognitivedrone/labels/packs/open-v1/manifest.json", "README.md", "scripts/setup.py"]
    command = ["git", "check-attr", "text", "--", *files]
    if not (ROOT / ".git").exists():
        pytest.skip("no clone")
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert said.splitlines() == [f"{file}: text: unset" for file in files]


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


@pytest.mark.parametrize(("workflow", "check"), [("check", ".ci/run"), ("release-check", "make release-check")])
def test_a_workflow_runs_its_check_with_the_packages_that_the_readme_names(workflow, check):
    commands = re.findall(r"^      - run: (.*)$", text(f".github/workflows/{workflow}.yml"), flags=re.MULTILINE)
    assert commands[-1] == check
    wanted = re.search(r"sudo apt-get install (.+?) +#", text("README.md"))[1]
    assert commands[:-1] == [f"sudo apt-get update && sudo apt-get install --yes {wanted}"]


def test_the_workflow_has_every_python_that_the_release_check_tries():
    tried = re.search(r"^VERSIONS = \[(.+)\]$", text("scripts/release_check.py"), flags=re.MULTILINE)[1]
    given = re.findall(r"^            (3\.\d+)$", text(".github/workflows/release-check.yml"), flags=re.MULTILINE)
    assert sorted(given) == sorted(re.findall(r"3\.\d+", tried))


def requirements(extra: str) -> list[Requirement]:
    """What an extra brings, through the extras that it names."""
    project = tomllib.loads(text("pyproject.toml"))["project"]
    lines = project["optional-dependencies"][extra] if extra else project["dependencies"]
    found = []
    for needed in map(Requirement, lines):
        if needed.name == "cognitivedrone":
            found += [deeper for inner in needed.extras for deeper in requirements(inner)]
        else:
            found.append(needed)
    return found


@pytest.mark.parametrize("extra", ["", "dev", "dev-torch"])
def test_the_lock_file_has_an_allowed_version_of_everything_that_is_installed_for_tests(extra):
    lines = [line for line in text("constraints.txt").splitlines() if not line.startswith("#")]
    locked = [Requirement(line) for line in lines]
    assert not [pin for pin in locked if pin.url or not re.fullmatch(r"==[\w.+]+", str(pin.specifier))]
    for needed in requirements(extra):
        versions = [str(pin.specifier)[2:] for pin in locked if pin.name.lower() == needed.name.lower()]
        assert versions, f"{needed.name} is not locked: make lock"
        assert all(needed.specifier.contains(version) for version in versions), f"{needed}: make lock"
