"""What an appearance draws of an episode, in the scene and in the picture."""

from __future__ import annotations

import numpy as np
import pytest

from tsjepa.plants import Appearance, CartPole, Mixed, Pendulum, build_plant, describe_plant
from tsjepa.plants.appearance import Surroundings

ALL = Appearance(colors=True, light=(0.6, 1.4), shift_pixels=(2.0, 5.0), distractors=3, occluder_pixels=6)
DEVICE, EPISODE = np.arange(40), np.zeros(40, np.int64)
PLAIN = CartPole()
STATES = PLAIN.start(0, DEVICE, EPISODE)


def pictures(appearance: Appearance, physics: np.ndarray = STATES, seed: int = 0) -> np.ndarray:
    plant = CartPole(appearance=appearance)
    return plant.render(plant.scene(physics, seed, DEVICE, EPISODE)).astype(int)


def drawn(around: Surroundings, qpos: np.ndarray) -> np.ndarray:
    return PLAIN.renderer.render(qpos, None, around).astype(int)


def test_an_appearance_that_draws_nothing_changes_neither_scene_nor_picture():
    scene = PLAIN.scene(STATES, 0, DEVICE, EPISODE)
    same = CartPole(appearance=Appearance()).scene(STATES, 0, DEVICE, EPISODE)
    np.testing.assert_array_equal(same, scene)
    before = PLAIN.render(scene)
    pictures(ALL)
    drawn(ALL.surroundings(ALL.draw(0, DEVICE, EPISODE)[0], 128, 64), STATES[:1, :2])
    np.testing.assert_array_equal(PLAIN.render(scene), before)  # after others have been in the same scene


def test_colours_are_those_of_random_colors():
    ours, theirs = CartPole(appearance=Appearance(colors=True)), CartPole(random_colors=True)
    np.testing.assert_array_equal(
        ours.scene(STATES, 4, DEVICE, EPISODE + 1), theirs.scene(STATES, 4, DEVICE, EPISODE + 1)
    )


def test_what_is_drawn_depends_on_seed_device_and_episode_and_stays_for_an_episode():
    plant = CartPole(appearance=ALL)

    def look(seed: int, device: int, episode: int, physics: np.ndarray = STATES[:1]) -> np.ndarray:
        return plant.scene(physics, seed, np.array([device]), np.array([episode]))[0, 2:]

    first = look(0, 3, 1)
    np.testing.assert_array_equal(look(0, 3, 1, STATES[7:8]), first)
    for other in (look(1, 3, 1), look(0, 4, 1), look(0, 3, 2)):
        assert (other != first).all()
    np.testing.assert_array_equal(plant.scene(STATES, 0, DEVICE, EPISODE + 1)[3, 2:], first)


def test_every_number_fills_its_range():
    numbers = ALL.draw(0, np.arange(4000), np.zeros(4000, np.int64))
    low, high = numbers.min(0), numbers.max(0)
    np.testing.assert_allclose(low[:3], (0.6, -2.0, -5.0), atol=0.01)
    np.testing.assert_allclose(high[:3], (1.4, 2.0, 5.0), atol=0.01)
    for box in range(3):
        centre, size, angle, color = np.split(slice_of(box), (2, 4, 5))
        np.testing.assert_allclose((low[centre], high[centre]), ([0, 0], [1, 1]), atol=0.01)
        np.testing.assert_allclose((low[size], high[size]), ([0.03, 0.03], [0.3, 0.3]), atol=0.01)
        np.testing.assert_allclose((low[angle], high[angle]), ([0], [np.pi]), atol=0.01)
        np.testing.assert_allclose((low[color], high[color]), ([0.25] * 3, [1] * 3), atol=0.01)


def slice_of(box: int) -> np.ndarray:
    return 3 + 8 * box + np.arange(8)


def test_the_headlights_factor_makes_pictures_darker_and_no_light_leaves_the_fixed_lamp():
    still = STATES[:5, :2]
    sums = [drawn(Surroundings(light=factor), still).sum() for factor in (0.0, 0.5, 1.0)]
    assert sums[0] < 0.6 * sums[1] < 0.6 * sums[2]
    np.testing.assert_array_equal(drawn(Surroundings(), still), PLAIN.renderer.render(still))


def test_a_shift_moves_the_whole_picture():
    still = STATES[:5, :2]
    plain, moved = drawn(Surroundings(), still), drawn(Surroundings(shift=(3.0, 2.0)), still)
    # to the right, and up, where row 0 is the top
    difference = np.abs(moved[:, :-2, 3:] - plain[:, 2:, :-3])
    # a vertex is rounded to 1/256 of a pixel, which turns one of an edge's samples now and then
    assert (difference > 0).mean() < 0.01 and difference.mean() < 0.02
    half = drawn(Surroundings(shift=(0.5, 0.0)), still)
    assert (half != plain).any() and (half != drawn(Surroundings(shift=(1.0, 0.0)), still)).any()


