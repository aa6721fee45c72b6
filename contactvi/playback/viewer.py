"""Showing a run in the browser: the page of contactvi.playback.page behind an address of this machine."""

from __future__ import annotations

import html
import http.server
import threading
import webbrowser
from typing import Any

from contactvi.inputs import flag
from contactvi.playback.page import Run, make_html


def view(run: Run, *, open_browser: bool = True, **options: Any) -> View:
    """Serve the playback of a run and open it in the browser; return at once.

    Args:
        run: a Trajectory.
        open_browser: open a browser window; the address is printed in any case.
        **options: fps, title, play, forces, camera of `contactvi.playback.page.write_html`.

    The page is served while this process lives; a script that would end right away calls `.wait()` on the result. For
    a file that needs no process, use `Trajectory.to_html`. In a notebook the result shows itself.
    """
    open_browser = flag("open_browser", open_browser)
    shown = View(make_html(run, **options))
    print(f"Playback at {shown.url}")
    if open_browser:
        webbrowser.open(shown.url, new=2)
    return shown


class View:
    """A playback that is being served at `url`."""

    def __init__(self, page: str) -> None:
        self._page = page.encode("utf-8")
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _handler(self._page))
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/"
        self._thread = threading.Thread(target=self._server.serve_forever, name="contactvi-view", daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        try:
            while self._thread.is_alive():
                self._thread.join(0.2)
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()

    def __repr__(self) -> str:
        return f"<View at {self.url}>"

    def _repr_html_(self) -> str:
        page = html.escape(self._page.decode("utf-8"), quote=True)
        return f'<iframe srcdoc="{page}" style="width: 100%; height: 480px; border: none"></iframe>'


def _handler(page: bytes) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path != "/":
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *arguments: Any) -> None:
            return

    return Handler
