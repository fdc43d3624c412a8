"""Where the tiles are and what they show."""

from dataclasses import replace

import numpy as np
import pytest

from tsjepa.evaluation.fleet_film import DELIVERED, FAILED, GOOD, LOST, SILENT
from tsjepa.watch.setting import Setting, Snapshot
from tsjepa.watch.tiles import BORDER, CAPTION, UNKNOWN, WIDTH, Layout, tiles

COUNT = 5
NOW = Snapshot(
    setting=Setting(COUNT, 10.0, 0.0, "max_age", "fp32"),
    slot=0,
    pace=1.0,
    complaint="",
    scenes=np.zeros((COUNT, 1), np.float32),
    beliefs=np.zeros((COUNT, 2), np.float32),
    heard=np.array([True, False, True, True, True]),
    sent=np.array([True, True, False, False, False]),
    delivered=np.array([True, False, False, False, False]),
    age=np.arange(COUNT),
    score=np.array([1.0, 0.5, 0.0, 0.0, 0.0], np.float32),
    failed=np.array([False, False, False, False, True]),
    bit_rate=0.0,
)
CAMERA = np.full((COUNT, 64, 128, 3), (200, 10, 20), np.uint8)
BELIEF = np.full((COUNT, 64, 128, 3), (20, 10, 200), np.uint8)


@pytest.mark.parametrize(
    ("count", "frame", "believes"), [(1, (64, 128), True), (24, (64, 64), False), (7, (9, 4), True)]
)
def test_a_point_in_a_tile_is_its_devices(count, frame, believes):
    layout = Layout(count, frame, believes)
    for device in range(count):
        top, left = layout.corner(device)
        assert layout.device_at(left, top) == device
        assert layout.device_at(left + layout.width - 1, top + layout.height - 1) == device
    height, width = layout.size()
    assert layout.device_at(width, 0) is None
    assert layout.device_at(0, height) is None
    assert layout.device_at(-1, -1) is None
    last = layout.corner(count - 1)
    assert last[0] < height
    assert layout.device_at(last[1] + layout.width, last[0]) is None


def test_camera_and_belief_stand_side_by_side_in_their_colours():
    picture, layout = tiles(NOW, CAMERA, BELIEF), Layout(COUNT, (64, 128), True)
    assert picture.shape[:2] == layout.size()
    top, left = layout.corner(0)
    middle = top + CAPTION + BORDER + layout.picture[0] // 2
    assert picture[middle, left + BORDER + WIDTH // 2].tolist() == [20, 10, 200]  # BGR
    assert picture[middle, left + BORDER + WIDTH + WIDTH // 2].tolist() == [200, 10, 20]


def test_a_belief_is_shown_once_the_device_was_heard():
    picture, layout = tiles(NOW, CAMERA, BELIEF), Layout(COUNT, (64, 128), True)
    top, left = layout.corner(1)
    assert picture[top + CAPTION + BORDER + 5, left + BORDER + WIDTH + 5].tolist() == list(UNKNOWN)


def test_the_border_says_what_became_of_an_update_and_the_caption_who_has_failed():
    picture, layout = tiles(NOW, CAMERA, BELIEF), Layout(COUNT, (64, 128), True)
    corners = [layout.corner(device) for device in range(COUNT)]
    borders = [picture[top + CAPTION + 1, left + 40].tolist() for top, left in corners]
    assert borders == [list(DELIVERED), list(LOST), *[list(SILENT)] * 3]
    captions = [picture[top + 2, left + 2].tolist() for top, left in corners]
    assert captions == [[255, 255, 255]] * 4 + [list(FAILED)]


def test_the_bar_is_as_long_as_the_score():
    layout = Layout(COUNT, (64, 128), True)

    def bar(score: float) -> int:
        scores = np.array([score, 0, 0, 0, 0])
        picture = tiles(replace(NOW, score=scores), CAMERA, BELIEF)
        return int((picture[10, : layout.width] == GOOD).all(-1).sum())

    assert bar(0.0) == 0
    assert bar(1.0) > 50
    assert bar(0.5) == pytest.approx(bar(1.0) / 2, abs=1)


def test_without_beliefs_there_is_the_camera_alone():
    assert tiles(replace(NOW, beliefs=None), CAMERA, None).shape[:2] == Layout(COUNT, (64, 128), False).size()
