"""``tsjepa trace``: a simulated channel played from its own trace is the same channel; what is played is said."""

import pytest
import torch

from tsjepa import cli
from tsjepa.envs import Radio
from tsjepa.envs.links import links
from tsjepa.envs.transforms import Channel, TraceChannel
from tsjepa.radio import GilbertElliott
from tsjepa.radio.delay import GammaDelay, UniformDelay
from tsjepa.radio.trace_picture import gaps
from tsjepa.radio.traces import Trace, read_trace, write_trace

BURSTS = GilbertElliott(good_to_bad=0.1, bad_to_good=0.2)
RADIO = Radio(max_doppler_hz=10.0, loss=BURSTS, snr_target_db=(3.0, 12.0))


def played(part, devices=4, slots=60):
    return torch.stack(list(part.alone(devices, slots)), 1)


def test_a_channel_played_from_its_trace_is_the_same_channel(tmp_path):
    write_trace(tmp_path / "links.csv", links(RADIO, 4, 60, 0.02, seed=3))
    target = torch.tensor([3.0, 12.0]).repeat(2)
    simulated = played(Channel(snr_target_db=target, max_doppler_hz=10.0, loss=BURSTS, seed=3))
    again = played(TraceChannel(tmp_path / "links.csv", 0.02, start_s=0.0))
    torch.testing.assert_close(again["snr"], simulated["snr"], rtol=1e-5, atol=0)
    assert torch.equal(again["erased"], simulated["erased"])
    assert 0 < simulated["erased"].float().mean() < 1
    # after its last slot it begins again
    longer = played(TraceChannel(tmp_path / "links.csv", 0.02, start_s=0.0), slots=80)
    assert torch.equal(longer["snr"][:, 60:], longer["snr"][:, :20])
    slower = played(TraceChannel(tmp_path / "links.csv", 0.02, stretch=2.0, start_s=0.0))
    torch.testing.assert_close(slower["snr"][:, ::2], again["snr"][:, :30])


def test_a_trace_is_written_as_it_is_played(tmp_path):
    path = tmp_path / "links.csv"
    write_trace(path, links(Radio(loss=BURSTS), 2, 30, 0.02))
    looped = links(Radio(trace=str(path), trace_start_s=0.0), 2, 45, 0.02)
    first = read_trace(path).values["snr_db"].view(2, 30)
    torch.testing.assert_close(looped.values["snr_db"].view(2, 45)[:, 30:], first[:, :15], rtol=1e-5, atol=1e-5)


def test_delays_are_in_milliseconds_and_interference_makes_it_an_sinr():
    in_slots = links(Radio(delay=UniformDelay(0, 3), interference_rise_db=3.0), 3, 50, 0.02)
    assert set(in_slots.values["delay_ms"].tolist()) == {0.0, 20.0, 40.0, 60.0}
    assert set(in_slots.values) == {"sinr_db", "delay_ms"}
    law = GammaDelay(shift=5.0, mean_excess=10.0)
    drawn = links(Radio(delay=law), 1, 50, 0.02, seed=2).values["delay_ms"]
    device = torch.zeros(1, dtype=torch.int64)
    torch.testing.assert_close(drawn, law.draw(2, device, device, torch.arange(50)))
    with pytest.raises(ValueError, match="lossless"):
        links(Radio(lossless=True), 1, 5, 0.02)


def test_gaps_by_hand():
    time = torch.tensor([0.0, 0.5, 2.0, 2.1, 5.0], dtype=torch.float64)
    assert gaps(time, 1.0) == [(0.5, 2.0), (2.1, 5.0)]
    assert gaps(time, 3.0) == []


def test_the_command_writes_draws_and_says_how_it_is_played(tmp_path, capsys):
    path = tmp_path / "new" / "links.csv"
    options = ["--num_devices", "3", "--slots", "25", "--radio.max_doppler_hz", "10", "--seed", "1"]
    assert cli.main(["trace", "simulate", str(path), *options]) == 0
    assert "3 devices, 75 rows over 0.5 s; a row every 20 ms; 25 slots of 20 ms; no gaps" in capsys.readouterr().out
    assert path.with_suffix(".png").stat().st_size > 1000
    written = links(Radio(max_doppler_hz=10.0), 3, 25, 0.02, seed=1)
    torch.testing.assert_close(read_trace(path).values, written.values)
    play = ["--slots", "100", "--radio.trace_stretch", "2"]
    assert cli.main(["trace", "draw", str(path), str(tmp_path / "picture.png"), *play]) == 0
    assert "its time stretched 2 times; played 2.0 times" in capsys.readouterr().out
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_every_column_is_drawn_and_a_gap_is_said(tmp_path, capsys):
    time = torch.tensor([0.0, 1.0, 4.5], dtype=torch.float64)
    values = {name: torch.tensor([1.0, torch.nan, 0.0]).double() for name in ("rsrp_dbm", "delay_ms", "lost")}
    write_trace(tmp_path / "gappy.csv", Trace(time, torch.zeros(3, dtype=torch.int64), ("a",), values))
    assert cli.main(["trace", "draw", str(tmp_path / "gappy.csv"), str(tmp_path / "gappy.png")]) == 0
    said = capsys.readouterr().out
    assert "1 gap of more than 1 s, the longest of 3.5 s from 1.0 s on, in which the last value is held" in said
    assert (tmp_path / "gappy.png").stat().st_size > 1000


@pytest.mark.parametrize(
    "words, said",
    [
        (["simulate", "a.csv", "b.csv"], "takes a table alone"),
        (["draw", "a.csv"], "takes a file to read and one to write"),
        (["draw", "a.csv", "b.png"], "a.csv"),
        (["draw", "a.csv", "b.txt"], "picture that ends in .png, .svg, .pdf"),
        (["simulate", "a.csv", "--slot_s", "0"], "slot_s 0"),
        (["simulate", "a.csv", "--radio.lossless", "true"], "has no links"),
    ],
)
def test_mistakes_are_named_in_one_sentence(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["trace", *words]) == 2
    errors = capsys.readouterr().err
    assert said in errors and len(errors.strip().splitlines()) == 1
