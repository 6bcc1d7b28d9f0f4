"""Where compiled code is kept, and what happens where compiling fails. Nothing is compiled here."""

import os
import stat
import tempfile
import warnings
from pathlib import Path

import pytest

from cognitivedrone.models import compiling
from cognitivedrone.models.compiling import VARIABLE, compiled_or_plain, use_own_cache

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="a system without modes of files")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache folder; PyTorch's variable is not set."""
    monkeypatch.setenv(VARIABLE, "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(compiling, "_temporary", [])
    return tmp_path / "cache"


def test_code_is_kept_where_only_this_user_is(home: Path) -> None:
    use_own_cache()
    folder = home / "cognitivedrone/compiled"
    assert os.environ[VARIABLE] == str(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    (folder / "code").touch()
    os.environ[VARIABLE] = ""
    use_own_cache()
    assert (folder / "code").exists()


def test_without_a_cache_folder_of_its_own_it_is_the_home_folders(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    use_own_cache()
    assert os.environ[VARIABLE] == str(tmp_path / "home/.cache/cognitivedrone/compiled")


def test_what_pytorch_set_itself_is_nobodys_choice(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, f"{tempfile.gettempdir()}/torchinductor_somebody")
    use_own_cache()
    assert os.environ[VARIABLE] == str(home / "cognitivedrone/compiled")


def test_a_persons_own_folder_is_used(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "/somewhere")
    use_own_cache()
    assert os.environ[VARIABLE] == "/somewhere"
    assert not home.exists()


@pytest.mark.parametrize("what", ["shared", "a link", "a file", "another user's", "no place"])
def test_a_folder_that_others_may_write_to_is_not_used(
    what: str, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = home / "cognitivedrone/compiled"
    folder.parent.mkdir(parents=True)
    if what == "shared":
        folder.mkdir()
        folder.chmod(0o770)
    elif what == "a link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "elsewhere")
    elif what == "a file":
        folder.touch(0o600)
    elif what == "another user's":
        folder.mkdir(mode=0o700)
        monkeypatch.setattr(compiling.system, "is_mine", lambda facts: False)
    else:
        monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    with pytest.warns(RuntimeWarning, match=r"^compiled code is not kept for the next start: .*TORCHINDUCTOR") as said:
        use_own_cache()
    assert "\n" not in str(said[0].message)
    used = Path(os.environ[VARIABLE])
    assert used != folder
    assert stat.S_IMODE(used.stat().st_mode) == 0o700
    compiling._temporary[0].close()
    assert not used.exists()


def test_a_folder_that_has_grown_is_emptied(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_own_cache()
    folder = Path(os.environ[VARIABLE])
    (folder / "old").write_bytes(bytes(100))
    monkeypatch.setattr(compiling, "MOST_BYTES", 99)
    os.environ[VARIABLE] = ""
    use_own_cache()
    assert list(folder.iterdir()) == []
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_where_compiling_fails_it_is_said_once_for_all(home: Path) -> None:
    def fails() -> str:
        raise OSError("no C\ncompiler")

    with pytest.warns(RuntimeWarning, match="^a policy is not compiled, which is slower: OSError: no C compiler$"):
        assert compiled_or_plain("a policy", fails, lambda: "as it is", "inductor") == "as it is"
    assert os.environ[VARIABLE]
    os.environ[VARIABLE] = ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compiled_or_plain("a policy", lambda: "compiled", lambda: "as it is", "eager") == "compiled"
    assert not os.environ[VARIABLE]  # a backend that writes nothing
