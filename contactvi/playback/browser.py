"""A headless Chromium that draws a page and sends back pictures: no driver is needed, the page posts them itself."""

from __future__ import annotations

import contextlib
import http.server
import math
import os
import queue
import secrets
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from contactvi.errors import ContactviError

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
_FLAGS = (
    "--headless=new", "--no-first-run", "--disable-dev-shm-usage", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-extensions", "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
)  # fmt: skip
# WebGL is needed, and a machine that makes documents may have no graphics card. Chromium has a software renderer of its
# own. On Linux EGL is asked first: without a graphics card that is llvmpipe of Mesa, which takes less than half of the
# time; where there is no EGL, Chromium takes its own.
_DRAWING = (
    ("--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist", "--enable-unsafe-swiftshader")
    if sys.platform.startswith("linux")
    else ("--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
)
_TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100  # of a second, in /proc
PATIENCE = 120.0  # [s] for one picture; the first one comes after the browser has started
_POST_LIMIT = 1 << 30  # [bytes]


@dataclass
class Cost:
    """What pictures have cost.

    Attributes:
        asked, drawn: how many were asked for, and how many of them were drawn: the others are like those before them.
        seconds: of processors, which the browser has used with all of its processes; NaN without /proc, as of Linux.
    """

    asked: int = 0
    drawn: int = 0
    seconds: float = 0.0


_COST: ContextVar[Cost | None] = ContextVar("_COST", default=None)


@contextlib.contextmanager
def measured() -> Iterator[Cost]:
    """Count what the pictures cost that are drawn in the `with`, by the thread that entered it."""
    cost = Cost()
    token = _COST.set(cost)
    try:
        yield cost
    finally:
        _COST.reset(token)


def find_browser() -> str:
    """Return the program. Raises ContactviError where there is none."""
    for name in NAMES:
        if (found := shutil.which(name)) is not None:
            return found
    raise ContactviError(
        "Pictures are drawn by a browser without a window, and none was found",
        expected="Chromium or Chrome in PATH (" + ", ".join(NAMES[:3]) + ", ...)",
        got="none",
        remedy="Install one (Debian: apt install chromium), or write a page with to_html and open it",
    )


def pictures(page: str, count: int) -> Iterator[bytes]:
    """Yield the `count` pictures that a page posts to "frame" below its address; "failed" gets what went wrong.

    What a page posts is passed on as it is: nothing where the page says so by an empty picture.

    Raises:
        ContactviError: no browser, it ended, the page failed, or nothing came for PATIENCE seconds.
    """
    program, cost = find_browser(), _COST.get()
    arrived: queue.Queue[tuple[str, bytes]] = queue.Queue(maxsize=4)
    token = secrets.token_urlsafe(16)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _handler(token, page.encode("utf-8"), arrived))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="contactvi-render", daemon=True).start()
    with tempfile.TemporaryDirectory(prefix="contactvi-", ignore_cleanup_errors=True) as folder:
        log = Path(folder) / "log"
        address = f"http://127.0.0.1:{server.server_address[1]}/{token}/"
        unsafe = ["--no-sandbox"] if os.geteuid() == 0 else []
        flags = [*_FLAGS, *_DRAWING, f"--user-data-dir={folder}/profile", *unsafe]
        with log.open("wb") as output:
            process = subprocess.Popen(
                [program, *flags, address], stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                start_new_session=True,
            )  # fmt: skip
        try:
            for _ in range(count):
                data = _next(arrived, process, log)
                if cost is not None:
                    cost.asked, cost.drawn = cost.asked + 1, cost.drawn + bool(data)
                yield data
        finally:
            if cost is not None:
                cost.seconds += _session_seconds(process.pid)
            _stop(process)
            server.shutdown()
            server.server_close()


def _next(arrived: queue.Queue[tuple[str, bytes]], process: subprocess.Popen[bytes], log: Path) -> bytes:
    waited = 0.0
    while True:
        try:
            kind, data = arrived.get(timeout=0.5)
        except queue.Empty:
            waited += 0.5
            ended = process.poll()
            if ended is None and waited < PATIENCE:
                continue
            last = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:]
            happened = f"its end with code {ended}" if ended is not None else f"nothing for {PATIENCE:g} s"
            raise ContactviError(
                "The browser drew no picture", expected="a picture", got=": ".join([happened, *last]),
                remedy="See that it draws WebGL without a window, or write a page with to_html and open it",
            ) from None  # fmt: skip
        if kind == "frame":
            return data
        raise ContactviError(
            "The page could not be drawn", expected="a picture", got=data.decode("utf-8", errors="replace"),
            remedy="Write the page with to_html and look at it in a browser with WebGL",
        )  # fmt: skip


def _session_seconds(session: int) -> float:
    """Return what the processes of a session have used [s], with those among them that have ended."""
    ticks = 0
    if not Path("/proc/self/stat").exists():
        return math.nan
    for process in Path("/proc").glob("[0-9]*/stat"):
        try:
            numbers = process.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended
        if int(numbers[3]) == session:
            ticks += sum(int(number) for number in numbers[11:15])
    return ticks / _TICKS


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End the browser and the processes that it started: they are a session of their own."""
    if process.poll() is None:
        try:
            os.killpg(process.pid, 15)
            process.wait(5.0)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            pass
    if process.poll() is None:
        os.killpg(process.pid, 9)
        process.wait()


def _handler(
    token: str, page: bytes, arrived: queue.Queue[tuple[str, bytes]]
) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer(page if self.path == f"/{token}/" else None)

        def do_POST(self) -> None:
            kind, size = self.path.removeprefix(f"/{token}/"), int(self.headers.get("Content-Length", 0))
            if kind not in ("frame", "failed") or size > _POST_LIMIT:
                self._answer(None)
                return
            arrived.put((kind, self.rfile.read(size)))  # waits where the pictures are not taken: so does the page
            self._answer(b"")

        def _answer(self, body: bytes | None) -> None:
            with contextlib.suppress(ConnectionError):  # the browser has been ended, and asks for nothing any more
                self.send_response(404 if body is None else 200)
                self.send_header("Content-Type", "text/html; charset=utf-8")
                self.send_header("Content-Length", str(len(body or b"")))
                self.end_headers()
                self.wfile.write(body or b"")

        def log_message(self, format: str, *arguments: object) -> None:
            return

    return Handler
