"""A person at the live page, and the page itself, for tests."""

import io
import json
import threading
import time
from contextlib import contextmanager

import PIL.Image

from cognitivedrone.play.app import play
from cognitivedrone.play.config import PageSpec

PAGE = PageSpec(port=0, browser=False)


def png(color=(200, 30, 30)):
    buffer = io.BytesIO()
    PIL.Image.new("RGB", (40, 30), color).save(buffer, "PNG")
    return buffer.getvalue()


class Person:
    """A person at the page, over its own websocket."""

    def __init__(self, socket):
        self.socket, self.session, self.state, self.scene = socket, {}, {}, {}

    def do(self, command, **values):
        self.socket.send(json.dumps({"do": command, **values}))

    def until(self, condition, seconds=60):
        """Read messages until the condition holds."""
        deadline = time.monotonic() + seconds
        while not condition(self):
            assert time.monotonic() < deadline, (self.session, self.state)
            message = self.socket.recv(timeout=seconds)
            if isinstance(message, str):
                table = json.loads(message)
                setattr(self, table["channel"], table)

    error: dict = {}  # noqa: RUF012


@contextmanager
def playing(plan):
    found, stop, ready = [], threading.Event(), threading.Event()

    def opened(address):
        found.append(address)
        ready.set()

    thread = threading.Thread(target=play, args=(plan, opened, stop))
    thread.start()
    assert ready.wait(60)
    try:
        yield found[0]
    finally:
        stop.set()
        thread.join()
