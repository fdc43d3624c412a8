"""Calibration: what is predicted of the devices that are scheduled is what happens to them."""

import pytest
import torch

from tsjepa.radio import GilbertElliott, Known
from tsjepa.radio.belief import DelayedCsi, PerfectCsi, PredictedCsi, StatisticalCsi, make_belief
from tsjepa.radio.fading import jakes_gain, rayleigh_power
from tsjepa.radio.feedback import AckLearned
from tsjepa.radio.loss import erased
from tsjepa.radio.schedulers import channel_aware, max_age, opportunistic, random

THRESHOLD, WALK_HZ, SLOT_S = 10**0.5, 10.4239, 0.02
BURSTS = GilbertElliott(good_to_bad=0.05, bad_to_good=0.2)
CHANNELS = {"independent": (0.0, None), "jakes": (WALK_HZ, None), "gilbert_elliott": (0.0, BURSTS)}


def deliveries(csi, channel, scheduler, delay=1, slots=400, batch=10, devices=60, blocks=6, warm_up=100, phases=True):
    """Predicted and realised success of every transmission after the warm-up, [N] each, and the mean age."""
    max_doppler_hz, loss = CHANNELS[channel]
    belief = make_belief(csi, THRESHOLD, delay, loss, max_doppler_hz, SLOT_S)
    shape = (batch, devices)
    index = torch.arange(batch * devices).view(shape)
    episode, mean = torch.zeros_like(index), torch.full(shape, 10.0, dtype=torch.float64)
    everyone = torch.ones(shape, dtype=torch.bool)
    believed, memory = belief.start(shape), torch.zeros(shape, dtype=torch.float64)
    age, sent, arrived = torch.ones(shape), ~everyone, ~everyone
    bad = loss and loss.start(0, index, episode)
    predicted, realised, ages = [], [], []
    for slot in torch.arange(slots):
        told = {}
        if max_doppler_hz:
            amplitude = torch.stack(jakes_gain(0, index, episode, slot.double() * SLOT_S, max_doppler_hz), -1)
            gain = amplitude.square().sum(-1)
            told = {"gain": amplitude} if phases and isinstance(belief, PredictedCsi) else {}
        else:
            gain = rayleigh_power(0, index, episode, slot)
        believed, link = belief.step(believed, mean, mean * gain, sent, arrived, **told)
        known = Known(age, link.snr, link.success, link.above_threshold, everyone, blocks, memory)
        sent, memory = scheduler(known)
        arrived = sent & (mean * gain >= THRESHOLD)
        if loss:
            bad = loss.advance(bad, 0, index, episode, slot)
            arrived &= ~erased(loss.loss_probability(bad), 0, index, episode, slot)
        age = torch.where(arrived, 1.0, age + 1)
        if slot >= warm_up:
            predicted.append(link.success[sent])
            realised.append(arrived[sent].double())
            ages.append(age.mean().item())
    return torch.cat(predicted), torch.cat(realised), sum(ages) / len(ages)


def spread(predicted):
    """Standard deviation of the summed error of a calibrated forecast, whose errors are uncorrelated."""
    return (predicted * (1 - predicted)).sum().sqrt() + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("csi", ["perfect", "delayed", "statistical", "acks"])
def test_calibration(csi, channel):
    predicted, realised, _ = deliveries(csi, channel, channel_aware)
    assert len(predicted) == 18_000
    assert abs((predicted - realised).sum()) <= 3 * spread(predicted)
    for low in (0.0, 0.2, 0.4, 0.6, 0.8):
        inside = (predicted >= low) & (predicted < low + 0.2)
        # what is still being learned is off by a little
        tolerance = 0.06 * inside.sum() if csi == "acks" else 0.0
        assert abs((predicted - realised)[inside].sum()) <= tolerance + 3.5 * spread(predicted[inside])


