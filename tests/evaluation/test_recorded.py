"""``--record`` of simulate and evaluate: the file says what the run did, as Rerun's own reader reads it."""

import numpy as np
import pytest
import tiny_controller
import torch

pytest.importorskip("rerun", reason="needs tsjepa[record]")

from recorded_file import RecordedFile

from tsjepa import cli
from tsjepa.envs import Radio
from tsjepa.evaluation.evaluate import evaluate
from tsjepa.evaluation.films import drawn
from tsjepa.evaluation.recorded import record_runs
from tsjepa.evaluation.rollouts import Loop, every
from tsjepa.evaluation.shown import shown_run
from tsjepa.evaluation.simulate import simulate
from tsjepa.models import entries
from tsjepa.plants import CartPole

PLANT = CartPole()
SLOT = PLANT.spec.slot


def test_a_recorded_fleet_says_what_the_run_did(tmp_path):
    model = tiny_controller.tiny()
    seen = shown_run(Loop(PLANT, model, "round_robin", 3, 6, Radio(resource_blocks=1), 2), 0)
    record_runs(tmp_path / "fleet.rrd", {"round_robin": seen}, PLANT, model)
    file, run = RecordedFile(tmp_path / "fleet.rrd"), seen.run
    assert file.timelines() == {"time"}
    for device in range(3):
        path = f"/round_robin/device\\ {device}"
        seconds, camera = file.pictures(f"{path}/camera")
        assert seconds == pytest.approx(SLOT * np.arange(6))
        assert np.array_equal(camera, PLANT.render(seen.scenes[:, device].numpy()))
        assert file.numbers(f"{path}/state")[1] == pytest.approx(run.state[:-1, device].numpy())
        assert file.numbers(f"{path}/command")[1] == pytest.approx(run.action[:, device].numpy())
        assert file.numbers(f"{path}/age")[1][:, 0].tolist() == run.age[:, device].tolist()
        assert file.numbers(f"{path}/score")[1][:, 0] == pytest.approx(run.slot_score()[:, device].numpy())
        sent = torch.stack((run.scheduled[:, device], run.delivered[:, device]), -1)
        assert file.numbers(f"{path}/radio")[1].tolist() == sent.int().tolist()
        heard = run.delivered[:, device].cummax(0).values
        seconds, beliefs = file.pictures(f"{path}/belief")
        assert seconds == pytest.approx(SLOT * torch.arange(6)[heard].numpy())
        assert np.array_equal(beliefs, drawn(model, seen.beliefs[heard, device]))


@pytest.mark.parametrize("codec", ["fp32", "raw"])
def test_what_a_model_that_does_not_predict_believes_is_what_it_received_last(codec):
    model = tiny_controller.tiny_supervised()
    seen = shown_run(every(Loop(PLANT, model, num_devices=2, slots=5, radio=Radio(codec=codec, lossless=True)), 2), 0)
    for slot in range(5):
        frames = np.stack([PLANT.render(seen.scenes[slot - slot % 2 - lag].numpy()) for lag in (1, 0)], 1)
        if slot >= 2:  # before that a stack reaches into the warm-up
            with torch.no_grad():
                expected = model.encode(torch.from_numpy(frames))
            torch.testing.assert_close(seen.beliefs[slot], expected, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_simulate_records_the_first_seed_of_every_scheduler(tmp_path):
    path = tmp_path / "fleet.rrd"
    options = {"plant": PLANT, "slots": 80, "seeds": 2, "output": str(tmp_path / "out"), "video": False}
    simulate(6, ["round_robin", "max_age"], "hold", Radio(resource_blocks=1), **options, record=str(path))
    file = RecordedFile(path)
    levels = {tuple(entity.split("/")[1:3]) for entity in file.entities() if entity.count("/") == 3}
    assert levels == {(name, f"device\\ {index}") for name in ("round_robin", "max_age") for index in range(6)}
    assert not [entity for entity in file.entities() if entity.endswith("belief")]  # the expert believes in a state
    sent = [file.numbers(f"/round_robin/device\\ {index}/radio")[1][:, 0] for index in range(6)]
    assert np.array_equal(np.sum(sent, 0), np.ones(80))


@pytest.mark.slow
def test_evaluate_records_one_start_at_every_period(tmp_path):
    entry = entries.save(tiny_controller.tiny(), tmp_path / "model")
    options = {"periods": (1, 5, 0), "seeds": 2, "starts_per_seed": 6, "slots": 40, "video": False}
    evaluate(str(entry), output=str(tmp_path / "out"), **options, record=str(tmp_path / "loop.rrd"))
    file = RecordedFile(tmp_path / "loop.rrd")
    for name, period in (("every\\ slot", 1), ("every\\ 5\\ slots", 5), ("once", 40)):
        age = file.numbers(f"/{name}/device\\ 0/age")[1][:, 0]
        assert age.tolist() == [slot % period + 1 for slot in range(40)]
        assert len(file.pictures(f"/{name}/device\\ 0/belief")[1]) == 40


def test_what_cannot_be_recorded_is_said_before_anything_is_run(tmp_path, capsys):
    fleet = ["simulate", "--controller=hold", "--plant=tsjepa.plants.CartPole", f"--output={tmp_path / 'out'}"]
    assert cli.main([*fleet, "--record=fleet.mp4"]) == 2
    assert "must name a file that ends in .rrd" in capsys.readouterr().err
    assert cli.main([*fleet, "--num_devices=null", "--search_over=[2]", "--record=fleet.rrd"]) == 2
    assert "A search is not recorded" in capsys.readouterr().err
    model = tiny_controller.tiny()
    model.plant = None
    entry = entries.save(model, tmp_path / "model")
    with pytest.raises(ValueError, match="record needs a plant"):
        evaluate(str(entry), output=str(tmp_path / "out"), record=str(tmp_path / "loop.rrd"))
    assert not (tmp_path / "out").exists()
