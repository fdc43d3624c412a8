"""The renderer: determinism, geometry, colours and its errors."""

from __future__ import annotations

import itertools
import pickle
import subprocess
import sys

import numpy as np
import pytest

from tsjepa.plants import CartPole, DoubleCartPole, Pendulum, Reacher
from tsjepa.plants import renderer as camera
from tsjepa.plants.renderer import Renderer

RED = np.array([[[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])


def make(height: int = 64, width: int = 128) -> Renderer:
    plant = CartPole()
    return Renderer(plant.model, plant.view, height, width)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return make()


def moving_parts(renderer: Renderer, x: float, theta: float) -> np.ndarray:
    """Weight [H, W] of cart and pole in a frame: painted red, while the rail is mostly blue."""
    frame = renderer.render(np.array([[x, theta]]), RED)[0].astype(float)
    return np.clip(frame[..., 0] - frame[..., 2], 0, None)


def centroid(weight: np.ndarray) -> np.ndarray:
    """(row, column) of the centre of a weight [H, W]."""
    return np.array([(weight * index).sum() / weight.sum() for index in np.indices(weight.shape)])


def test_frames_are_a_function_of_qpos(renderer):
    qpos = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 2))
    frames = renderer.render(qpos)
    assert frames.shape == (5, 64, 128, 3) and frames.dtype == np.uint8
    np.testing.assert_array_equal(renderer.render(qpos[::-1])[::-1], frames)
    np.testing.assert_array_equal(make().render(qpos[2:3])[0], frames[2])
    np.testing.assert_array_equal(renderer.render(qpos.astype(np.float32)[2:3])[0], frames[2])


def test_rendering_only_around_the_moving_parts_gives_the_whole_picture(renderer, monkeypatch):
    generator = np.random.default_rng(0)
    # past the edges of the picture too
    qpos = np.stack((generator.uniform(-2.5, 2.5, 200), generator.uniform(-0.8, 0.8, 200)), axis=1)
    colors = generator.uniform(0, 1, (200, 2, 3))
    frames = renderer.render(qpos, colors).astype(int)
    monkeypatch.setattr(camera, "rectangles", lambda *_: np.tile([0, 0, 128, 64], (200, 1)))
    difference = np.abs(frames - renderer.render(qpos, colors))
    # a frustum of its own rounds a vertex by up to 1/256 of a pixel, which now and then turns one of an edge's samples
    assert (difference > 0).mean() < 3e-4 and difference.mean() < 0.005


@pytest.mark.parametrize("kind", [DoubleCartPole, Pendulum, Reacher])
def test_nothing_of_what_moves_is_cut_off(kind, monkeypatch):
    plant = kind()
    poses = np.random.default_rng(0).uniform(-1, 1, (100, plant.model.nq)) * 2.5
    frames = plant.renderer.render(poses).astype(int)
    whole = [0, 0, *plant.spec.frame[::-1]]
    monkeypatch.setattr(camera, "rectangles", lambda *_: np.tile(whole, (100, 1)))
    difference = np.abs(frames - plant.renderer.render(poses))
    assert (
        difference.max() < 30 and difference.mean() < 0.002
    )  # a part that is cut off differs by its colour, 100 or more
    assert (frames.std((1, 2, 3)) > 5).all()


def test_where_nothing_moves_there_is_only_background(renderer):
    far = renderer.render(np.array([[50.0, 0.0], [-50.0, 0.3]]), np.array([RED[0], 1 - RED[0]]))
    np.testing.assert_array_equal(far[0], far[1])


def test_returned_frames_are_not_overwritten(renderer):
    first = renderer.render(np.zeros((1, 2)))
    kept = first.copy()
    renderer.render(np.ones((1, 2)))
    np.testing.assert_array_equal(first, kept)


def test_cart_moving_right_moves_pixels_right(renderer):
    columns = [centroid(moving_parts(renderer, x, 0.0))[1] for x in (-1.0, -0.1, 0.0, 0.1, 1.0)]
    assert (np.diff(columns) > 0).all()


