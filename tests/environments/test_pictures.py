"""Render modes of the environments: pictures without a browser, the live view, films."""

from __future__ import annotations

import urllib.error
import urllib.request
import webbrowser

import gymnasium
import numpy as np
import pytest

import contactvi as cvi
import contactvi.gym
from contactvi.gym.environment import SceneEnv
from helpers.extras import extra

LEG = "contactvi/LegStand-v0"
ZERO = np.zeros(3, np.float32)


def test_pictures_show_the_state():
    env = gymnasium.make(LEG, render_mode="rgb_array", push=0.0)
    env.reset(seed=1)
    first = env.render()
    assert first.shape == (360, 480, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(env.render(), first)
    for _ in range(30):
        env.step(np.ones(3, np.float32))
    assert (env.render() != first).any(axis=2).mean() > 0.01
    env.reset(seed=1)
    np.testing.assert_array_equal(env.render(), first)


def test_the_size_of_pictures_is_chosen_before_the_first():
    env = contactvi.gym.LegStandEnv(render_mode="rgb_array")
    env.picture_size = 64, 32
    with pytest.raises(cvi.SimulationError, match="reset"):
        env.render()
    env.reset(seed=0)
    assert env.render().shape == (32, 64, 3)


def test_environments_in_threads_give_their_pictures():
    envs = contactvi.gym.make_vec(LEG, 2, render_mode="rgb_array")
    envs.reset(seed=0)
    pictures = envs.render()
    assert [picture.shape for picture in pictures] == [(360, 480, 3)] * 2
    envs.close()


def test_the_live_view_shows_an_episode(monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url, **how: opened.append(url))
    env = contactvi.gym.LegStandEnv(render_mode="human")
    env.reset(seed=0)
    env.step(ZERO)
    env.reset()
    env.step(ZERO)
    assert env.render() is None
    (url,) = opened  # one view for all episodes
    assert url in capsys.readouterr().out
    assert b"<html" in urllib.request.urlopen(url, timeout=10).read()
    env.close()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(url, timeout=10)
    env.close()


def test_the_live_view_shows_one_environment():
    with pytest.raises(cvi.InputError, match="Live views of many"):
        contactvi.gym.make_vec(LEG, 2, render_mode="human")


def test_gymnasium_records_a_film(tmp_path):
    extra("moviepy")
    imageio = extra("imageio")
    env = gymnasium.make(LEG, render_mode="rgb_array", duration=0.2, push=0.0)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path), name_prefix="leg", disable_logger=True)
    env.reset(seed=0)
    ended = False
    while not ended:
        _, _, terminated, truncated, _ = env.step(ZERO)
        ended = terminated or truncated
    env.close()
    (film,) = tmp_path.glob("leg*.mp4")
    frames = imageio.mimread(film, memtest=False)
    assert len(frames) in (10, 11)  # at the start, and after each of ten steps; the film's length rounds the last away
    assert frames[0].shape == (360, 480, 3)
    scene = env.unwrapped
    assert isinstance(scene, SceneEnv)
    scene.reset(seed=0)
    assert np.abs(frames[0].astype(float) - scene.render()).mean() < 4.0  # of 255: what H.264 loses
