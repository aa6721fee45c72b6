"""What tests do on a page of the playback in a browser."""

from __future__ import annotations

# Calls back with the time shown once the condition holds, at the latest after 20 s.
POLL = """
const done = arguments[arguments.length - 1], holds = new Function("return " + arguments[0]), start = performance.now();
(function poll() {
    if (holds() || performance.now() - start > 20000) done(player.time); else setTimeout(poll, 20);
})();
"""


def errors(browser) -> list[str]:
    """Return warnings and errors of the console, without remarks about the speed of software rendering."""
    entries = browser.get_log("browser")
    return [
        entry["message"]
        for entry in entries
        if entry["level"] in {"SEVERE", "WARNING"} and "GPU stall" not in entry["message"]
    ]


def set_slider(browser, time: float) -> None:
    """Move the page's slider as a user does: its value changes, with an input event."""
    slider = browser.find_element("id", "time")
    browser.execute_script(
        "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'));", slider, time
    )


def press(browser, key: str, shift: bool = False) -> None:
    browser.execute_script(
        "document.dispatchEvent(new KeyboardEvent('keydown', {key: arguments[0], shiftKey: arguments[1]}));", key, shift
    )
