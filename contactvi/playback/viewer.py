"""Showing a run in the browser: the page of contactvi.playback.page behind an address of this machine."""

from __future__ import annotations

import http.server
import sys
import threading
import webbrowser
from typing import TYPE_CHECKING, Any, overload

from contactvi.inputs import flag
from contactvi.keywords import check_keywords, with_keywords
from contactvi.playback.live import LiveView
from contactvi.playback.live_frames import Stepped
from contactvi.playback.notebook import inline
from contactvi.playback.page import Run, fill_page, page_data, write_html

if TYPE_CHECKING:
    from typing_extensions import TypeIs


@overload
def view(run: Run, *, open_browser: bool | None = None, **options: Any) -> View: ...
@overload
def view(
    run: Stepped, *, open_browser: bool | None = None, realtime: bool | float = False, **options: Any
) -> LiveView: ...
@with_keywords(write_html, LiveView, skip=["path", "overwrite"])
def view(run: Run | Stepped, *, open_browser: bool | None = None, **options: Any) -> View | LiveView:
    """Serve the playback of a run, or the live view of a simulator, and open it in the browser; return at once.

    Args:
        run: a Trajectory, or a Simulator that has been reset.
        open_browser: open a browser window; None: yes, but not in a notebook, where the result shows itself as the last
            line of a cell. The address is printed, but not in a notebook.
        **options: as of `Trajectory.to_html`; fps and play of a Trajectory alone, and of a Simulator alone
            realtime.

    In a notebook the playback of a run is put into the cell whole: nothing is served, and no address is printed, unless
    open_browser=True. Elsewhere the page is served while this process lives; a script that would end right away calls
    `.wait()` on the result. For a file that needs no process, use `Trajectory.to_html`.

    A simulator is shown while it runs, at each call of `sync`, at most 60 times a second::

        with cvi.view(sim, realtime=True) as live:
            while live.is_open and sim.t < 10.0:
                sim.step()
                live.sync()

    The simulator is the loop's: while it steps, reading its t, q or v in another thread raises a SimulationError. What
    another thread is to see the loop stores for it after a step.

    Raises:
        InputError: for what cannot be shown, and options that are unknown or not usable.
        SimulationError: for a simulator without a state.
    """
    opened = not _in_notebook() if open_browser is None else flag("open_browser", open_browser)
    shown: View | LiveView
    if _is_stepped(run):
        check_keywords(LiveView, options, "The live view")
        shown = LiveView(run, **options)
    else:
        check_keywords(write_html, options, "The view of a run", skip=["overwrite"])
        shown = View(page_data(run, **options))
    kind = "Live view" if isinstance(shown, LiveView) else "Playback"
    if opened or isinstance(shown, LiveView) or not _in_notebook():
        print(f"{kind} at {shown.url}", flush=True)  # at once into a pipe, too
    if opened:
        webbrowser.open(shown.url, new=2)
    return shown


def _in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    interactive = sys.modules.get("IPython")
    return interactive is not None and hasattr(interactive.get_ipython(), "kernel")


def _is_stepped(run: Run | Stepped) -> TypeIs[Stepped]:
    return hasattr(type(run), "recent")


class View:
    """A playback. It is served at `url` from the moment on at which that is asked for; a cell shows it without."""

    def __init__(self, data: dict[str, Any]) -> None:
        self._data = data
        self._server: http.server.ThreadingHTTPServer | None = None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Address of the page, which is served from now on; after `close` at another one."""
        if self._server is None:
            page = fill_page(self._data).encode("utf-8")
            self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _handler(page))
            self._server.daemon_threads = True
            self._thread = threading.Thread(target=self._server.serve_forever, name="contactvi-view", daemon=True)
            self._thread.start()
        return f"http://127.0.0.1:{self._server.server_address[1]}/"

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        try:
            while self._thread is not None and self._thread.is_alive():
                self._thread.join(0.2)
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop serving."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    def __repr__(self) -> str:
        return "<View>" if self._server is None else f"<View at {self.url}>"

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
