"""Temporary folders: removed by their process, or by the next one where it was killed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cognitivedrone.files import temporary
from cognitivedrone.files.temporary import TemporaryFolder

MAKE = """
from cognitivedrone.files.temporary import TemporaryFolder
folder = TemporaryFolder()
print(folder.path, flush=True)
"""


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary files go; nothing was swept there yet."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    temporary._sweep.cache_clear()
    return tmp_path


def made(code: str = "", number: int = signal.SIGKILL) -> Path:
    """A folder of a process that has ended."""
    kill = f"import os; os.kill(os.getpid(), {int(number)})"
    done = subprocess.run([sys.executable, "-c", MAKE + (code or kill)], capture_output=True, text=True, check=False)
    return Path(done.stdout.strip())


def test_a_folder_goes_with_its_block_its_object_and_its_process(place: Path) -> None:
    with TemporaryFolder("kind") as folder:
        assert folder.parent == place
        assert folder.name.startswith("cognitivedrone-kind-")
        (folder / "file").write_text("text")
    one = TemporaryFolder()
    one.close()
    one.close()
    TemporaryFolder()
    assert made("pass").parent == place
    assert not [*place.iterdir()]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_what_a_killed_process_left_goes_when_the_next_one_makes_its_own(place: Path, number: int) -> None:
    left = made(number=number)
    (left / "folder").mkdir()
    assert left.is_dir()
    with TemporaryFolder() as folder:
        assert [*place.iterdir()] == [folder]


def test_folders_of_the_living_and_of_others_stay(place: Path) -> None:
    mine = place / "cognitivedrone-mine"
    mine.mkdir()
    outside = made()
    outside = outside.rename(place / "outside")
    (place / "cognitivedrone-link").symlink_to(outside)
    (mine / ".owner").symlink_to(outside / ".owner")
    with TemporaryFolder() as living:
        temporary._sweep.cache_clear()
        with TemporaryFolder():
            assert living.is_dir()
    assert {path.name for path in place.iterdir()} == {"cognitivedrone-mine", "cognitivedrone-link", "outside"}
    assert (outside / ".owner").exists()


def test_a_forked_child_leaves_its_parents_folder(place: Path) -> None:
    folder = TemporaryFolder()
    child = os.fork()
    if not child:
        folder.close()
        os._exit(0)
    os.waitpid(child, 0)
    assert folder.path.is_dir()
    folder.close()
    assert not [*place.iterdir()]


def test_where_no_file_can_be_locked_nothing_is_swept(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: int) -> bool:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(temporary.system, "lock", refused)
    left = made()
    with TemporaryFolder():
        temporary._sweep.cache_clear()
        TemporaryFolder().close()
        assert len([*place.iterdir()]) == 2
    assert [*place.iterdir()] == [left]
