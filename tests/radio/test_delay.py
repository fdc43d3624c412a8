"""Delay laws against their distributions, and packets in flight against a plain list."""

import pytest
import torch
from scipy.stats import kstest

from tsjepa.radio.delay import (
    ConstantDelay,
    GammaDelay,
    RecordedDelay,
    UniformDelay,
    acknowledged,
    nothing_in_flight,
    receive,
    send,
    whole_slots,
)

ZERO = torch.tensor(0)


def test_laws_have_their_distributions():
    device, slot = torch.arange(40_000), torch.tensor(3)
    uniform = UniformDelay(5.0, 25.0, "ms").draw(0, device, ZERO, slot)
    assert kstest(uniform.numpy(), "uniform", args=(5, 20)).pvalue > 1e-3
    exponential = GammaDelay(4.0, 10.0).draw(0, device, ZERO, slot)
    assert kstest(exponential.numpy(), "expon", args=(4, 10)).pvalue > 1e-3
    gamma = GammaDelay(4.0, 12.0, shape=3).draw(0, device, ZERO, slot)
    assert kstest(gamma.numpy(), "gamma", args=(3, 4, 4)).pvalue > 1e-3
    counts = UniformDelay(1, 4).draw(0, device, ZERO, slot).long().bincount(minlength=5)
    assert counts[0] == 0 and ((counts[1:] / 10_000 - 1).abs() < 0.05).all()
    assert (ConstantDelay(2).draw(0, device, ZERO, slot) == 2).all()


@pytest.mark.parametrize("law", [UniformDelay(0, 5), GammaDelay(1.0, 3.0, 2), RecordedDelay((1.0, 4.0, 2.0))])
def test_draws_depend_on_the_counters_alone(law):
    device, slots = torch.arange(6), torch.arange(10)
    table = law.draw(7, device.unsqueeze(-1), ZERO, slots)
    assert table.shape == (6, 10)
    assert torch.equal(table[2, 5], law.draw(7, torch.tensor(2), ZERO, torch.tensor(5)))
    assert not torch.equal(table, law.draw(8, device.unsqueeze(-1), ZERO, slots))
    assert not torch.equal(table, law.draw(7, device.unsqueeze(-1), ZERO, slots, stream="downlink_delay"))


def test_a_recording_is_played_in_order_and_from_the_start_again():
    values = (3.0, 1.0, 4.0, 1.5, 9.0)
    played = RecordedDelay(values).draw(0, torch.arange(50).unsqueeze(-1), ZERO, torch.arange(10))
    for row in played.tolist():
        start = values.index(row[0])
        assert row == [values[(start + k) % 5] for k in range(10)]
    assert len(set(played[:, 0].tolist())) == 5


def test_milliseconds_become_the_slots_that_have_begun():
    delays = torch.tensor([0.0, 19.9, 20.0, 39.9, 60.0], dtype=torch.float64)
    assert whole_slots(delays, "ms", 0.02).tolist() == [0, 0, 1, 1, 3]
    assert whole_slots(torch.tensor([0.0, 0.2, 2.0]), "slots", 0.02).tolist() == [0, 1, 2]


def test_packets_arrive_as_from_a_plain_list():
    generator = torch.Generator().manual_seed(0)
    shape, horizon = (3, 4), 5
    waiting = {}
    flight = nothing_in_flight(shape, horizon, torch.zeros(*shape, 2))
    overtaken = 0
    last = torch.full(shape, -1)
    for slot in range(60):
        sent = torch.rand(shape, generator=generator) < 0.6
        delay = torch.randint(0, 7, shape, generator=generator)
        payload = torch.rand((*shape, 2), generator=generator)
        flight, late = send(flight, sent, payload, torch.tensor(slot), delay)
        assert torch.equal(late, sent & (delay >= horizon))
        for place in (sent & ~late).nonzero().tolist():
            due = slot + int(delay[tuple(place)])
            waiting[(*place, due)] = (slot, payload[tuple(place)])
        flight, heard, got, sequence = receive(flight)
        for i in range(3):
            for j in range(4):
                number, value = waiting.pop((i, j, slot), (-1, torch.zeros(2)))
                assert sequence[i, j] == number and heard[i, j] == (number >= 0)
                assert torch.equal(got[i, j], value)
        overtaken += int((heard & (sequence < last)).sum())
        last = torch.maximum(last, sequence)
    assert overtaken > 20


def test_pictures_travel_too():
    frames = torch.arange(24, dtype=torch.uint8).view(2, 3, 4)
    flight = nothing_in_flight((2,), 3, frames)
    flight, _ = send(flight, torch.tensor([True, False]), frames, torch.tensor(9), torch.tensor([1, 1]))
    flight, heard, _, _ = receive(flight)
    assert not heard.any()
    flight, heard, got, sequence = receive(flight)
    assert heard.tolist() == [True, False] and sequence.tolist() == [9, -1]
    assert torch.equal(got[0], frames[0]) and not got[1].any()
    assert got.dtype == torch.uint8


def test_lost_acknowledgements():
    device = torch.arange(20_000)
    delivered = device % 2 == 0
    known = acknowledged(delivered, 0.3, 0, device, ZERO, ZERO)
    assert not (known & ~delivered).any()
    assert known.double().mean().item() == pytest.approx(0.35, abs=0.01)
    assert torch.equal(acknowledged(delivered, 0.0, 0, device, ZERO, ZERO), delivered)


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="unknown unit 's'"):
        ConstantDelay(1, "s")
    with pytest.raises(ValueError, match="at least low"):
        UniformDelay(3, 2)
    with pytest.raises(ValueError, match="shape 0"):
        GammaDelay(0.0, 1.0, shape=0)
    with pytest.raises(ValueError, match="mean_excess -1"):
        GammaDelay(0.0, -1.0)
    with pytest.raises(ValueError, match="empty"):
        RecordedDelay(())
    with pytest.raises(ValueError, match="ACK loss"):
        acknowledged(torch.ones(1, dtype=torch.bool), 1.5, 0, ZERO, ZERO, ZERO)
    with pytest.raises(ValueError, match="horizon 0"):
        nothing_in_flight((1,), 0, torch.zeros(1))


def test_a_uniform_delay_in_slots_is_of_whole_slots():
    with pytest.raises(ValueError, match=r"low 0\.5 and high 1 must be whole numbers of slots"):
        UniformDelay(0.5, 1.0)
    assert UniformDelay(0.5, 1.0, "ms").low == 0.5
