"""A device runs where there is neither torch nor anything that stands on it."""

import itertools
import json
import subprocess
import sys

import cv2
import numpy as np
import pytest

from tsjepa.live.controller_loop import Controller
from tsjepa.live.graphs import Graphs
from tsjepa.live.seal import Seal

ABSENT = ("torch", "torchrl", "tensordict", "lightning", "mujoco", "dm_control", "scipy", "matplotlib", "wandb")
PROGRAM = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {absent}:
            raise ModuleNotFoundError("No module named " + name, name=name.split(".")[0])
sys.meta_path.insert(0, Absent())
from tsjepa.cli import main
status = main(sys.argv[1:])
assert not [name for name in {absent} if name in sys.modules]
sys.exit(status)
"""


def run(*arguments: object) -> subprocess.Popen:
    command = [sys.executable, "-c", PROGRAM.format(absent=ABSENT), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def film(tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter_fourcc(*"FFV1"), 50, (128, 64))
    for level in range(40):
        writer.write(np.full((64, 128, 3), 5 * level, np.uint8))
    writer.release()
    return tmp_path / "film.avi"


@pytest.mark.slow
def test_a_device_with_a_camera_sends_what_its_graph_makes_of_the_film(deployed, film, tmp_path):
    graphs = Graphs(str(deployed), ["device", "receive", "predict"], ())
    controller, payloads = Controller(graphs, 1, ("127.0.0.1", 0), Seal()), []
    receive = graphs.receive
    graphs.receive = lambda payload: (payloads.append(payload[0].tolist()), receive(payload))[1]
    options = ["--camera", film, "--slots", 30, "--report", tmp_path / "d.json", "--realtime_factor", 0.25]
    address = f"127.0.0.1:{controller.port.address[1]}"
    child = run("device", deployed, "--controller", address, *options)
    while child.poll() is None:
        controller.port.drain()
        controller.predict()
    output, errors = child.communicate()
    controller.port.socket.close()
    assert child.returncode == 0, output + errors
    report = json.loads((tmp_path / "d.json").read_text())
    assert report["updates"]["sent"] >= 10 and report["commands"]["received"] >= 1
    levels = [np.full((64, 128, 3), 5 * level, np.uint8) for level in range(40)]
    possible = graphs.encode(np.stack([np.stack([old, new]) for old, new in itertools.pairwise(levels)]))
    assert len(payloads) >= 10
    assert [payload for payload in payloads if payload not in possible.tolist()] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "sentence"),
    [([], "give a camera, or install all of tsjepa"), (["--loss", "0.1", "--camera", "0"], "with `tc netem`")],
)
def test_what_needs_torch_says_so(deployed, options, sentence):
    child = run("device", deployed, *options)
    _, errors = child.communicate()
    assert child.returncode == 1
    assert errors.count("\n") == 1 and sentence in errors


@pytest.mark.slow
def test_a_controller_needs_no_torch_either(deployed):
    child = run("controller", deployed, "--bind", "127.0.0.1:0", "--seconds", "0")
    output, errors = child.communicate()
    assert child.returncode == 0, errors
    assert "0 devices" in output
