"""Two processes and a signal: they find each other, survive each other, and end in order."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from tsjepa import cli
from tsjepa.live.controller import controller
from tsjepa.live.ending import check_report

SLOW = ["--realtime_factor", "0.25"]  # slots of 80 ms, so that a busy machine keeps up
PATIENCE_S = 120


def free_address() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


class Process:
    """A command of this package, ended with the test; ``within`` names a network namespace."""

    def __init__(self, *arguments: object, within: str | None = None) -> None:
        command = ["ip", "netns", "exec", within] if within else []
        command += [sys.executable, "-m", "tsjepa.cli", *map(str, arguments)]
        self.child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        self.child.kill()
        self.child.communicate()

    def end(self, number: int | None = None) -> tuple[int, str]:
        """Exit status and all that it said, after a signal."""
        if number is not None:
            self.child.send_signal(number)
        output, errors = self.child.communicate(timeout=PATIENCE_S)
        return self.child.returncode, output + errors


def until(condition, what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


def lines(path) -> int:
    return len(path.read_text().splitlines()) if path.exists() else 0


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_both_end_on_a_signal_with_a_report(deployed, tmp_path, number):
    address = free_address()
    options = ["--bind", address, "--report", tmp_path / "c.json", "--log", tmp_path / "log.csv"]
    with Process("controller", deployed, *options, *SLOW) as controller:
        options = ["--controller", address, "--report", tmp_path / "d.json", "--loss", "0.2"]
        with Process("device", deployed, *options, *SLOW) as device:
            until(lambda: lines(tmp_path / "log.csv") > 20, "no updates")
            status, said = device.end(number)
            assert status == 0 and "updates sent" in said
        status, said = controller.end(number)
        assert status == 0 and "updates used" in said and "1 session (a first hello" in said
    sent, heard = (json.loads((tmp_path / name).read_text()) for name in ("d.json", "c.json"))
    assert sent["updates"]["lost"] > 0
    arrived = sent["updates"]["sent"] - sent["updates"]["lost"]
    assert heard["counts"]["updates"] + heard["dropped"]["overtaken"] == arrived
    assert set(sent["stages"]) == {"capture", "encode", "send", "receive", "apply"}
    assert set(heard["stages"]) == {"receive", "send", "receive to command", "act", "predict"}
    assert sum(heard["age_slots"].values()) >= heard["counts"]["updates"]


@pytest.mark.slow
def test_a_killed_controller_comes_back_to_a_device_that_went_safe(deployed, tmp_path):
    address, report = free_address(), tmp_path / "d.json"
    (tmp_path / "key").write_text("5a" * 32)
    key = ["--key", tmp_path / "key", *SLOW]
    start = ["controller", deployed, "--bind", address, *key, "--log"]
    watched = ["device", deployed, "--controller", address, "--report", report, *key]
    with Process(*start, tmp_path / "first.csv") as first, Process(*watched) as device:
        until(lambda: lines(tmp_path / "first.csv") > 10, "no updates")
        first.end(signal.SIGKILL)
        time.sleep(2.5)  # the watchdog's 200 ms last 800 here
        with Process(*start, tmp_path / "second.csv") as second:
            until(lambda: lines(tmp_path / "second.csv") > 10, "no updates after the restart")
            assert device.end(signal.SIGTERM)[0] == 0
            assert second.end(signal.SIGTERM)[0] == 0
    said = json.loads(report.read_text())
    assert said["commands"]["safe"] >= 10
    assert said["commands"]["received"] >= 20


@pytest.mark.slow
def test_a_device_without_a_controller_says_so_waits_and_ends(deployed):
    address = free_address()
    with Process("device", deployed, "--controller", address, "--slots", 10) as device:
        told_too_late = threading.Timer(PATIENCE_S, device.child.kill)
        told_too_late.start()
        assert any(f"no command came from {address} in 1.5 s for device 0" in line for line in device.child.stderr)
        told_too_late.cancel()
        assert device.child.poll() is None
        status, said = device.end(signal.SIGTERM)
    assert status == 0
    assert f"no command came from {address} in the whole run for device 0" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["device", "nowhere"], "is no deployment: make one with `tsjepa deploy MODEL nowhere`"),
        (["device", "GRAPHS", "--controller", "here"], "write HOST:PORT"),
        (["device", "GRAPHS", "--number", "65536"], "number is 65536"),
        (["device", "GRAPHS", "--loss", "2"], "loss is 2.0"),
        (["device", "GRAPHS", "--camera", "none.mp4"], "OpenCV opens no camera"),
        (["device", "GRAPHS", "--camera", "FILM", "--actuator", "os.system"], "add --trust"),
        (["device", "GRAPHS", "--camera", "FILM", "--num_devices", "2"], "is one device"),
        (["device", "GRAPHS", "--actuator", "my.function"], "The actuator my.function needs a camera"),
        (["device", "GRAPHS", "--episode_slots", "0"], "episode_slots is 0"),
        (["device", "GRAPHS", "--safe", "[30]"], "is not between"),
        (["device", "GRAPHS", "--realtime_factor", "0"], "have to be above 0"),
        (["device", "GRAPHS", "--report", "."], "report . is a folder"),
        (["controller", "GRAPHS", "--report", "."], "report . is a folder"),
        (["controller", "GRAPHS", "--buffer", "256"], "buffer is 256"),
        (["controller", "GRAPHS", "--reference", "[1.0]"], "takes 0 set-points"),
        (["controller", "GRAPHS", "--key", "FILM"], "holds no key"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(deployed, tmp_path, monkeypatch, capsys, arguments, sentence):
    import cv2

    monkeypatch.chdir(tmp_path)
    film = cv2.VideoWriter("film.avi", cv2.VideoWriter_fourcc(*"MJPG"), 50, (128, 64))
    film.write(np.zeros((64, 128, 3), np.uint8))
    film.release()
    named = {"GRAPHS": str(deployed), "FILM": "film.avi"}
    status = cli.main([named.get(argument, argument) for argument in arguments])
    said = capsys.readouterr().err
    assert status == 2
    assert said.count("\n") == 1 and sentence in said


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [{"bind": "nowhere"}, {"key": "no-such-key"}, {}, {"record": "run.mp4"}])
def test_a_controller_that_cannot_start_leaves_the_files_of_the_run_before(deployed, tmp_path, wrong):
    files = [tmp_path / "log.csv", tmp_path / "run.rrd"]
    for file in files:
        file.write_text("of the run before")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        bind = free_address() if "record" in wrong else f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises((ValueError, OSError)):
            controller(str(deployed), **{"bind": bind, "log": str(files[0]), "record": str(files[1])} | wrong)
    assert {file.read_text() for file in files} == {"of the run before"}
    assert sorted(tmp_path.iterdir()) == files


def test_a_report_that_could_not_be_written_is_refused_and_its_folder_is_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"file/report\.json cannot be written \(.*\): choose a folder"):
        check_report(str(tmp_path / "file" / "report.json"))
    check_report(str(tmp_path / "new" / "report.json"))
    assert not list((tmp_path / "new").iterdir())
