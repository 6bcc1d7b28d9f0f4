"""The newest message of every channel: a slow reader misses messages, and no writer ever waits for a reader."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Mapping
from typing import Any


class Channels:
    """Written by any thread; read by the coroutines of the server."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[int, str | bytes]] = {}
        self._readers: set[Reader] = set()

    @property
    def viewers(self) -> int:
        """Number of readers."""
        return len(self._readers)

    def put(self, channel: str, message: str | bytes) -> None:
        """Replace the message of a channel, unless it is the same."""
        with self._lock:
            version, before = self._newest.get(channel, (0, None))
            if message == before:
                return
            self._newest[channel] = version + 1, message
            readers = list(self._readers)
        for reader in readers:
            reader.wake()

    def publish(self, channel: str, values: Mapping[str, Any]) -> None:
        """As `put`, for a table: a JSON message with the channel's name."""
        self.put(channel, json.dumps({"channel": channel, **values}, separators=(",", ":")))

    def newest(self, channel: str) -> str | bytes | None:
        """The message of a channel, if it has one."""
        with self._lock:
            return self._newest.get(channel, (0, None))[1]

    def enter(self, reader: Reader) -> None:
        """Add a reader; at once it gets what there is."""
        with self._lock:
            self._readers.add(reader)

    def leave(self, reader: Reader) -> None:
        """Remove a reader."""
        with self._lock:
            self._readers.discard(reader)

    def after(self, seen: dict[str, int]) -> list[str | bytes]:
        """The messages that are newer than `seen`, which is updated; texts first."""
        with self._lock:
            fresh = {name: found for name, found in self._newest.items() if found[0] != seen.get(name)}
        seen.update({name: version for name, (version, _) in fresh.items()})
        return sorted((message for _, message in fresh.values()), key=lambda message: isinstance(message, bytes))


class Reader:
    """One reader, in an event loop of its own thread."""

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._loop = asyncio.get_running_loop()
        self._news = asyncio.Event()
        self._seen: dict[str, int] = {}
        self._news.set()

    def wake(self) -> None:
        """Tell it of news; from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._news.set)

    async def read(self) -> list[str | bytes]:
        """Wait for messages that it has not read yet."""
        await self._news.wait()
        self._news.clear()
        return self._channels.after(self._seen)
