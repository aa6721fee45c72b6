"""A headless Chromium, and a run of a ball, for the tests of the playback."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

import contactvi as cvi
from helpers.run_scenes import ball_scene

# Software rendering: three.js needs WebGL, a test machine has no graphics card. The rest keeps Chromium to itself.
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1280,800",
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in FLAGS:
        options.add_argument(flag)
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('chromium')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    driver.set_script_timeout(60)
    yield driver
    driver.quit()


@pytest.fixture(scope="session")
def ball() -> cvi.Trajectory:
    scene = ball_scene(restitution=0.8)
    v0 = scene.velocity({"ball": ((0.5, -0.2, 0.0), (0.0, 3.0, 7.0))})
    return cvi.simulate(scene, None, v0, duration=2.5, dt=1e-2)