@pytest.mark.slow
def test_one_old_snr_says_too_little_about_devices_that_are_chosen_by_their_past():
    """A device that waited for a better link and is then measured to have one rises, which one old SNR does not say."""
    predicted, realised, _ = deliveries("delayed", "jakes", channel_aware, phases=False)
    assert 0.02 < (realised - predicted).mean() < 0.1
    for scheduler in (opportunistic, random):
        predicted, realised, _ = deliveries("delayed", "jakes", scheduler, phases=False)
        assert abs((predicted - realised).sum()) <= 3 * spread(predicted)


@pytest.mark.slow
def test_gains_that_are_two_slots_old_are_predicted_too():
    predicted, realised, _ = deliveries("delayed", "jakes", channel_aware, delay=2)
    assert abs((predicted - realised).mean()) < 0.005
    assert predicted.mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("channel", CHANNELS)
def test_channel_aware_is_never_older_than_max_age(channel):
    """Whatever is known; max_age looks at no channel, so that it is the same under all knowledge."""
    oldest = deliveries("perfect", channel, max_age)[-1]
    for csi, delay in (("perfect", 1), ("delayed", 1), ("delayed", 3), ("statistical", 1), ("acks", 1)):
        assert deliveries(csi, channel, channel_aware, delay)[-1] <= 1.02 * oldest, csi


@pytest.mark.slow
def test_a_device_in_a_burst_is_left_alone_for_a_while():
    """Oldest first asks it again and again."""
    blind = deliveries("statistical", "gilbert_elliott", max_age)[-1]
    assert deliveries("statistical", "gilbert_elliott", channel_aware)[-1] < 0.85 * blind


def one(value):
    return torch.tensor([value])


def test_perfect_csi_knows_the_snr_and_the_mean_of_the_losses_alone():
    belief = PerfectCsi(THRESHOLD, BURSTS)
    mean, silent = torch.tensor([9.0, 9.0]), one(False)
    memory, link = belief.step(belief.start((2,)), mean, torch.tensor([4.0, 2.0]), silent, silent)
    assert link.success.tolist() == pytest.approx([1 - BURSTS.mean, 0.0])
    assert link.above_threshold.tolist() == [True, False]
    # a loss above the threshold is a burst, which lasts
    _, link = belief.step(memory, mean, torch.full((2,), 4.0), one(True), silent)
    assert link.success.tolist() == pytest.approx([BURSTS.bad_to_good, 1 - BURSTS.mean])


def test_delayed_csi_starts_from_the_mean_and_then_knows_an_older_snr():
    belief = DelayedCsi(THRESHOLD, max_doppler_hz=WALK_HZ, delay=2)
    memory, quiet = belief.start((1,)), (one(False), one(False))
    successes = []
    for snr in (100.0, 0.1, 5.0, 5.0):
        memory, link = belief.step(memory, one(10.0), one(snr), *quiet)
        successes.append(link.success.item())
    alone = torch.exp(one(-THRESHOLD / 10)).item()
    assert successes[:2] == pytest.approx([alone] * 2, abs=1e-6)
    assert successes[2] > alone > successes[3]


def test_without_fading_the_mean_is_all():
    belief = StatisticalCsi(THRESHOLD, fading="none")
    _, link = belief.step(belief.start((2,)), torch.tensor([4.0, 3.0]), None, *[torch.zeros(2, dtype=torch.bool)] * 2)
    assert link.success.tolist() == [1.0, 0.0]


def test_learned_counts_outlive_an_episode():
    belief, everyone = AckLearned(THRESHOLD), torch.ones(5, dtype=torch.bool)
    memory = belief.start((5,))
    for _ in range(20):
        memory, link = belief.step(memory, None, None, everyone, everyone)
    assert (link.success > 0.9).all()
    _, link = belief.step(belief.restart(memory), None, None, ~everyone, ~everyone)
    assert (link.success > 0.9).all()
    assert torch.equal(PerfectCsi(1.0).restart(torch.ones(5, 2)), torch.zeros(5, 2, dtype=torch.float64))


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="unknown csi 'guess'"):
        make_belief("guess", 1.0)
    with pytest.raises(ValueError, match="csi_delay 0"):
        make_belief("delayed", 1.0, delay=0)
    with pytest.raises(ValueError, match="unknown fading"):
        make_belief("perfect", 1.0, fading="rice")
