"""Texts from outside: what must not be in them is named, and shown as an escape sequence where it is."""

import fcntl
import io
import os
import pty
import struct
import termios
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import CameraError, PolicyRaised
from cognitivedrone.text.printable import message, shown_address, unprintable, visible, wrapped

ANY = st.text(st.characters(codec=None, exclude_categories=()), max_size=40)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a\x1b[31mred", "the control character U+001B at position 2"),
        ("a\nb", "the control character U+000A at position 2"),
        ("\x9b31m", "the control character U+009B at position 1"),
        ("nul\x00", "the control character U+0000 at position 4"),
        ("a\u2028b", "the line separator U+2028 at position 2"),
        ("\ud800", "the lone surrogate U+D800 at position 1"),
        ("fly\u202eder", "the bidirectional override U+202E at position 4"),
        ("fly\u2066", "the bidirectional override U+2066 at position 4"),
        ("red\u200b", "the invisible character U+200B at position 4"),
        ("red\U000e0041", "the invisible character U+E0041 at position 4"),
    ],
)
def test_the_first_unfit_character_is_named(text: str, says: str) -> None:
    assert unprintable(text) == says
    assert unprintable(visible(text)) is None


@pytest.mark.parametrize(
    "text", ["Fly through the red gate", "[bold] 7 × 9", "лети", "می‌خواهم", "שלום‏", "👩‍🚀", "é", "e\u0301"]
)
def test_words_of_every_language_are_fit(text: str) -> None:
    assert unprintable(text) is None
    assert visible(text) == text


def test_escape_sequences_are_those_of_python() -> None:
    assert visible("a\x1b[0m\u202e\ud800\U000e0041") == r"a\x1b[0m\u202e\ud800\U000e0041"
    assert visible("a\nb\x07", keep="\n") == "a\nb\\x07"


@given(ANY)
def test_what_is_shown_can_be_encoded_and_moves_no_cursor(text: str) -> None:
    shown = visible(text)
    shown.encode("utf-8")
    assert not any(unicodedata.category(each) in ("Cc", "Cs", "Zl", "Zp") for each in shown)
    assert visible(shown) == shown
    assert (unprintable(text) is None) == (shown == text)


def test_a_message_keeps_its_lines_and_nothing_else() -> None:
    assert message("one:\n  two\x1b[31m\rthree\u2028") == "one:\n  two\\x1b[31m\\x0dthree\\u2028"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("cannot read rtsp://user:secret@10.0.0.5/live: refused", "cannot read rtsp://***@10.0.0.5/live: refused"),
        ("'http://u:se@cret@host:80/a@b'", "'http://***@host:80/a@b'"),
        ("http://host/a@b and me@example.org", "http://host/a@b and me@example.org"),
        ("(rtsp://u:it's@host/1), rtsp://a:b@c", "(rtsp://***@host/1), rtsp://***@c"),
        ("rtsp://admin:pa/ss?w#d@host/1 twice: rtsp://u:1/2@host", "rtsp://***@host/1 twice: rtsp://***@host"),
        ("ws://h/?token=T; correct it", "ws://h/?token=***; correct it"),
        ('"HTTPS://h/x?a=T&b=U;c#V", "next"', '"HTTPS://h/x?a=***&b=***&***#***", "next"'),
        ("http://h/?SECRET.", "http://h/?***."),
        ("rtsp://h/user=admin_password=PW_channel=1.sdp?x", "rtsp://h/user=admin_password=***?***"),
        ("http://[::1]:80/stream and http://h/a,b?", "http://[::1]:80/stream and http://h/a,b?"),
    ],
)
def test_no_secret_of_an_address_is_shown(text: str, shown: str) -> None:
    assert message(text) == shown


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("/dev/video0", "/dev/video0"),
        ("gazebo:/camera?x", "gazebo:/camera?x"),
        ('http://me:a b"c@host/x?pw=d e', "http://***@host/x?pw=***"),
        ("http://host/x?pw=a,b=c", "http://host/x?pw=***"),
        ("remote:ws://host/?token=T,rows=3", "remote:ws://host/?token=***,rows=3"),
        ("my_module:Policy:wss://me:pw@host,url=http://h?k=v", "my_module:Policy:wss://***@host,url=http://h?k=***"),
        ("vlm:http://127.0.0.1:8000/v1,model=org/name", "vlm:http://127.0.0.1:8000/v1,model=org/name"),
    ],
)
def test_an_address_is_shown_without_its_secrets(address: str, shown: str) -> None:
    assert shown_address(address) == shown
    assert shown_address(shown) == shown


def test_an_error_tells_no_secret() -> None:
    error = CameraError("cannot read rtsp://me:PW@host/: 'rtsp://me:PW@host/?t=PW' is not there")
    assert "PW" not in str(error)
    assert "PW" not in PolicyRaised("ws://h?t=PW", "Traceback: ws://h?t=PW").trace


def test_a_terminal_gets_lines_of_its_width_and_a_file_those_that_there_are() -> None:
    text = "cognitivedrone: read docs/real-drone.md, then add --such-an-option\n  a  table"
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "w") as screen:
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 40, 0, 0))
        assert wrapped(text, screen).splitlines() == [
            "cognitivedrone: read docs/real-drone.md,",
            "then add --such-an-option",
            "  a  table",
        ]
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 0, 0, 0, 0))  # a width that nobody has set
        assert wrapped(text, screen) == text
    os.close(ours)
    assert wrapped(text, io.StringIO()) == text
    assert wrapped(text, screen) == text  # closed
    assert wrapped(text, None) == text
