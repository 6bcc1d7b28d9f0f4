import shutil
import subprocess

import pytest

from cognitivedrone import checkout

GIT = ("git", "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A checkout that holds a copy of the module, and the module made to believe that it is that copy."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"):
        monkeypatch.delenv(name, raising=False)
    file = tmp_path / "checkout.py"
    file.write_text("content\n")
    monkeypatch.setattr(checkout, "__file__", str(file))
    checkout.commit.cache_clear()
    yield tmp_path
    checkout.commit.cache_clear()


def git(folder, *words):
    return subprocess.run([*GIT, "-C", folder, *words], check=True, capture_output=True, text=True).stdout.strip()


def test_a_checkout_tells_its_commit_and_whether_it_was_changed(repository):
    assert checkout.commit() is None  # no repository yet
    git(repository, "init", "-q")
    checkout.commit.cache_clear()
    assert checkout.commit() is None  # installed inside somebody else's repository
    git(repository, "add", "checkout.py")
    git(repository, "commit", "-qm", "x")
    git(repository, "tag", "-am", "v1", "v1")
    checkout.commit.cache_clear()
    head = git(repository, "rev-parse", "HEAD")
    assert checkout.commit() == head
    (repository / "checkout.py").write_text("changed\n")
    checkout.commit.cache_clear()
    assert checkout.commit() == f"{head}-dirty"


def test_without_git_no_commit_is_known(repository, monkeypatch):
    monkeypatch.setenv("PATH", str(repository))
    assert checkout.commit() is None
