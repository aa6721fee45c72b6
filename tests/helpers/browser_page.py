"""What tests do on a page of the playback in a browser."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from selenium.webdriver.support.ui import WebDriverWait

import contactvi as cvi

# Calls back with the time shown once the condition holds, at the latest after 20 s.
POLL = """
const done = arguments[arguments.length - 1], holds = new Function("return " + arguments[0]), start = performance.now();
(function poll() {
    if (holds() || performance.now() - start > 20000) done(player.time); else setTimeout(poll, 20);
})();
"""

SET = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'));"


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


def open_page(browser, traj: cvi.Trajectory, folder: Path, **options) -> None:
    browser.get(traj.to_html(folder / "playback.html", overwrite=True, **options).as_uri())
    # A busy browser may come back before the scripts of the page have run: a key that is pressed then is lost.
    WebDriverWait(browser, 20.0).until(
        lambda _: browser.execute_script("return document.readyState === 'complete' && typeof panels === 'object'")
    )


def time_of(browser) -> float:
    return browser.execute_script("return player.time")


def camera_of(browser) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target of the camera [m]."""
    found = browser.execute_script("return [stage.camera.position.toArray(), orbit.target.toArray()]")
    return np.array(found[0]), np.array(found[1])


def is_color(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Where a picture (height, width, 3) has a colour."""
    return np.abs(image - color).max(axis=2) < 25


def picture(browser, path: Path) -> np.ndarray:
    """What is on the screen after the next drawn frame, shape (height, width, 3), also written to `path`."""
    from PIL import Image

    browser.execute_async_script(
        "const done = arguments[0]; stage.draw();requestAnimationFrame(() => requestAnimationFrame(() => done(true)));"
    )
    data = browser.get_screenshot_as_png()
    path.write_bytes(data)
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def type_speed(browser, text: str) -> None:
    browser.execute_script(SET, browser.find_element("id", "speed"), text)
