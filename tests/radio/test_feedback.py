"""What is inferred from acknowledgements: against Bayes' rule by enumeration, and against the law of the channel."""

import itertools

import pytest
import torch

from tsjepa.radio import GilbertElliott
from tsjepa.radio.feedback import (
    learned_success,
    loss_given_bad,
    predict_bad,
    start_counts,
    update_bad,
    update_counts,
)

LOSS = GilbertElliott(good_to_bad=0.1, bad_to_good=0.3, loss_good=0.05, loss_bad=0.7)


def enumerated(sent, arrived, decodable):
    """P[bad] in the slot after the last outcome, by summing over all paths of the hidden chain."""
    weight = {False: 0.0, True: 0.0}
    for path in itertools.product([False, True], repeat=len(sent) + 1):
        p = LOSS.bad_share if path[0] else 1 - LOSS.bad_share
        for k, bad in enumerate(path[:-1]):
            reach = decodable[k] * (1 - (LOSS.loss_bad if bad else LOSS.loss_good))
            p *= 1 if not sent[k] else reach if arrived[k] else 1 - reach
            leave = LOSS.bad_to_good if bad else LOSS.good_to_bad
            p *= leave if path[k + 1] != bad else 1 - leave
        weight[path[-1]] += p
    return weight[True] / (weight[True] + weight[False])


@pytest.mark.parametrize("seed", range(8))
def test_the_filter_is_bayes_rule_over_all_paths(seed):
    generator = torch.Generator().manual_seed(seed)
    sent = torch.rand(7, generator=generator) < 0.7
    arrived = sent & (torch.rand(7, generator=generator) < 0.5)
    decodable = torch.rand(7, generator=generator, dtype=torch.float64)
    bad = torch.tensor([LOSS.bad_share], dtype=torch.float64)
    for k in range(7):
        bad = predict_bad(LOSS, update_bad(LOSS, bad, sent[k], arrived[k], decodable[k]))
    assert bad.item() == pytest.approx(enumerated(sent.tolist(), arrived.tolist(), decodable.tolist()), abs=1e-12)


def test_without_outcomes_the_filter_stays_at_the_stationary_probability():
    bad = torch.full((3,), LOSS.bad_share, dtype=torch.float64)
    silent = torch.zeros(3, dtype=torch.bool)
    after = predict_bad(LOSS, update_bad(LOSS, bad, silent, silent, torch.ones(3)))
    torch.testing.assert_close(after, bad)
    assert loss_given_bad(LOSS, after)[0].item() == pytest.approx(LOSS.mean)


def test_an_outcome_that_the_model_calls_impossible_changes_nothing():
    certain = GilbertElliott(0.1, 0.3)  # never lost in the good state
    bad = torch.zeros(1, dtype=torch.float64)
    sent, lost = torch.ones(1, dtype=torch.bool), torch.zeros(1, dtype=torch.bool)
    assert update_bad(certain, bad, sent, lost, torch.ones(1)).item() == 0.0


def test_counts_learn_what_follows_an_outcome():
    """A channel in which a packet arrives with .9 after an ACK and .2 after a NACK, in whatever slot."""
    generator = torch.Generator().manual_seed(0)
    counts, last = start_counts((200,)), torch.ones(200, dtype=torch.bool)
    for _ in range(400):
        sent = torch.rand(200, generator=generator) < 0.4
        arrived = torch.where(last, 0.9, 0.2) > torch.rand(200, generator=generator)
        last = torch.where(sent, arrived, last)
        counts = update_counts(counts, sent, sent & arrived)
    expected = torch.where(last, 0.9, 0.2).double()
    assert (learned_success(counts) - expected).abs().mean() < 0.02


def test_nothing_learned_is_an_even_chance_and_a_few_outcomes_weigh_little():
    counts = start_counts((4,))
    assert learned_success(counts).tolist() == [0.5] * 4
    everyone = torch.ones(4, dtype=torch.bool)
    after = learned_success(update_counts(counts, everyone, everyone))
    # 4 ACKs and the prior's two outcomes; the situation is new to everybody
    torch.testing.assert_close(after, torch.full((4,), 5 / 6, dtype=torch.float64))


def test_discounted_counts_forget():
    everyone = torch.ones(50, dtype=torch.bool)
    for discount, floor in ((1.0, 0.4), (0.9, 0.0)):
        counts = start_counts((50,))
        for arrived in [everyone] * 100 + [~everyone] * 100:
            counts = update_counts(counts, everyone, arrived, discount)
        overall = counts.acks.sum() / counts.sends.sum()
        assert floor <= overall.item() < floor + 0.11
