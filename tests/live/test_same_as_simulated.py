"""With the same seed and losses the live loop meets the deliveries of the simulated one, and scores alike."""

import io

import numpy as np
import pytest
import torch
from world import World

from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.live.graphs import Graphs
from tsjepa.live.simulated import SimulatedPlants
from tsjepa.live.weather import Weather
from tsjepa.models import Observer, entries
from tsjepa.plants import build_plant
from tsjepa.radio.loss import IidLoss
from tsjepa.zoo.deploy import deploy

SLOTS, DEVICES, HISTORY, SEED = 60, 4, 4, 1


@pytest.fixture(scope="module")
def remembering(tmp_path_factory):
    """Folder with the graphs of the same model with an observer, and the model."""
    folder = tmp_path_factory.mktemp("remembering")
    model = entries.load("tsjepa-cartpole")
    model.observer = Observer(model.embedding_dim, gain=0.6)
    deploy(str(entries.save(model, folder / "model")), str(folder / "graphs"))
    return folder / "graphs", model


@pytest.mark.slow
@pytest.mark.parametrize(("period", "loss"), [(1, 0.0), (5, 0.0), (1, 0.3), (3, 0.3)])
def test_the_live_run_is_the_simulated_one(monkeypatch, shipped, period, loss):
    runs_alike(monkeypatch, shipped, entries.load("tsjepa-cartpole"), period, loss)


@pytest.mark.slow
def test_so_is_that_of_devices_that_remember(monkeypatch, remembering):
    runs_alike(monkeypatch, *remembering, period=5, loss=0.3)


def runs_alike(monkeypatch, folder, model, period, loss):
    """Runs both loops and compares deliveries, states and scores."""
    log, live = io.BytesIO(), World(monkeypatch)
    graphs = Graphs(str(folder), ["device", "receive", "predict"], ())
    described = graphs.description["plant"]
    live.control(devices=DEVICES, graphs=graphs).log = log
    machine = SimulatedPlants(described, np.arange(DEVICES), SEED, None, HISTORY, 2, 1)
    weather = Weather(loss=loss, seed=SEED) if loss else None
    live.device(machine, range(DEVICES), graphs, period=period, weather=weather)
    states = [machine.state.copy()]
    act = machine.act
    machine.act = lambda commands: (act(commands), states.append(machine.state.copy()))[0]
    live.run(SLOTS)
    live.close()

    radio = Radio(codec="int8", loss=IidLoss(loss), snr_threshold_db=-200.0, resource_blocks=DEVICES)
    loop = Loop(build_plant(described), model, num_devices=DEVICES, slots=SLOTS, radio=radio, frame_history=HISTORY)
    simulated = run(every(loop, period), SEED)
    delivered = np.zeros((SLOTS, DEVICES), bool)
    for line in log.getvalue().decode().splitlines():
        _, device, slot = line.split(",")
        delivered[int(slot), int(device)] = True
    assert np.array_equal(delivered, simulated.delivered.numpy())
    assert delivered.any() and (loss == 0 or not delivered[::period].all())
    # an embedding half-way between two levels of the codec may go to the other one in ONNX Runtime
    off = (np.stack(states) - simulated.state.double().numpy()) / model.spec.state_scale
    assert np.abs(off).max() < 0.02
    scores = torch.tensor(machine.total / SLOTS)
    assert (scores - simulated.raw_score()).abs().max() <= 2 / SLOTS
    assert machine.down.tolist() == simulated.failed().tolist()
