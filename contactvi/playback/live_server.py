"""The server of a live view: a page, and for each page that is open the newest frame, by server-sent events.

A page that is slower than the frames come gets the newest one when it is ready; what happened in between waits for it,
up to PENDING bytes. The loop that publishes never waits for a page.
"""

from __future__ import annotations

import http.server
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

PENDING = 1 << 20  # [bytes] of what happened that wait for one page; the oldest go first
RELOAD = 2.0  # [s] a page that is loaded again is back within this time
_LOOK = 0.25  # [s] between two looks whether a page without news is still there
_POLL = 0.05  # [s] between two looks whether to stop serving
_FLUSH = 1.0  # [s] for the last frame to reach the pages


class FrameServer:
    """Serves a page at `url`, and frames that are published; for this machine only."""

    def __init__(self, page: str) -> None:
        self._changed = threading.Condition()
        self._streams: list[_Stream] = []
        self._latest: str | None = None
        self._ended = False
        self._left: float | None = None  # when the last page went, None before the first one
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _handler(page.encode("utf-8"), self))
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/"
        threading.Thread(target=self._server.serve_forever, args=(_POLL,), name="contactvi-live", daemon=True).start()

    @property
    def pages(self) -> int:
        """How many pages are open."""
        return len(self._streams)

    @property
    def watched(self) -> bool:
        """Whether a page is open, or was within the time that loading it again takes, or none was so far."""
        left = self._left
        return bool(self._streams) or left is None or time.monotonic() - left < RELOAD

    def publish(self, frame: str, happened: str | None = None, restart: bool = False) -> None:
        """Give a frame (JSON) to all pages, with what happened since the one before.

        Args:
            restart: nothing that waits is of the run any more.
        """
        with self._changed:
            self._latest = frame
            for stream in self._streams:
                stream.put(frame, happened, restart)
            self._changed.notify_all()

    def wait_for_page(self, timeout: float) -> bool:
        """Wait until a page is open; return whether one is."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._streams), timeout)

    def close(self) -> None:
        """Send what waits, tell the pages that this was all, and stop serving."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._streams, _FLUSH)
            stalled = list(self._streams)
        for stream in stalled:
            stream.cut()
        self._server.shutdown()
        self._server.server_close()

    def serve(self, connection: socket.socket, answer: Callable[[], None]) -> None:
        """Send frames to one page until it goes, or until all were sent.

        A page that has got its answer is among those that see what happens: it is taken in before.
        """
        stream = _Stream(connection)
        with self._changed:
            if self._latest is not None:
                stream.put(self._latest, None, False)
            self._streams.append(stream)
            self._left = time.monotonic()  # from now on there was one
            self._changed.notify_all()
        try:
            answer()
            self._send_all(stream)
        except OSError:  # the page is gone
            pass
        finally:
            with self._changed:
                self._streams.remove(stream)
                self._left = time.monotonic()
                self._changed.notify_all()

    def _send_all(self, stream: _Stream) -> None:
        while not stream.hung_up():
            with self._changed:
                self._changed.wait_for(lambda: stream.waits or self._ended, _LOOK)
                message, ended = stream.take(), self._ended
            if message is not None:
                stream.send(message)
            elif ended:
                stream.send("event: end\ndata: {}\n\n")
                return


class _Stream:
    """The connection to one page, and what waits for it."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._frame: str | None = None
        self._happened: deque[str] = deque()
        self._size = 0

    @property
    def waits(self) -> bool:
        """Whether there is something to send."""
        return self._frame is not None

    def put(self, frame: str, happened: str | None, restart: bool) -> None:
        """Take a frame in place of the one that waits."""
        if restart:
            self._happened.clear()
            self._size = 0
        self._frame = frame
        if happened is not None:
            self._happened.append(happened)
            self._size += len(happened)
        while self._size > PENDING:
            self._size -= len(self._happened.popleft())

    def take(self) -> str | None:
        """Return the event to send; None where nothing waits."""
        if self._frame is None:
            return None
        message = f'data: {{"frame": {self._frame}, "happened": [{", ".join(self._happened)}]}}\n\n'
        self._frame, self._size = None, 0
        self._happened.clear()
        return message

    def send(self, message: str) -> None:
        self._connection.sendall(message.encode("utf-8"))

    def hung_up(self) -> bool:
        """Return whether the page has closed the connection: it sends nothing else."""
        readable, _, _ = select.select([self._connection], [], [], 0)
        return bool(readable) and not self._connection.recv(1, socket.MSG_PEEK)

    def cut(self) -> None:
        """End the connection, from any thread."""
        with suppress(OSError):  # it has ended
            self._connection.shutdown(socket.SHUT_RDWR)


def _handler(page: bytes, server: FrameServer) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        disable_nagle_algorithm = True

        def do_GET(self) -> None:
            if self.path == "/favicon.ico":  # browsers ask for it
                self.send_response(204)
                self.end_headers()
                return
            if self.path not in ("/", "/frames"):
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Cache-Control", "no-store")
            if self.path == "/frames":
                self.send_header("Content-Type", "text/event-stream")
                server.serve(self.connection, self.end_headers)
                return
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *arguments: Any) -> None:
            return

    return Handler