def test_a_distractor_stands_where_it_says_behind_what_moves():
    middle = Surroundings(distractors=((0.0, 0.0, 0.25, 0.5, 0.0, 1.0, 0.0, 0.0),))
    alone = drawn(middle, np.array([[50.0, 0.0]]))[0] - drawn(Surroundings(), np.array([[50.0, 0.0]]))[0]
    rows, columns = np.nonzero(alone[..., 0] > 100)
    # the mean of the camera's two eyes, from which MuJoCo draws, is less than a pixel beside the lens
    np.testing.assert_allclose((rows.min(), rows.max(), columns.min(), columns.max()), (16, 47, 55.5, 70.5), atol=0.5)
    turned = Surroundings(distractors=((0.0, 0.0, 0.25, 0.5, np.pi / 2, 1.0, 0.0, 0.0),))
    rows, columns = np.nonzero(drawn(turned, np.array([[50.0, 0.0]]))[0, ..., 0] > 100)
    assert rows.max() + 1 - rows.min() == 16 and columns.max() + 1 - columns.min() in (32, 33)
    # the cart before it shows as it would without it; inside its edges no pixel is mixed with what is behind
    plain, behind = (drawn(around, np.array([[0.0, 0.0]]))[0] for around in (Surroundings(), middle))
    cart = plain[..., 2] > 100
    inside = cart[1:-1, 1:-1] & cart[2:, 1:-1] & cart[:-2, 1:-1] & cart[1:-1, 2:] & cart[1:-1, :-2]
    assert inside.sum() > 20
    np.testing.assert_array_equal(plain[1:-1, 1:-1][inside], behind[1:-1, 1:-1][inside])


def test_an_occluder_fits_into_the_frame():
    wide = Appearance(occluder_pixels=150)
    with pytest.raises(ValueError, match="occluder_pixels is 150; the frame is 128 pixels wide"):
        wide.surroundings(wide.draw(0, DEVICE, EPISODE)[0], 128, 64)


def test_an_occluder_hides_what_is_behind_it():
    frames = pictures(Appearance(occluder_pixels=10))
    same = (frames == frames[:, :1]).all((1, 3))  # columns of one colour from top to bottom
    for row, numbers in enumerate(Appearance(occluder_pixels=10).draw(0, DEVICE, EPISODE)):
        left = round(numbers[3] * 118)
        assert same[row, left : left + 10].all()
        np.testing.assert_array_equal(frames[row, 0, left], np.round(255 * numbers[4:].astype(np.float32)))


def test_pictures_are_a_function_of_the_scene_alone():
    plant = CartPole(appearance=ALL)
    scene = plant.scene(STATES, 0, DEVICE, EPISODE)
    frames = plant.render(scene)
    np.testing.assert_array_equal(plant.render(scene[::-1])[::-1], frames)
    np.testing.assert_array_equal(CartPole(appearance=ALL).render(scene[5:6])[0], frames[5])
    assert (frames[1:] != frames[:-1]).any((1, 2, 3)).all()


def test_more_appearances_than_backgrounds_are_kept(monkeypatch):
    monkeypatch.setattr("tsjepa.plants.renderer.BACKGROUNDS", 3)
    plant = CartPole(appearance=ALL)
    scene = plant.scene(STATES[:10], 0, DEVICE[:10], EPISODE[:10])
    frames = plant.render(scene)
    assert len(plant.renderer._backgrounds) == 3
    np.testing.assert_array_equal(plant.render(scene), frames)


def test_a_plant_with_an_appearance_is_stored_and_built_again():
    plant = Pendulum(appearance=ALL)
    again = build_plant(describe_plant(plant))
    assert again.appearance == ALL
    plain = build_plant(describe_plant(plant), appearance=None)
    physics = plain.start(0, DEVICE, EPISODE)
    np.testing.assert_array_equal(
        plain.scene(physics, 0, DEVICE, EPISODE), Pendulum().scene(physics, 0, DEVICE, EPISODE)
    )


def test_kinds_of_a_mixed_fleet_look_each_in_their_own_way():
    mixed = Mixed([CartPole(appearance=ALL), CartPole(pole_length=0.5, appearance=ALL)])
    physics = mixed.start(0, DEVICE, EPISODE)
    pictured = mixed.render(mixed.scene(physics, 0, DEVICE, EPISODE))
    own = mixed.plants[1]
    scenes = own.scene(physics[1::2, :-1], 0, DEVICE[1::2], EPISODE[1::2])
    np.testing.assert_array_equal(pictured[1::2], own.render(scenes))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"light": (1.2, 0.8)}, r"light\[1\] is 0.8"),
        ({"light": (-0.1, 0.8)}, r"light\[0\] is -0.1"),
        ({"shift_pixels": (0.0, -1.0)}, r"shift_pixels\[1\] is -1"),
        ({"distractors": 17}, "distractors is 17"),
        ({"occluder_pixels": -1}, "occluder_pixels is -1"),
    ],
)
def test_an_impossible_appearance_is_refused(arguments, named):
    with pytest.raises(ValueError, match=named):
        Appearance(**arguments)
