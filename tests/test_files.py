"""Names of data as names of files, and files that are none."""

from __future__ import annotations

import os
import socket
import threading
from pathlib import Path, PurePath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import RunError
from cognitivedrone.files import (
    LONGEST_NAME,
    check_regular,
    digest_of_file,
    is_hidden,
    natural_order,
    own_files,
    read_regular,
    replace_file,
    replacing,
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


def test_nothing_but_files_is_read_and_nothing_is_waited_for(odd_files: dict[str, Path]) -> None:
    for says, path in odd_files.items():
        for ask in (check_regular, lambda path: read_regular(path, 10)):
            with pytest.raises(OSError) as refused:  # noqa: PT011
                ask(path)
            assert refused.value.strerror in says.split("|")


def test_a_pipe_that_somebody_writes_into_is_no_file_either(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: os.close(os.open(pipe, os.O_RDWR)), daemon=True)
    writer.start()
    with pytest.raises(OSError, match="a pipe"):
        read_regular(pipe, 10)
    writer.join()


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
        with replacing(path, tmp_path / "beside") as beside:
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


def test_nothing_is_written_through_a_link_with_the_temporary_name(tmp_path):
    other = tmp_path / "other"
    other.write_text("precious")
    (tmp_path / "page.html.tmp").symlink_to(other)
    replace_file(tmp_path / "page.html", b"new")
    assert other.read_text() == "precious"
    assert (tmp_path / "page.html").read_bytes() == b"new"
    assert not (tmp_path / "page.html").is_symlink()


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


@given(st.lists(st.text(max_size=12)))
def test_any_names_can_be_sorted(names: list[str]) -> None:
    backwards = names[::-1]
    assert sorted(names, key=natural_order) == sorted(backwards, key=natural_order)
