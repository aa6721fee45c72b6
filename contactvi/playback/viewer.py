"""Showing a run in the browser: the page of contactvi.playback.page behind an address of this machine."""

from __future__ import annotations

import http.server
import threading
import webbrowser
from typing import TYPE_CHECKING, Any, overload

from contactvi.inputs import flag
from contactvi.playback.live import LiveView
from contactvi.playback.live_frames import Stepped
from contactvi.playback.notebook import inline
from contactvi.playback.page import Run, fill_page, page_data

if TYPE_CHECKING:
    from typing_extensions import TypeIs


@overload
def view(run: Run, *, open_browser: bool = True, **options: Any) -> View: ...
@overload
def view(run: Stepped, *, open_browser: bool = True, realtime: bool | float = False, **options: Any) -> LiveView: ...
def view(run: Run | Stepped, *, open_browser: bool = True, **options: Any) -> View | LiveView:
    """Serve the playback of a run, or the live view of a simulator, and open it in the browser; return at once.

    Args:
        run: a Trajectory, or a Simulator that has been reset.
        open_browser: open a browser window; the address is printed in any case.
        **options: title, forces, camera of `contactvi.playback.page.write_html`; of a Trajectory fps and play, too; of
            a Simulator realtime: True, so that `sync` holds simulated time back to wall time, or a number of simulated
            seconds per second.

    The page is served while this process lives; a script that would end right away calls `.wait()` on the result. For
    a file that needs no process, use `Trajectory.to_html`. In a notebook the result shows itself.

    A simulator is shown while it runs, at each call of `sync`, at most 60 times a second::

        with cvi.view(sim, realtime=True) as live:
            while live.is_open and sim.t < 10.0:
                sim.step()
                live.sync()

    Raises:
        InputError: for what cannot be shown, and options that are not usable.
        SimulationError: for a simulator without a state.
    """
    open_browser = flag("open_browser", open_browser)
    shown = LiveView(run, **options) if _is_stepped(run) else View(page_data(run, **options))
    print(f"{'Live view' if isinstance(shown, LiveView) else 'Playback'} at {shown.url}")
    if open_browser:
        webbrowser.open(shown.url, new=2)
    return shown


def _is_stepped(run: Run | Stepped) -> TypeIs[Stepped]:
    return hasattr(type(run), "recent")


class View:
    """A playback that is being served at `url`."""

    def __init__(self, data: dict[str, Any]) -> None:
        self._data = data
        page = fill_page(data).encode("utf-8")
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _handler(page))
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
        return inline(self._data)


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
