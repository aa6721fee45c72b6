"""Make the README's picture, docs/hand_and_ball.gif and .png: a ball falls into the Allegro hand.

    python docs/picture.py

Runs models/allegro_ball.toml and draws its playback page in headless Chromium (Debian: chromium, chromium-driver) from
a camera of its own. Needs the packages of `pip install contactvi[test]` and Pillow, which comes with matplotlib.
"""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

import contactvi as cvi

ROOT = Path(__file__).resolve().parents[1]
SIZE = 480, 360  # of the pictures [pixels]
SHOWN = 0.1, 1.1  # [s] of the run: from when the ball comes into view until it is nearly at rest
FRAMES = 40
SLOWER = 2.5  # than the run
STILL = 0.45  # [s] time of the picture that stands
COLORS = 200
ARROWS = (230, 60, 30), (25, 75, 190), (255, 150, 30)  # of impacts, forces and points, as they are drawn

# Where the camera looks, from which side (in the world's frame, z up), from how far [m], with which opening [deg].
TARGET, SIDE, DISTANCE, OPENING = (0.005, 0.0, 0.044), (0.55, -0.8, 0.55), 0.62, 17.5

# Software rendering: WebGL is needed, and a machine that makes documents may have no graphics card.
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-dev-shm-usage",
         "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader",
         "--enable-unsafe-swiftshader", "--window-size=1000,900")  # fmt: skip

CAMERA = """
const [target, side, distance, opening, width, height] = arguments;
for (const panel of document.querySelectorAll(".panel, .dg")) { panel.style.display = "none"; }
const pane = document.getElementById("meshcat-pane");
pane.style.width = width + "px";
pane.style.height = height + "px";
pause();
viewer.camera.fov = opening;
viewer.camera.position.set(...shown(...target.map((x, k) => x + distance * side[k])));
viewer.camera.updateProjectionMatrix();
viewer.controls.target.set(...shown(...target));
viewer.controls.update();
viewer.set_3d_pane_size(width, height);
// The hand's meshes are nearly black: more light than the page gives, from the camera's side.
at(["Lights", "AmbientLight", "<object>"]).intensity = 0.75;
at(["Lights", "FillLight", "<object>"]).intensity = 0.5;
for (const name of ["PointLightNegativeX", "PointLightPositiveX"]) {
  at(["Lights", name, "<object>"]).intensity = 0.4;
}
"""
DRAW = """
const done = arguments[1];
seek(arguments[0]);
viewer.set_dirty();
requestAnimationFrame(() => requestAnimationFrame(() => done(true)));
"""


def main() -> None:
    traj = cvi.simulate(cvi.load_scene(ROOT / "models" / "allegro_ball.toml"), duration=SHOWN[1])
    with tempfile.TemporaryDirectory() as folder:
        page = traj.to_html(Path(folder) / "playback.html", fps=200.0, play=False, forces=True)
        browser = start(folder)
        try:
            browser.get(page.as_uri())
            side = np.array(SIDE) / np.linalg.norm(SIDE)
            # Drawn at twice the size and scaled down, which smooths the edges.
            browser.execute_script(CAMERA, TARGET, side.tolist(), DISTANCE, OPENING, *(2 * size for size in SIZE))
            frames = [picture(browser, time) for time in np.linspace(*SHOWN, FRAMES)]
            still = picture(browser, STILL)
        finally:
            browser.quit()
    still.save(ROOT / "docs" / "hand_and_ball.png", optimize=True)
    # One palette for all frames, so that what stands still does not flicker and takes no space.
    palette = sample(frames[::4]).quantize(COLORS)
    first, *others = (frame.quantize(COLORS, palette=palette, dither=Image.Dither.NONE) for frame in frames)
    length = 1000 * SLOWER * (SHOWN[1] - SHOWN[0]) / (FRAMES - 1)  # [ms]
    first.save(
        ROOT / "docs" / "hand_and_ball.gif",
        save_all=True,
        append_images=others,
        duration=[length] * (FRAMES - 1) + [1200],
        loop=0,
        optimize=True,
    )


def sample(frames: list[Image.Image]) -> Image.Image:
    """Return frames below each other, with a block of each colour of the arrows: they are too small to count alone."""
    width, height = SIZE
    sheet = Image.new("RGB", (width, height * (len(frames) + 1)))
    for k, frame in enumerate(frames):
        sheet.paste(frame, (0, height * k))
    colors = [tuple(int(shade * x) for x in color) for color in ARROWS for shade in (0.7, 0.85, 1.0)]
    for k, color in enumerate(colors):
        step = height // len(colors)
        sheet.paste(color, (0, height * len(frames) + step * k, width, height * len(frames) + step * (k + 1)))
    return sheet


def start(folder: str) -> webdriver.Chrome:
    """Return a browser with a profile of its own in `folder`."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in (*FLAGS, f"--user-data-dir={folder}/profile"):
        options.add_argument(flag)
    browser = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    browser.set_script_timeout(120)
    return browser


def picture(browser: webdriver.Chrome, time: float) -> Image.Image:
    """Return what the page shows at a time of the run [s]."""
    browser.execute_async_script(DRAW, float(time))
    shot = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")
    return shot.crop((0, 0, 2 * SIZE[0], 2 * SIZE[1])).resize(SIZE, Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
