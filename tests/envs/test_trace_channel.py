"""Traces in the chain: each slot has the values of the file's row."""

import pytest
import torch
from linear_fleet import LinearFleet
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs.transforms import Codec, Delay, Scheduler, TraceChannel, Uplink
from tsjepa.envs.transforms.uplink import AT_BASE_STATION
from tsjepa.radio.codecs import FloatCodec
from tsjepa.radio.link import noise_dbm

SNR_DB = {"left": [10.0, 0.0, 20.0, 3.0], "right": [4.0, 6.0, 4.0, 6.0]}


@pytest.fixture
def trace(tmp_path):
    """Writes a trace of two devices with a row in each slot of 20 ms, and gives its path."""

    def written(columns, rows):
        path = tmp_path / "trace.csv"
        path.write_text("\n".join([f"time_s,device,{columns}", *rows]) + "\n")
        return path

    return written


@pytest.fixture
def measured(trace):
    rows = [f"{0.02 * k},{name},{snr}" for name, values in SNR_DB.items() for k, snr in enumerate(values)]
    return trace("snr_db", rows)


def rollout(*transforms, slots=10, devices=2, lengths=None):
    env = TransformedEnv(LinearFleet((devices,), lengths), Compose(*transforms))
    still = torch.zeros(devices, 1)
    return env.rollout(slots, lambda td: td.set("action", still), break_when_any_done=False)


def linear(decibel):
    return 10 ** (torch.tensor(decibel) / 10)


def test_each_slot_has_the_files_snr_and_the_file_is_played_again(measured):
    data = rollout(TraceChannel(measured, start_s=0.0), Uplink(in_key=None))
    expected = linear([[values[k % 4] for k in range(10)] for values in SNR_DB.values()])
    torch.testing.assert_close(data["snr"], expected)
    torch.testing.assert_close(data["mean_snr"][:, 0], expected[:, :4].mean(-1))
    assert torch.equal(data["delivered"], expected >= 10**0.5)


def test_a_stretched_trace_is_slower(measured):
    data = rollout(TraceChannel(measured, stretch=2.0, start_s=0.0))
    expected = linear([values[k // 2 % 4] for values in SNR_DB.values() for k in range(7)]).view(2, 7)
    torch.testing.assert_close(data["snr"][:, :7], expected)


def test_episodes_start_where_they_are_told_or_at_a_drawn_place_common_to_all_devices(measured):
    told = rollout(TraceChannel(measured, start_s=0.04), lengths=[3, 3])
    assert torch.equal(told["snr"][:, :3], told["snr"][:, 3:6])
    torch.testing.assert_close(told["snr"][0, :3], linear([20.0, 3.0, 10.0]))
    places = set()
    for seed in range(20):
        drawn = rollout(TraceChannel(measured, seed=seed), slots=1)
        place = (drawn["snr"][0, 0] - linear(SNR_DB["left"])).abs().argmin()
        torch.testing.assert_close(drawn["snr"][1, 0], linear(SNR_DB["right"])[place])
        places.add(int(place))
    assert places == {0, 1, 2, 3}


def test_more_devices_than_the_trace_has_take_them_again_from_other_places(measured):
    data = rollout(TraceChannel(measured, start_s=0.0, seed=1), devices=24)
    again = data["snr"][::2]
    assert (again[:, :4].sort(-1).values == again[0, :4].sort(-1).values).all()
    assert len(torch.unique(again[:, :4], dim=0)) == 4


def test_outcomes_delays_and_gaps(trace):
    rows = ["0.0,a,0,5", "0.02,a,1,45", "0.06,a,,25", "0.08,a,0,0"]
    data = rollout(
        TraceChannel(trace("lost,delay_ms", rows), start_s=0.0),
        Scheduler("oracle", 1),
        Codec(FloatCodec(), in_key="state"),
        Uplink(in_key=None, keys=AT_BASE_STATION),
        Delay(None, horizon=5),
        devices=1,
        slots=5,
    )
    # the gap, and a row without an outcome, hold the loss before
    assert data["erased"][0].tolist() == [False, True, True, True, False]
    assert data["delay_ms"][0].tolist() == [5, 45, 45, 25, 0]
    assert torch.equal(data["decoded"], ~data["erased"])
    assert data["delivered"][0].tolist() == [True, False, False, False, True]


def test_shares_of_losses_are_drawn(trace):
    path = trace("lost", ["0.0,a,0.25", "0.5,a,0.25"])
    data = rollout(TraceChannel(path), Uplink(in_key=None), devices=100, slots=60)
    assert data["delivered"].double().mean().item() == pytest.approx(0.75, abs=0.02)


def test_rsrp_over_the_noise_of_a_subcarrier_and_links_that_are_not_measured_yet(trace):
    path = trace("rsrp_dbm", ["0.0,a,", "0.02,a,-110", "0.04,a,-120"])
    data = rollout(TraceChannel(path, start_s=0.0), Uplink(in_key=None), devices=1, slots=3)
    snr = 10 ** ((torch.tensor([-110.0, -120.0]) - noise_dbm(15e3)) / 10)
    torch.testing.assert_close(data["snr"][0, 1:], snr)
    assert data["snr"][0, 0] == 0
    assert data["delivered"][0].tolist() == [False, True, True]


def test_the_schedule_follows_the_trace(measured):
    data = rollout(TraceChannel(measured, start_s=0.0), Scheduler("opportunistic", 1), slots=4)
    assert data["scheduled"][0].tolist() == [True, False, True, False]
