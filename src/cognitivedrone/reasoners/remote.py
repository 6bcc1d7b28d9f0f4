"""A reasoner on a server of this project (`cognitivedrone serve --reasoner NAME`)."""

from __future__ import annotations

import time
from typing import Any

from cognitivedrone.errors import PluginError, ReasonerError, ServerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.remote.connection import Connection, Gone, Late
from cognitivedrone.remote.messages import IMAGE, PROMPT, PROTOCOL, Message, read_guidance, reset_message
from cognitivedrone.types import EpisodeContext, Guidance, Image


class Remote(Reasoner):
    """Asks the reasoner of the server at `url`, ws://HOST:PORT.

    An answer later than `timeout`, in s, counts as a fault of kind `timeout`, and the flight continues without it. The
    token comes from the environment variable COGNITIVEDRONE_SERVER_TOKEN. Raises `PluginError` for an invalid argument,
    `MissingExtra` if a package is missing.
    """

    def __init__(self, url: str, *, timeout: float = 10.0) -> None:
        if not 0 < timeout <= 50:
            raise PluginError(f"reasoner 'remote': timeout is {timeout}; it must be above 0 and at most 50 s")
        self.connection = Connection(url)
        self._timeout_s = timeout
        self._stages: list[EpisodeContext] = []
        self._sent = self._connections = 0

    def check(self) -> None:
        """Connect; raises `ServerError` if the server is not there, refuses, or has no reasoner."""
        self.connection.open()
        served = self.connection.ours
        if served is None or not served.get("reasoner"):
            raise ServerError(
                f"the server at {self.connection.url} has no reasoner; start it with --reasoner NAME, or give another"
            )
        self.needs_seed = served.get("reasoner_needs_seed") is True

    def reset(self, context: EpisodeContext) -> None:
        """Start a stage. The server gets it with the next frame."""
        if context.stage == 0:
            self._stages, self._sent = [], 0
        self._stages.append(context)

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive for the scene in `image`; raises `ReasonerError`."""
        until = time.monotonic() + self._timeout_s
        try:
            self.connection.open(self._timeout_s)
            self.connection.settle(until)
            return read_guidance(self.connection.request(self._message(image, instruction), until))
        except Late as error:
            raise ReasonerError("timeout", str(error)) from None
        except Gone as error:
            raise ReasonerError("unreachable", str(error)) from None
        except ServerError as error:
            raise ReasonerError("http", str(error)) from None

    def close(self) -> None:
        """Close the connection."""
        self.connection.close()

    def _message(self, image: Image, instruction: str) -> Message:
        if self._connections != self.connection.count:
            self._connections, self._sent = self.connection.count, 0
        unsent, self._sent = self._stages[self._sent :], len(self._stages)
        message: dict[str, Any] = {IMAGE: image, PROMPT: instruction, "ask": "guidance", "protocol": PROTOCOL}
        return message | ({"reset": [reset_message(stage) for stage in unsent]} if unsent else {})
