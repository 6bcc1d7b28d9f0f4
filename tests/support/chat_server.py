"""A real HTTP server on loopback that answers as an OpenAI-compatible chat API does, and as it should not."""

import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

GOOD = '{"size": "big", "color": "green", "shape": "triangle"}'


def chat(content: str | None, **message: object) -> bytes:
    choice = {"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": content, **message}}
    return json.dumps({"id": "x", "object": "chat.completion", "model": "eye-7b", "choices": [choice]}).encode()


@dataclass
class Script:
    """What the server does with each request in turn; the last goes on for ever. And what it has received."""

    replies: list[tuple[int, bytes]] = field(default_factory=lambda: [(200, chat(GOOD))])
    behave: Callable[[BaseHTTPRequestHandler], None] | None = None
    models: tuple[int, bytes] = (200, json.dumps({"data": [{"id": "eye-7b"}, {"id": "eye-3b"}]}).encode())
    headers: dict[str, str] = field(default_factory=dict)
    bodies: list[dict[str, Any]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    keys: list[str | None] = field(default_factory=list)


class Handler(BaseHTTPRequestHandler):
    script: Script
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass

    def do_GET(self) -> None:
        self.script.paths.append(self.path)
        self.script.keys.append(self.headers.get("Authorization"))
        self.answer(*self.script.models)

    def do_POST(self) -> None:
        script = self.script
        script.paths.append(self.path)
        script.keys.append(self.headers.get("Authorization"))
        script.bodies.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        if script.behave is not None:
            script.behave(self)
        else:
            self.answer(*(script.replies.pop(0) if len(script.replies) > 1 else script.replies[0]))

    def answer(self, status: int, body: bytes) -> None:
        self.send_response(status)
        for name, value in self.script.headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        try:
            self.wfile.write(body)
        except ConnectionError:
            self.close_connection = True


@contextlib.contextmanager
def serving(script: Script) -> Iterator[str]:
    """The base URL of a server that follows the script."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Scripted", (Handler,), {"script": script}))
    server.daemon_threads = True
    # A client that hangs up is what some tests do.
    server.handle_error = lambda request, address: None  # type: ignore[assignment]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1"
    finally:
        server.shutdown()
        server.server_close()
