"""Names of data as names of files, and files that are none."""

import errno
import os
import socket
import stat
from pathlib import Path, PurePath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import RunError
from cognitivedrone.files import (
    LONGEST_NAME,
    check_no_link,
    check_regular,
    create,
    digest_of_file,
    is_hidden,
    natural_order,
    own_files,
    read_regular,
    remove,
    remove_left_over,
    replace_file,
    replacing,
    replacing_folder,
    safe_name,
    writing,
)

EVIL = (
    "", ".", "..", "../x", "../../../../tmp/x", "/etc/x", "a/b", "a/../../b", "x/", "\\..\\x", "a\x00b", "a\nb", " ",
    "~", "x" * 5000, "é" * 300, "\u2025/x", "\uff0e\uff0e\uff0fx", "\u202e/x", "\ud800", "-rf", ".hidden", "a\x1b[31m",
    "…", "*?",
)  # fmt: skip


@pytest.mark.parametrize("name", ["Animals", "Math_desk", "my family", "семья", "v1.2", "a-b", "Two_Step"])
def test_plain_names_stay(name: str) -> None:
    assert safe_name(name) == name


@pytest.mark.parametrize("name", EVIL)
def test_an_evil_name_is_one_name_in_its_folder(tmp_path: Path, name: str) -> None:
    check_name(name)
    path = tmp_path / "out" / safe_name(name)
    path.mkdir(parents=True)
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]
    assert path.resolve().parent == tmp_path / "out"


@given(st.text(st.characters(codec=None, exclude_categories=()), max_size=300))
def test_every_text_has_a_name(text: str) -> None:
    check_name(text)


def check_name(text: str) -> None:
    name = safe_name(text)
    assert name == Path(name).name
    assert "\x00" not in name
    assert name.isprintable()
    assert not name.startswith(".")
    assert 0 < len(name.encode()) <= LONGEST_NAME
    assert safe_name(name) == name


def test_changed_names_do_not_fall_together() -> None:
    texts = ["a_b", "a/b", "a\nb", "a:b", "x" * 200, "x" * 201, "..", "."]
    assert len({safe_name(text) for text in texts}) == len(texts)


@pytest.fixture
def odd_files(tmp_path: Path) -> dict[str, Path]:
    """What is no ordinary file, by what is said of it."""
    pipe, folder, link, loop = (tmp_path / name for name in ("pipe", "folder", "link", "loop"))
    os.mkfifo(pipe)
    folder.mkdir()
    link.symlink_to(tmp_path / "nowhere")
    loop.symlink_to(loop)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
    return {
        "it is a pipe, not a file": pipe,
        "it is a folder, not a file": folder,
        "it is a device, not a file": Path("/dev/zero"),
        "No such file or directory": link,
        "Too many levels of symbolic links": loop,
        "it is a socket, not a file|No such device or address": tmp_path / "socket",
    }


@pytest.mark.parametrize("name", ["con", "NUL", "aux.png", "com1", "lpt9.tar.gz", "prn .x"])
def test_a_device_of_windows_is_no_file_anywhere(name):
    assert safe_name(name).startswith(f"_{name}-")
    assert safe_name(f"{name[:3]}sole") == f"{name[:3]}sole"


def test_nothing_but_files_is_read_and_nothing_is_waited_for(odd_files: dict[str, Path]) -> None:
    for says, path in odd_files.items():
        for ask in (check_regular, digest_of_file, lambda path: read_regular(path, 10)):
            with pytest.raises(OSError) as refused:  # noqa: PT011
                ask(path)
            assert refused.value.strerror in says.split("|")


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"0123456789")
    assert read_regular(path, 10) == b"0123456789"
    with pytest.raises(OSError, match="it has 10 bytes, and at most 9 are read"):
        read_regular(path, 9)


