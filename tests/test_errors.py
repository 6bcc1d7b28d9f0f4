"""The line that installs a missing extra, for every way in which the package can have been installed."""

import copy
import json
import shlex
import sys
from importlib import metadata

import pytest
from packaging.requirements import Requirement

from cognitivedrone.errors import MissingExtra, PolicyRaised, ReasonerError, RunError, import_extra, install_command

COMMIT = "0123456789abcdef0123456789abcdef01234567"
EDITABLE = {"url": "file:///home/me/my%20drones", "dir_info": {"editable": True}}
WHEEL = {"url": "file:///tmp/cognitivedrone-0.1-py3-none-any.whl", "archive_info": {}}
REPOSITORY = {"url": "https://example.org/drone.git", "vcs_info": {"vcs": "git", "commit_id": COMMIT}}


def test_a_reasoners_error_survives_the_way_between_processes():
    error = copy.copy(ReasonerError("unsure", "no", "trace", certainty=0.5))
    assert (str(error), error.kind, error.trace, error.certainty) == ("no", "unsure", "trace", 0.5)


def test_a_message_of_others_is_shown_without_what_no_file_and_no_terminal_takes():
    output = [
        PolicyRaised("a\ud800b", "line 1\n\tline\udcff 2"),
        ReasonerError("raised", "a\ud800b", "line 1\n\tline\udcff 2"),
    ]
    for error in output:
        assert (str(error), error.trace) == ("a\\ud800b", "line 1\n\tline\\udcff 2")
    assert str(RunError("\x1b[31mred\nand more", 3)) == str(("\\x1b[31mred\nand more", 3))


@pytest.mark.parametrize(
    ("origin", "arguments"),
    [
        (EDITABLE, ["-e", "/home/me/my drones[vlm]"]),
        ({"url": "file:///srv/drone", "dir_info": {}}, ["cognitivedrone[vlm] @ file:///srv/drone"]),
        (WHEEL, ["cognitivedrone[vlm] @ file:///tmp/cognitivedrone-0.1-py3-none-any.whl"]),
        (REPOSITORY, [f"cognitivedrone[vlm] @ git+https://example.org/drone.git@{COMMIT}"]),
        (None, ["cognitivedrone[vlm]"]),
    ],
    ids=["checkout", "folder", "wheel", "repository", "index"],
)
@pytest.mark.parametrize("installer", ["pip", "uv"])
def test_a_missing_extra_comes_from_where_the_package_came_from(monkeypatch, origin, arguments, installer):
    files = {"direct_url.json": origin and json.dumps(origin), "INSTALLER": f"{installer}\n"}
    monkeypatch.setattr(metadata.PathDistribution, "read_text", lambda self, name: files.get(name))
    by = {"pip": [sys.executable, "-m", "pip", "install"], "uv": ["uv", "pip", "install", "--python", sys.executable]}
    assert shlex.split(install_command("vlm")) == [*by[installer], *arguments]
    if "-e" not in arguments:
        assert Requirement(arguments[-1]).extras == {"vlm"}


def test_sources_that_were_never_installed_name_the_package(monkeypatch):
    def absent(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", absent)
    assert install_command("ros").endswith("-m pip install 'cognitivedrone[ros]'")


def test_the_message_of_a_missing_extra_ends_with_that_line():
    assert str(MissingExtra("httpx", "vlm")) == (
        f"httpx is not installed; it comes with cognitivedrone[vlm]: {install_command('vlm')}"
    )


def test_a_missing_module_names_the_package_and_the_extra_that_brings_it() -> None:
    with pytest.raises(MissingExtra, match=r"^no_such_module is not installed; it comes with cognitivedrone\[ros\]"):
        import_extra("no_such_module.part", "ros")
    with pytest.raises(MissingExtra, match=r"^its-package is not installed; it comes with cognitivedrone\[ros\]"):
        import_extra("no_such_module", "ros", "its-package")
    assert import_extra("json", "ros") is json
