"""A film in the place of a camera, and a function in the place of an actuator."""

import cv2
import numpy as np
import pytest

from tsjepa.live import device as live_device
from tsjepa.live.camera import Camera, find_actuator
from tsjepa.support.trust import everything_trusted

FRAMES = 6


@pytest.fixture
def film(tmp_path):
    """A film without losses whose frame k is filled with 10 k + 5 red."""
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"FFV1"), 50, (64, 32))
    for frame in range(FRAMES):
        writer.write(np.full((32, 64, 3), (0, 0, 10 * frame + 5), np.uint8))
    writer.release()
    return path


def test_frames_come_oldest_first_in_red_green_blue_and_the_film_starts_again(film):
    camera = Camera(film, None, (32, 64), 2, 2)
    seen = [camera.look() for _ in range(8)]
    assert seen[0].shape == (1, 2, 32, 64, 3)
    red = [[int(frame[..., 0].mean().round()) for frame in stack[0]] for stack in seen]
    assert [new for _, new in red] == [15, 25, 35, 45, 55, 5, 15, 25]
    assert [old for old, _ in red] == [5, 5, 15, 25, 35, 45, 55, 5]
    assert not seen[0][..., 1:].any()
    camera.close()


def test_pictures_are_brought_to_the_models_size(film):
    camera = Camera(film, None, (16, 48), 1, 1)
    assert camera.look().shape == (1, 1, 16, 48, 3)
    assert camera.look().dtype == np.uint8
    camera.close()


def test_the_actuator_gets_the_command_and_may_fail(film, capsys):
    given = []
    camera = Camera(film, lambda command: given.append(command.tolist()), (32, 64), 1, 1)
    camera.act(np.float32([[1.5]]))
    assert given == [[1.5]]

    def drive(command):
        raise RuntimeError("the bus\nis off")

    camera.actuate = drive
    for _ in range(3):
        camera.act(np.float32([[2.5]]))
    assert camera.summary() == {"actuator_failures": 3, "camera_failures": 0}
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "drive raised RuntimeError: the bus is off (test_camera.py, line" in said
    camera.close()


class Blind:
    """Stands for OpenCV's camera; gives as many pictures as it is told."""

    def __init__(self, pictures: int) -> None:
        self.pictures, self.opened = pictures, True

    def isOpened(self):
        return self.opened

    def get(self, _):
        return 1.0  # a film, so that no thread reads it

    def set(self, *_):
        return False

    def read(self):
        self.pictures -= 1
        return (True, np.full((32, 64, 3), 9, np.uint8)) if self.pictures >= 0 else (False, None)

    def release(self):
        self.opened = False


def test_a_camera_that_gives_no_picture_any_more_is_told_of_once(monkeypatch, capsys):
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: Blind(2))
    camera = Camera("0", None, (32, 64), 1, 1)
    seen = [camera.look() for _ in range(4)]
    assert all((stack == 9).all() for stack in seen)
    assert camera.summary()["camera_failures"] == 3
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "the camera '0' gives no picture" in said


def test_a_camera_that_never_gives_a_picture_is_refused_and_let_go(monkeypatch):
    blind = Blind(0)
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: blind)
    with pytest.raises(FileNotFoundError, match="OpenCV opens '0' and gets no picture"):
        Camera("0", None, (32, 64), 1, 1)
    assert not blind.opened


def test_an_actuator_is_found_by_its_name_if_it_is_trusted(tmp_path, monkeypatch):
    (tmp_path / "own_broken.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    assert find_actuator(None) is None
    with pytest.raises(ValueError, match=r"The actuator math\.floor is not this package's own: add --trust"):
        find_actuator("math.floor")
    with everything_trusted():
        assert find_actuator("math.floor")(1.5) == 1
        for wrong in ("math.nothing", "no_such_module.f", "floor", "own_broken.act"):
            with pytest.raises(ValueError, match=rf"The actuator {wrong} cannot be imported"):
                find_actuator(wrong)
        with pytest.raises(ValueError, match=r"math.pi is no function: write package\.module\.function"):
            find_actuator("math.pi")


@pytest.fixture
def cameras(monkeypatch):
    """The cameras that ``tsjepa device`` has opened."""
    opened = []

    def camera(*arguments):
        opened.append(Camera(*arguments))
        return opened[-1]

    monkeypatch.setattr(live_device, "Camera", camera)
    return opened


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong", [{"controller": "nowhere"}, {"safe": [30.0]}, {"key": "no-such-key"}, {"report": "/"}]
)
def test_what_is_wrong_is_told_before_a_camera_is_opened_or_a_recording_begun(deployed, film, tmp_path, cameras, wrong):
    with pytest.raises((ValueError, FileNotFoundError, IsADirectoryError)):
        live_device.device(str(deployed), camera=film, record=str(tmp_path / "run.rrd"), **wrong)
    assert not cameras
    assert not list(tmp_path.glob("run.rrd*"))


@pytest.mark.slow
def test_a_camera_is_let_go_when_its_run_fails(deployed, film, cameras, monkeypatch):
    monkeypatch.setattr(live_device, "run_until_stopped", lambda work: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        live_device.device(str(deployed), camera=film)
    (camera,) = cameras
    assert not camera.video.isOpened()


@pytest.mark.slow
def test_the_last_lines_say_what_failed_and_that_no_command_came(deployed, film, cameras, monkeypatch, capsys):
    monkeypatch.setattr(live_device, "find_actuator", lambda path: lambda command: 1 / 0)
    monkeypatch.setattr(live_device, "run_until_stopped", lambda work: cameras[0].act(np.float32([[1]])))
    live_device.device(str(deployed), "127.0.0.1:9", number=4, camera=film, actuator="my.drive")
    said = capsys.readouterr()
    assert "0 datagrams dropped, 1 actuator failures; ms" in said.out
    last = said.err.splitlines()[-1]
    assert "no command came from 127.0.0.1:9 in the whole run for device 4 (datagrams sent there: 0)" in last