def test_a_disk_that_refuses_is_one_sentence() -> None:
    with (
        pytest.raises(RunError, match=r"^cannot write /dev/full: No space left on device; make room") as output,
        writing(Path("/dev/full"), RunError),
        Path("/dev/full").open("wb", buffering=0) as full,
    ):
        full.write(b"x")
    assert "\n" not in str(output.value)


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    replace_file(path, b"old")
    replace_file(path, b"new")
    assert path.read_bytes() == b"new"

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        replace_file(path, b"newer")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_while_a_file_is_written_leaves_the_old_one_alone(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def stopped() -> None:
        with replacing(path) as beside:
            beside.write_bytes(b"half of the n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_files_hash_is_that_of_its_content(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"abc")
    assert digest_of_file(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_sparse_file_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "model"
    with path.open("wb") as file:
        file.truncate(3 * 10**9)

    def opened(*_: object, **__: object) -> int:
        raise AssertionError

    monkeypatch.setattr(os, "open", opened)
    for ask in (check_regular, digest_of_file, read_regular):
        with pytest.raises(OSError, match="it has 3,000,000,000 bytes, and at most 1,000 are read"):
            ask(path, 1000)


def test_a_file_without_a_size_is_read_up_to_its_limit() -> None:
    with pytest.raises(OSError, match="at most 10 are read"):
        read_regular(Path("/proc/self/status"), 10)


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    """A folder of somebody else, with a file."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    (folder / "file").write_text("precious")
    return folder


def kept(precious: Path) -> bool:
    return [path.name for path in precious.iterdir()] == ["file"] and (precious / "file").read_text() == "precious"


def test_nothing_is_written_through_a_link(tmp_path: Path, precious: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name in ("page.html", "page.html.tmp", "page.html.part", ".page.html.tmp", "log", "hard"):
        (out / name).symlink_to(precious / "file")
    (out / "hard").unlink()
    (out / "hard").hardlink_to(precious / "file")
    replace_file(out / "page.html", b"new")
    for name in ("log", "hard"):
        with create(out / name) as log:
            log.write(b"new")
    assert kept(precious)
    for name in ("page.html", "log", "hard"):
        assert (out / name).read_bytes() == b"new"
        assert not (out / name).is_symlink()


def test_a_pipe_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for write in (lambda path: replace_file(path, b"x"), create):
        with pytest.raises(OSError, match="it is a pipe, not a file"):
            write(tmp_path / "pipe")
    assert (tmp_path / "pipe").is_fifo()
    assert len(list(tmp_path.iterdir())) == 1


def test_a_link_that_takes_the_temporary_files_place_does_not_become_the_file(tmp_path: Path, precious: Path) -> None:
    path = tmp_path / "file"

    def write_another_file() -> None:
        with replacing(path) as temporary:
            temporary.unlink()
            temporary.symlink_to(precious / "file")

    with pytest.raises(OSError, match="it is a link, not a file"):
        write_another_file()
    assert not path.exists()
    assert not path.is_symlink()
    assert kept(precious)


def test_files_get_the_permissions_that_the_user_gives_new_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        replace_file(tmp_path / "whole", b"")
        create(tmp_path / "log").close()
        with replacing_folder(tmp_path / "folder"):
            pass
    finally:
        os.umask(before)
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("whole", "log", "folder")] == [
        0o640, 0o640, 0o750
    ]  # fmt: skip


def test_a_folder_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    def fail() -> None:
        with replacing_folder(tmp_path / "deep" / "out") as folder:
            (folder / "half").write_text("")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert not list((tmp_path / "deep").iterdir())
    with replacing_folder(tmp_path / "deep" / "out") as folder:
        (folder / "whole").write_text("")
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["out"]
    with pytest.raises(OSError, match="not empty"), replacing_folder(tmp_path / "deep" / "out"):
        pass
    assert [path.name for path in (tmp_path / "deep").rglob("*")] == ["out", "whole"]


def test_files_and_folders_are_removed(tmp_path: Path, precious: Path) -> None:
    (tmp_path / "out/shards/deep").mkdir(parents=True)
    (tmp_path / "out/shards/deep/link").symlink_to(precious)
    (tmp_path / "out/shards/file").write_text("")
    remove(tmp_path / "out", "shards/file")
    remove(tmp_path / "out", "shards/file")
    remove(tmp_path / "out", "no/such/file")
    remove(tmp_path / "no", "such/file")
    assert [path.name for path in (tmp_path / "out/shards").iterdir()] == ["deep"]
    remove(tmp_path / "out", "shards")
    assert not list((tmp_path / "out").iterdir())
    remove(tmp_path / "out")
    assert kept(precious)


def test_nothing_is_removed_through_a_link(tmp_path: Path, precious: Path) -> None:
    out = tmp_path / "out"
    (out / "real").mkdir(parents=True)
    (precious / ".x.0.tmp").write_text("left over, but not by us")
    for link in (out / "shards", out / "real" / "shards"):
        link.symlink_to(precious)
    (out / "link").symlink_to(precious / "file")
    attempts = (
        lambda: remove(out, "shards"), lambda: remove(out, "shards/file"), lambda: remove(out, "real/shards/file"),
        lambda: remove(out, "link"), lambda: remove(out / "shards"), lambda: remove_left_over(out, "shards"),
        lambda: check_no_link(out, "shards"),
    )  # fmt: skip
    for attempt in attempts:
        with pytest.raises(OSError, match="is a link or in one") as refused:
            attempt()
        assert refused.value.errno == errno.ELOOP
    (precious / ".x.0.tmp").unlink()
    assert kept(precious)
    assert (out / "link").is_symlink()


def test_a_folder_that_is_reached_through_the_users_own_link_is_written_and_cleared(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    replace_file(tmp_path / "out" / "file", b"x")
    remove(tmp_path / "out", "file")
    assert not list((tmp_path / "disk").iterdir())


def test_what_killed_writers_left_is_removed_and_what_living_ones_write_is_not(tmp_path: Path) -> None:
    for name in (".file.0123456789abcdef.tmp", ".of-an-earlier-version.77.tmp", "named.tmp", ".hidden"):
        (tmp_path / name).write_text("half")
    with replacing(tmp_path / "file") as temporary:
        remove_left_over(tmp_path)
        assert {path.name for path in tmp_path.iterdir()} == {temporary.name, "named.tmp", ".hidden"}
    remove_left_over(tmp_path, "nothing")
    assert {path.name for path in tmp_path.iterdir()} == {"file", "named.tmp", ".hidden"}


@pytest.mark.parametrize(
    "name",
    [
        "._cat.png", ".DS_Store", "a/.ipynb_checkpoints/b.png", "__MACOSX/a/b.json", "a/Thumbs.db", "THUMBS.DB",
        "@eaDir/a.png", "x/@eaDir", "Desktop.ini", "$RECYCLE.BIN/a.png", "#recycle/a", "System Volume Information/a",
    ],
)  # fmt: skip
def test_what_systems_leave_is_hidden(name: str, tmp_path: Path) -> None:
    assert is_hidden(PurePath(name))
    for each in (name, "mine/shown.png"):
        (tmp_path / each).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / each).touch()
    assert [path for path in own_files(tmp_path, "**/*") if path.is_file()] == [tmp_path / "mine/shown.png"]


@pytest.mark.parametrize("name", ["cat.png", "my.cat.png", "a/b/c", "thumbs.png", "macosx/a", "eaDir/a", "…/a", "x."])
def test_what_is_the_users_own_is_not_hidden(name: str) -> None:
    assert not is_hidden(PurePath(name))


def test_names_are_sorted_as_people_count() -> None:
    names = ["10.png", "2.png", "1.png", "b2a10", "b2a9", "B1", "b", "a", "007", "7", "٣", "²", "img-1.5", "img-1.10"]
    ordered = sorted(names, key=natural_order)
    assert [name for name in ordered if name.endswith(".png")] == ["1.png", "2.png", "10.png"]
    assert [name for name in ordered if name[0] in "bB"] == ["b", "B1", "b2a9", "b2a10"]
    assert ordered.index("img-1.5") < ordered.index("img-1.10")
