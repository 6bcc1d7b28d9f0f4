"""Motion JPEG over HTTP: serves a simulated camera to other processes.

An endless response of JPEGs between boundaries (multipart/x-mixed-replace), which browsers, FFmpeg and OpenCV can read.
"""

from __future__ import annotations

import io
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import PIL.Image

from cognitivedrone.errors import CameraError
from cognitivedrone.types import Image

HOST = "127.0.0.1"
"""Only the loopback interface: there is no authentication."""
QUALITY = 90
MOST_VIEWERS = 4
PATIENCE_S = 5.0
"""A viewer that sends no request, or reads nothing, for this long is disconnected."""
BOUNDARY = "frame"


class FrameServer:
    """Serves the newest frame at `http://127.0.0.1:PORT/`; port 0 picks a free one. Use it as a context manager.

    Raises `CameraError` if the port cannot be opened.
    """

    def __init__(self, port: int) -> None:
        self._news = threading.Condition()
        self._newest: tuple[int, bytes] = (0, b"")
        self._viewers = 0
        self._closed = False
        handler = type("Handler", (_Handler,), {"frames": self})
        try:
            self._server = _Server((HOST, port), handler)
        except (OSError, OverflowError) as error:
            raise CameraError(f"cannot serve frames at port {port}: {error}; give another with --camera-port") from None
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="frames", daemon=True)
        self._thread.start()

    def __enter__(self) -> FrameServer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Address of the stream."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

    def wait_for_viewer(self, timeout_s: float) -> bool:
        """Wait for a viewer, at most `timeout_s`; false if there is none, so that nothing need be rendered."""
        with self._news:
            return self._news.wait_for(lambda: self._viewers > 0, timeout_s)

    def show(self, image: Image) -> None:
        """Send a frame, (H, W, 3), to all viewers."""
        buffer = io.BytesIO()
        PIL.Image.fromarray(image).save(buffer, "JPEG", quality=QUALITY)
        with self._news:
            self._newest = (self._newest[0] + 1, buffer.getvalue())
            self._news.notify_all()

    def close(self) -> None:
        """Disconnect all viewers and release the port."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def enter(self) -> bool:
        """Add a viewer; false if there are too many."""
        with self._news:
            if self._viewers >= MOST_VIEWERS:
                return False
            self._viewers += 1
            self._news.notify_all()
            return True

    def leave(self) -> None:
        """Remove a viewer."""
        with self._news:
            self._viewers -= 1

    def after(self, count: int) -> tuple[int, bytes] | None:
        """Wait for a JPEG with a number above `count`; returns both, or none when the server closes."""
        with self._news:
            self._news.wait_for(lambda: self._newest[0] > count or self._closed)
            return None if self._closed else self._newest


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore viewers that disconnect."""


class _Handler(BaseHTTPRequestHandler):
    frames: FrameServer
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        """Send the stream."""
        if self.path != "/":
            self.send_error(404, "the frames are at /")
        elif not self.frames.enter():
            self.send_error(503, f"{MOST_VIEWERS} viewers are served already")
        else:
            try:
                self._stream()
            finally:
                self.frames.leave()

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        count = 0
        while (newer := self.frames.after(count)) is not None:
            count, jpeg = newer
            head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")

    def log_message(self, *_: object) -> None:
        """Do not log requests to the terminal."""