def test_positive_angle_leans_the_pole_right(renderer):
    upper = [centroid(moving_parts(renderer, 0.0, theta)[:30])[1] for theta in (-0.3, 0.0, 0.3)]
    assert (np.diff(upper) > 3).all()


def test_pole_is_above_the_cart(renderer):
    frame = renderer.render(np.zeros((1, 2)), np.array([[[1.0, 0, 0], [0, 1.0, 0]]]))[0].astype(float)
    cart, pole = (np.clip(frame[..., part] - frame[..., 2], 0, None) for part in (0, 1))
    assert centroid(pole)[0] < centroid(cart)[0] - 10


@pytest.mark.parametrize(("x", "theta"), [*itertools.product((-1.3, 1.3), (-0.35, 0.0, 0.35))])
def test_cart_and_pole_are_wholly_visible(renderer, x, theta):
    weight = moving_parts(renderer, x, theta)
    border = np.concatenate([weight[0], weight[-1], weight[:, 0], weight[:, -1]])
    assert weight.max() > 100 and border.max() == 0


def test_a_millimetre_and_a_milliradian_show(renderer):
    still, shifted, leaned = renderer.render(np.array([[0.0, 0.0], [0.001, 0.0], [0.0, 0.001]]))
    assert (still != shifted).any() and (still != leaned).any()


def test_default_colors_are_restored(renderer):
    qpos = np.zeros((1, 2))
    plain = renderer.render(qpos)
    assert (renderer.render(qpos, RED) != plain).any()
    np.testing.assert_array_equal(renderer.render(qpos), plain)
    np.testing.assert_array_equal(renderer.render(qpos, CartPole().colors[None]), plain)


def test_another_size_and_no_rows(renderer):
    assert make(32, 48).render(np.zeros((1, 2))).shape == (1, 32, 48, 3)
    assert renderer.render(np.zeros((0, 2))).shape == (0, 64, 128, 3)


@pytest.mark.parametrize(
    ("qpos", "colors", "named"),
    [
        (np.zeros(2), None, r"\[N, 2\]"),
        (np.zeros((1, 4)), None, r"\[N, 2\]"),
        (np.array([[0.0, np.nan]]), None, "nan"),
        (np.zeros((2, 2)), RED, r"\[2, 2, 3\]"),
        (np.zeros((1, 2)), 2 * RED, r"\[0, 1\]"),
        (np.zeros((1, 2)), np.nan * RED, r"\[0, 1\]"),
    ],
)
def test_bad_input_is_refused(renderer, qpos, colors, named):
    with pytest.raises(ValueError, match=named):
        renderer.render(qpos, colors)


def test_metadata_says_how_frames_were_made(renderer):
    metadata = renderer.metadata()
    assert metadata["view"]["samples"] == 4 and metadata["view"]["supersampling"] == 2
    assert (metadata["height"], metadata["width"]) == (64, 128)
    assert metadata["gl_renderer"] and "SHADOW" in metadata["disabled_flags"]


def test_a_pickled_renderer_draws_the_same(renderer):
    qpos = np.array([[0.2, 0.1]])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(renderer)).render(qpos), renderer.render(qpos))


def test_without_a_backend_the_message_says_what_to_install(monkeypatch):
    def broken(width, height):
        raise ImportError("no display")

    monkeypatch.setattr("tsjepa.plants.renderer.context_class", lambda: broken)
    with pytest.raises(RuntimeError, match="install EGL"):
        make().render(np.zeros((1, 2)))


@pytest.mark.slow
def test_exit_is_silent():
    code = (
        "import numpy, tsjepa.envs; from tsjepa.plants import CartPole; "
        "[CartPole().renderer.render(numpy.zeros((1, 2))) for _ in range(2)]"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert finished.returncode == 0 and finished.stderr == ""
