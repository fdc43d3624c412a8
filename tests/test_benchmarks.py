"""The benchmarks run, at a size at which their figures mean nothing."""

import json
import subprocess
import sys

import tiny
import tiny_controller

from tsjepa import zoo

HOME = tiny.ROOT / "tests" / "benchmarks"


def run(script: str, folder, *options: str) -> dict:
    output = folder / "out" / "result.json"
    command = [sys.executable, str(HOME / script), *options, "--output", str(output)]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return json.loads(output.read_text())


def test_camera(tmp_path):
    result = run("camera.py", tmp_path, "--devices", "3", "--rounds", "2", "--frames", "20")
    assert result["devices"] == 3
    assert set(result["frames_per_second"]) == {"fleet", "stock", "bare"}
    assert all(values["min"] > 0 and values["rounds"] == 2 for values in result["frames_per_second"].values())
    for other in ("stock", "bare"):
        ratio = result[f"fleet_over_{other}"]
        assert 0 < ratio["min"] <= ratio["median"] <= ratio["max"]


def test_training_step(tmp_path):
    for name in ("recipes/jepa.yaml", "recipes/data.yaml"):
        tiny.write(tmp_path, name, tiny.shrink(tiny.load(name)))
    small = ["--steps", "4", "--warmup", "0", "--threads", "1", "--data.init_args.frames_per_batch", "16"]
    result = run("training_step.py", tmp_path, *small)
    assert result["samples_per_step"] == 16
    assert result["training_over_resident"]["median"] > 0
    assert 0 < result["peak_memory_gib"] < 6


def test_memory(tmp_path):
    result = run("memory.py", tmp_path, "--devices", "200", "--slots", "1000")
    assert result["episodes"] == 2000
    assert result["growth_percent"] < 2


def test_loading(tmp_path):
    result = run("loading.py", tmp_path, "--rounds", "1", "--entries", "tsjepa-cartpole")
    assert set(result["seconds_to_load"]) == {"tsjepa-cartpole"}
    assert result["seconds_to_load"]["tsjepa-cartpole"]["min"] > 0


def test_latency(tmp_path):
    model = str(zoo.save(tiny_controller.tiny(), tmp_path / "model"))
    result = run("latency.py", tmp_path, "--model", model, "--rounds", "3", "--devices", "1", "7")
    assert result["payload_bits"] == 8 * 8
    assert result["frame_bits"] == 8 * 2 * 64 * 128 * 3
    assert 0 < result["device_memory"]["of_which_python_and_onnx_runtime_mib"] < result["device_memory"]["peak_mib"]
    assert set(result["controller"]) == {"1", "7"}
    # a hidden layer of 16 on 8 + 1 and an actor of 16 and 8 on 8
    multiplied = 9 * 16 + 16 * 8 + 8 * 16 + 16 * 8 + 8
    assert result["controller"]["7"]["megaflop"] == 2 * 7 * multiplied / 1e6
    for row in (result["device"], *result["controller"].values()):
        assert row["floor_milliseconds"]["rounds"] == 3
        assert all(row[name]["min"] > 0 for name in ("floor_milliseconds", "onnx_over_floor", "eager_over_onnx"))
