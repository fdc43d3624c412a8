"""Twenty videos and a table of commands become a model where neither MuJoCo nor dm_control is installed."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import recordings as make
import tiny

from tsjepa.data.collect import Split, collect
from tsjepa.data.storage import open_split
from tsjepa.models import entries
from tsjepa.plants import CartPole

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "recordings.md"
ABSENT = ("mujoco", "dm_control", "labmaze")
EPISODES, SLOTS = 20, 40
COMMANDS = [
    "import recording data/mine --action force_n --size null --slots 30",
    "fit --config recipes/jepa.yaml --config mine-jepa.yaml",
    "fit --config recipes/actor.yaml --config mine-actor.yaml",
    "predict --config recipes/actor.yaml --config mine-actor.yaml --ckpt_path last",
    "evaluate runs/mine-actor/model --data data/mine --output runs/evaluation",
    "deploy runs/mine-actor/model deployed",
]
PROGRAM = f"""
import importlib.util, sys
from tsjepa.cli import main

assert not any(importlib.util.find_spec(name) for name in {ABSENT})
for command in {COMMANDS}:
    assert main(command.split()) == 0, command
assert main(["evaluate", "tsjepa-cartpole", "--output", "none"]) != 0  # needs the plant
assert not any(name in sys.modules for name in {ABSENT})
"""


def packages_without(names: tuple[str, ...], folder: Path) -> Path:
    """A folder with links to all installed packages but these and what their distributions say of them."""
    folder.mkdir()
    for place in map(Path, sys.path):
        for package in place.iterdir() if place.name in ("site-packages", "dist-packages") else ():
            name = package.name.replace("-", "_")
            link = folder / package.name
            if not (name.startswith(names) or package.suffix == ".pth" or link.is_symlink()):
                link.symlink_to(package)
    return folder


def record(folder: Path) -> np.ndarray:
    """Writes 20 MP4 of the cart-pole and one CSV of its commands; returns the commands [20, 41]."""
    plant = CartPole()
    collect(str(folder / "collected"), plant, {"train": Split(EPISODES)}, slots=SLOTS)
    split = open_split(folder / "collected", "train")
    rows = {"video": [], "time_s": [], "force_n": []}
    for number, (pictures, force) in enumerate(zip(split["pixels"].numpy(), split["action"].numpy(), strict=True)):
        video = make.write_video(folder / f"recording/drive_{number}.mp4", pictures, round(1 / plant.spec.slot))
        rows["video"] += [video.name] * len(force)
        rows["time_s"] += [f"{row * plant.spec.slot:.3f}" for row in range(len(force))]
        rows["force_n"] += force[:, 0].tolist()
    make.write_csv(folder / "recording/commands.csv", rows)
    return split["action"][..., 0].numpy()


@pytest.mark.slow
@pytest.mark.skipif(not PAGE.exists(), reason="the docs are not part of this installation")
def test_a_recording_becomes_a_model_without_mujoco(tmp_path):
    force = record(tmp_path)
    for recipe in ("recipes/jepa.yaml", "recipes/actor.yaml"):
        tiny.write(tmp_path, recipe, tiny.shrink(tiny.load(recipe)))
    for block in re.findall(r"```yaml\n(# (mine-\w+\.yaml).*?)```", PAGE.read_text(), flags=re.DOTALL):
        (tmp_path / block[1]).write_text(re.sub(r"steps: \d+", "steps: 10", block[0]))
    packages = packages_without(ABSENT, tmp_path / "packages")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(packages), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-S", "-c", PROGRAM], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "tsjepa evaluate: the package mujoco is not installed" in done.stderr

    report = json.loads((tmp_path / "data/mine/import.json").read_text())
    assert report["episodes"] == EPISODES and report["skipped"] == []
    imported = open_split(tmp_path / "data/mine", "test")
    recorded = {row[first : first + 30].tobytes() for row in force for first in (0, SLOTS - 30)}
    assert {row.tobytes() for row in imported["action"][:, :-1, 0].numpy()} <= recorded
    result = json.loads((tmp_path / "runs/evaluation/evaluation.json").read_text())
    assert "closed_loop" not in result and result["open_loop"]["command_nmae_to"] == "action"
    assert np.isfinite(list(result["open_loop"]["skill_over_copying"].values())).all()
    model = entries.load(tmp_path / "runs/mine-actor/model")
    assert model.plant is None and model.probe is None
    with np.load(tmp_path / "runs/mine-actor/predictions.npz") as predictions:
        embedding, command = predictions["embedding"][:30], predictions["command"][:30]
    frames = np.stack([imported["pixels"][0, :-1].numpy(), imported["pixels"][0, 1:].numpy()], axis=1)
    (payload,) = session(tmp_path / "deployed/device.onnx", frames)
    received, deployed = session(tmp_path / "deployed/receive.onnx", payload)
    assert payload.dtype == np.uint8 and payload.shape == (30, tiny.SIZES["embedding_dim"])  # int8
    np.testing.assert_allclose(received, embedding, atol=0.05)
    np.testing.assert_allclose(deployed, command, atol=0.05 * 40)  # of the range of 40 N


def session(path: Path, *inputs: np.ndarray) -> list[np.ndarray]:
    """What a deployed graph makes of its inputs."""
    graph = onnxruntime.InferenceSession(path)
    return graph.run(None, {slot.name: value for slot, value in zip(graph.get_inputs(), inputs, strict=True)})
