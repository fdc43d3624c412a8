import pytest
import tiny
import torch

from tsjepa.cli import estimate
from tsjepa.support.precision import Precision

CPU = torch.device("cpu")


@pytest.mark.parametrize(("nanoseconds_a_flop", "side"), [(1e-3, 4096), (1.0, 256), (1e5, 128)])
def test_products_grow_until_one_takes_long_enough_on_this_machine(monkeypatch, nanoseconds_a_flop, side):
    sides = []

    def seconds(product, device):
        sides.append(product.__defaults__[0].shape[0])
        return 2 * sides[-1] ** 3 * nanoseconds_a_flop * 1e-9

    monkeypatch.setattr(estimate, "_seconds", seconds)
    assert estimate.gemm_rate(torch.float32, CPU) == pytest.approx(1e9 / nanoseconds_a_flop)
    assert sides == [2**power for power in range(7, 13) if 2**power <= side]


def test_the_estimate_adds_frames_steps_and_the_finish(monkeypatch):
    chosen = Precision("32-true", "contiguous")
    monkeypatch.setattr(estimate, "choose", lambda encoder, device: chosen)
    recipe, data = tiny.load("recipes/jepa.yaml"), tiny.load("recipes/data.yaml")
    frames = {name: split["episodes"] * (data["slots"] + 1) for name, split in data["splits"].items()}
    assert frames["train"] == 600 * 61
    steps = recipe["trainer"]["max_epochs"] * 140  # of 256 frames, of the 60 a trajectory that have one before them
    (refine,) = (c["init_args"]["steps"] for c in recipe["trainer"]["callbacks"] if "Refine" in c["class_path"])

    def total(frame: float, trial: float, finish: float) -> float:
        monkeypatch.setattr(estimate, "step_seconds", lambda *arguments: trial)
        monkeypatch.setattr(estimate, "refine_seconds", lambda *arguments: finish)
        found, seconds = estimate.main_job(CPU, 1 / frame if frame else float("inf"))
        assert found == chosen
        return seconds / estimate.AND_THE_REST

    assert total(1.0, 0.0, 0.0) == pytest.approx(sum(frames.values()))
    assert total(0.0, 1.0, 0.0) == pytest.approx(4 * steps)  # a trial has 8 of a batch's 32 windows
    assert total(0.0, 0.0, 1.0) == pytest.approx(refine)
