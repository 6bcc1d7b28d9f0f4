"""Local connections that carry whole messages, and the same over streams, as on macOS."""

import socket
from contextlib import closing, suppress

import pytest

from cognitivedrone.vehicles.mavlink.client.transport import PacketLog, open_log
from cognitivedrone.vehicles.mavlink.guard import messages
from cognitivedrone.vehicles.mavlink.guard.messages import MessageSocket, connected_pair


@pytest.fixture(params=[False, True], ids=["messages", "streams"], autouse=True)
def framed(request, monkeypatch):
    if request.param:
        monkeypatch.setattr(messages, "message_pair", lambda: (*socket.socketpair(), True))
    return request.param


def test_messages_come_whole_and_in_order_until_the_end(framed):
    ours, theirs = connected_pair()
    with closing(theirs):
        assert (ours.framed, theirs.framed) == (framed, framed)
        for message in (b"one", b"2" * 70_000, b"three"):
            ours.send(message)
        assert theirs.recv(1 << 18) == b"one"
        assert theirs.recv(100) == b"2" * 100  # the rest of it is gone
        ours.close()
        assert theirs.recv(1 << 18) == b"three"
        assert theirs.recv(1 << 18) == b""


def test_what_is_not_taken_at_once_is_dropped_whole():
    ours, theirs = connected_pair()
    ours._end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 12)
    with closing(ours), closing(theirs):
        sent = []
        for number in range(10_000):
            message = number.to_bytes(4, "big") * 250
            try:
                ours.send(message)
            except BlockingIOError:
                if len(sent) < number - 10:
                    break
            else:
                sent.append(message)
        theirs._end.setblocking(False)
        received = []
        for _ in range(3):  # what is left of the last one goes before the next
            with suppress(BlockingIOError):
                while True:
                    received.append(theirs.recv(1 << 18))
            with suppress(BlockingIOError):
                ours.send(b"after")
        assert received[: len(sent)] == sent
        assert set(received[len(sent) :]) == {b"after"}


def test_a_stream_of_something_else_has_ended(framed):
    if not framed:
        pytest.skip("nothing else can come")
    raw, end = socket.socketpair()
    with raw, end:
        raw.send(b"\xff" * 100)
        assert MessageSocket(end, framed=True).recv(100) == b""


def test_the_log_has_every_record(tmp_path):
    log = PacketLog(open_log(tmp_path / "new" / "flight.tlog"))
    packets = [bytes([number]) * (number + 1) for number in range(200)]
    for packet in packets:
        log.put(packet)
    assert log.close() == ""
    content = (tmp_path / "new" / "flight.tlog").read_bytes()
    for packet in packets:
        record, content = content[: 8 + len(packet)], content[8 + len(packet) :]
        assert record[8:] == packet
    assert content == b""
