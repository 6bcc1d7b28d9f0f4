"""Clients and servers as other projects write them: openpi's protocol by its description, without our code."""

import asyncio
import contextlib
import threading
import traceback

import msgpack
import numpy as np
import websockets.asyncio.server
import websockets.sync.client


def encode(value):
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    raise TypeError(type(value))


def decode(table):
    if b"__ndarray__" in table:
        return np.ndarray(table[b"shape"], np.dtype(table[b"dtype"]), table[b"data"])
    return table


def packed(message):
    return msgpack.packb(message, default=encode)


def unpacked(data):
    return msgpack.unpackb(data, object_hook=decode)


class Client:
    """Sends observations, as openpi's client does."""

    def __init__(self, address, **headers):
        self._connecting = websockets.sync.client.connect(
            f"ws://{address}", compression=None, max_size=None, additional_headers=headers, proxy=None
        )

    def __enter__(self):
        self.socket = self._connecting.__enter__()
        self.metadata = unpacked(self.socket.recv(60))
        return self

    def __exit__(self, *error):
        self._connecting.__exit__(*error)

    def send(self, message):
        self.socket.send(message if isinstance(message, (str, bytes)) else packed(message))

    def receive(self):
        """A map, or the text of an error."""
        answer = self.socket.recv(60)
        return answer if isinstance(answer, str) else unpacked(answer)

    def ask(self, message):
        self.send(message)
        return self.receive()


def observation(prompt="Fly through the red gate", **changed):
    """A message that is as it should be, but for what is changed; None leaves a key out."""
    message = {
        "observation/image": np.zeros((256, 256, 3), np.uint8),
        "observation/state": np.array([0.1, 0.2, 0.3, 1.5, -0.5]),
        "prompt": prompt,
    } | {name.replace("__", "/"): value for name, value in changed.items()}
    return {name: value for name, value in message.items() if value is not None}


@contextlib.contextmanager
def openpi_server(infer, metadata=None, tls=None):
    """A server that behaves as openpi's does: metadata first, then an answer to each observation.

    Text is sent as it is. An exception of `infer` is sent as its traceback, and ends the connection.
    """
    ready, stop = threading.Event(), None
    address = ""

    async def converse(socket):
        await socket.send(packed(metadata or {}))
        async for data in socket:
            try:
                answer = infer(unpacked(data))
                timed = answer if isinstance(answer, str) else packed(answer | {"server_timing": {"infer_ms": 1.0}})
                await socket.send(timed)
            except Exception:
                await socket.send(traceback.format_exc())
                await socket.close(1011, "Internal server error. Traceback included in previous frame.")

    async def main():
        nonlocal stop, address
        stop = (asyncio.get_running_loop(), asyncio.Event())
        async with websockets.asyncio.server.serve(
            converse, "127.0.0.1", 0, compression=None, max_size=None, ssl=tls
        ) as server:
            host, port = server.sockets[0].getsockname()[:2]
            address = f"{host}:{port}"
            ready.set()
            await stop[1].wait()

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    assert ready.wait(60)
    try:
        yield address
    finally:
        loop, event = stop
        loop.call_soon_threadsafe(event.set)
        thread.join()
