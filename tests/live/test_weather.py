"""The weather at the socket is the radio's: what a simulation with the same seed meets."""

import math

import pytest
import torch

from tsjepa.envs import Radio
from tsjepa.envs.settings import Downlink
from tsjepa.evaluation.rollouts import Loop, every
from tsjepa.live.weather import BLOCK, Weather
from tsjepa.plants import CartPole
from tsjepa.radio.delay import ConstantDelay, UniformDelay
from tsjepa.radio.loss import IidLoss

NEVER_WEAK = {"snr_threshold_db": -200.0, "resource_blocks": 3}
SLOTS, DEVICES = 40, 3


def chain(radio: Radio, seed: int) -> tuple[list, list]:
    """What the chain says of every slot: who was erased or heard, and how long it travelled; [slots][devices]."""
    env = every(Loop(CartPole(), "hold", num_devices=DEVICES, slots=SLOTS, radio=radio), 1).env(seed)
    now, erased, heard = env.reset(), [], []
    action = torch.zeros(DEVICES, 1)
    for _ in range(SLOTS):
        erased.append(now["erased"].tolist() if "erased" in now.keys() else None)  # noqa: SIM118
        heard.append(
            [d if h else None for h, d in zip(now["delivered"], now.get("packet_delay", now["delivered"]), strict=True)]
        )
        now = env.step_and_maybe_reset(now.set("action", action.clone()))[1]
    return erased, heard


@pytest.mark.parametrize("seed", [0, 7])
def test_the_same_updates_are_lost(seed):
    weather = Weather(loss=0.3, seed=seed)
    erased, heard = chain(Radio(loss=IidLoss(0.3), **NEVER_WEAK), seed)
    mine = [[math.isinf(weather.delay(device, 0, slot)) for device in range(DEVICES)] for slot in range(SLOTS)]
    assert mine == erased
    assert 0.1 < sum(map(sum, mine)) / (SLOTS * DEVICES) < 0.5
    assert [[h is not None for h in slot] for slot in heard] == [[not lost for lost in slot] for slot in mine]


@pytest.mark.parametrize(
    ("law", "options"),
    [
        (ConstantDelay(20.0, "ms"), {"delay": 20.0}),
        (UniformDelay(10.0, 70.0, "ms"), {"delay": 10.0, "jitter": 60.0}),
    ],
)
def test_updates_arrive_in_the_same_slots(law, options):
    weather = Weather(loss=0.2, seed=3, **options)
    _, heard = chain(Radio(loss=IidLoss(0.2), delay=law, **NEVER_WEAK), 3)
    newest = [-1] * DEVICES
    for slot in range(SLOTS):
        for device in range(DEVICES):
            arrived = [
                sent
                for sent in range(slot + 1)
                if sent + math.floor(min(weather.delay(device, 0, sent), 10) / 0.02 + 1e-9) == slot
            ]
            newer = [sent for sent in arrived if sent > newest[device]]
            found = heard[slot][device]
            assert (slot - max(newer) if newer else None) == (None if found is None else int(found))
            newest[device] = max([newest[device], *newer])


def test_the_same_commands_are_lost():
    weather = Weather(loss=0.4, seed=5, downlink=True)
    radio = Radio(lossless=True, downlink=Downlink(loss=0.4))
    env = every(Loop(CartPole(), "hold", num_devices=DEVICES, slots=SLOTS + 1, radio=radio), 1).env(5)
    now, last = env.reset(), torch.zeros(DEVICES)
    for slot in range(SLOTS):
        sent = torch.full((DEVICES, 1), 0.01 * (slot + 1))
        now = env.step_and_maybe_reset(now.set("action", sent.clone()))[1]
        lost = torch.tensor([math.isinf(weather.delay(device, 0, slot)) for device in range(DEVICES)])
        last = torch.where(lost, last, sent[:, 0])
        assert torch.equal(now["applied_command"][:, 0], last)


def test_a_trace_is_played_as_the_chain_plays_it(tmp_path):
    rows = ["time_s,device,lost,delay_ms"]
    rows += [
        f"{0.02 * slot:.2f},{device},{(slot + device) % 4 == 0:d},{5 * (slot % 9)}"
        for device in range(2)
        for slot in range(30)
    ]
    (tmp_path / "trace.csv").write_text("\n".join(rows))
    weather = Weather(trace=str(tmp_path / "trace.csv"), seed=2)
    erased, _ = chain(Radio(trace=str(tmp_path / "trace.csv"), delay="trace", **NEVER_WEAK), 2)
    mine = [[math.isinf(weather.delay(device, 0, slot)) for device in range(DEVICES)] for slot in range(SLOTS)]
    assert mine == erased
    assert any(map(any, mine))
    travelled = {weather.delay(0, 0, slot) for slot in range(30)} - {math.inf}
    assert {round(1e3 * seconds, 6) for seconds in travelled} == {5.0 * step for step in range(9)}


def test_a_link_of_a_trace_that_is_too_weak_loses_everything(tmp_path):
    (tmp_path / "trace.csv").write_text("time_s,snr_db\n0.0,-30\n0.2,-30\n0.4,30\n0.6,30\n")
    lost = [math.isinf(Weather(trace=str(tmp_path / "trace.csv"), seed=1).delay(0, 0, slot)) for slot in range(31)]
    assert 15 <= sum(lost) <= 25


def test_slots_far_away_and_other_episodes_are_drawn_alike():
    weather, again = Weather(loss=0.5, seed=1), Weather(loss=0.5, seed=1)
    far = [weather.delay(0, 2, slot) for slot in range(BLOCK - 5, BLOCK + 5)]
    assert [again.delay(0, 2, slot) for slot in reversed(range(BLOCK - 5, BLOCK + 5))] == far[::-1]
    assert far != [weather.delay(0, 3, slot) for slot in range(BLOCK - 5, BLOCK + 5)]


@pytest.mark.parametrize("options", [{"loss": 1.5}, {"delay": -1.0}, {"jitter": 1e6}])
def test_weather_that_cannot_be_is_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        Weather(**options)
