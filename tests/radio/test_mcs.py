"""The MCS table, transport-block sizes worked by hand from TS 38.214, and the block error rate's ingredients."""

import math

import numpy as np
import pytest
import torch

from tsjepa.radio.mcs import (
    MODULATION_ORDER,
    SMALL_BLOCKS,
    SPECTRAL_EFFICIENCY,
    block_error_rate,
    highest_mcs,
    transport_block_bits,
)

PRINTED = (
    "0.2344 0.3066 0.3770 0.4902 0.6016 0.7402 0.8770 1.0273 1.1758 1.3262 1.3281 1.4766 1.6953 1.9141 2.1602 2.4063 "
    "2.5703 2.5664 2.7305 3.0293 3.3223 3.6094 3.9023 4.2129 4.5234 4.8164 5.1152 5.3320 5.5547"
)


# copied from the standard's table, rows 51 to 93
LAST_SIZES = (
    "888 928 984 1032 1064 1128 1160 1192 1224 1256 1288 1320 1352 1416 1480 1544 1608 1672 1736 1800 1864 1928 2024 "
    "2088 2152 2216 2280 2408 2472 2536 2600 2664 2728 2792 2856 2976 3104 3240 3368 3496 3624 3752 3824"
)


def linear(decibel):
    return 10.0 ** (torch.as_tensor(decibel, dtype=torch.float64) / 10)


def test_spectral_efficiencies_are_the_printed_ones():
    """The standard's own column, to its four digits (it rounds halves up)."""
    for found, printed in zip(SPECTRAL_EFFICIENCY.tolist(), PRINTED.split(), strict=True):
        assert found == pytest.approx(float(printed), abs=5.1e-5)
    assert len(SMALL_BLOCKS) == 93
    assert SMALL_BLOCKS[[*range(50, 93)]].tolist() == [int(size) for size in LAST_SIZES.split()]


@pytest.mark.parametrize(
    "mcs, blocks, bits",
    [
        # 156 x 0.9258 x 6 = 866.5 -> 864 -> the next size of the table
        (28, 1, 888),
        # 156 x 0.1172 x 2 = 36.6 -> 32
        (0, 1, 32),
        # 16536 x 0.9258 x 6 = 91853 -> 45 x 2048 = 92160, in 11 segments
        (28, 106, 92200),
        # 16536 x 0.1172 x 2 = 3875.6 -> 3840, rate below 1/4, in 2 segments
        (0, 106, 3848),
        # 1560 x 0.332 x 4 = 2071.9 -> 64 x 32 ... 2048 -> 2088
        (10, 10, 2088),
    ],
)
def test_transport_blocks_worked_by_hand(mcs, blocks, bits):
    assert transport_block_bits(mcs, blocks).item() == bits


def test_transport_blocks_grow_and_stay_near_the_information_that_fits():
    mcs, blocks = torch.meshgrid(torch.arange(29), torch.arange(1, 274), indexing="ij")
    bits = transport_block_bits(mcs, blocks)
    assert (bits.diff(dim=1) >= 0).all() and (bits % 8 == 0).all()
    ratio = bits / (156 * blocks * SPECTRAL_EFFICIENCY[mcs])
    assert ratio[:, 20:].sub(1).abs().max() < 0.05
    fewer = transport_block_bits(28, 10, symbols=4)
    assert fewer.item() < transport_block_bits(28, 10).item() / 3


@pytest.mark.parametrize("order, decibel", [(2, 0.187), (4, 5.1), (6, 9.1)])
def test_half_of_the_bits_are_decoded_with_an_even_chance_at_the_constellations_capacity(order, decibel):
    """Rates near one half: the SNR of an even chance is that at which the mutual information equals the rate.

    The reference is a mean of the information density over drawn noise.
    """
    mcs = int((SPECTRAL_EFFICIENCY - order / 2).abs().masked_fill(order != MODULATION_ORDER, 9.0).argmin())
    snr = linear(torch.arange(-5, 15, 0.01))
    even = snr[int((block_error_rate(mcs, snr, 10**6, gap_db=0.0) <= 0.5).nonzero()[0])].item()
    generator = np.random.default_rng(0)
    levels = 2.0 * np.arange(2 ** (order // 2)) - 2 ** (order // 2) + 1
    levels /= np.sqrt(2 * (levels**2).mean())
    sent = generator.choice(levels, 400_000)
    heard = np.sqrt(even) * sent + generator.normal(scale=np.sqrt(0.5), size=sent.size)
    distance = (heard[:, None] - np.sqrt(even) * levels) ** 2
    nearest = (heard - np.sqrt(even) * sent) ** 2
    bits = order / 2 - np.log2(np.exp(nearest[:, None] - distance).sum(1))
    assert 2 * bits.mean() == pytest.approx(SPECTRAL_EFFICIENCY[mcs].item(), abs=8 * bits.std() / math.sqrt(sent.size))
    # the capacities of QPSK, 16QAM and 64QAM at half rate, as textbooks plot them; the MCS's rate is not quite that
    expected = decibel + 10 * math.log10(SPECTRAL_EFFICIENCY[mcs].item() / (order / 2))
    assert 10 * math.log10(even) == pytest.approx(expected, abs=0.35)


def test_error_rates_fall_with_snr_and_block_length_and_rise_with_the_rate():
    snr = linear(torch.arange(-12, 28, 0.5))
    rates = block_error_rate(torch.arange(29).unsqueeze(-1), snr, 1000)
    assert (rates.diff(dim=-1) <= 1e-12).all()
    assert rates[:, 0].min() > 0.999 and rates[:, -1].max() < 1e-6
    # where two modulations meet, the higher one is better at nearly the same rate
    same = MODULATION_ORDER[1:] == MODULATION_ORDER[:-1]
    assert (rates.diff(dim=0)[same] >= -1e-12).all()
    short, long = (block_error_rate(10, linear(4.5), bits).item() for bits in (100, 10_000))
    assert short > long


def test_the_gap_moves_the_curve():
    snr = torch.linspace(0, 10, 21, dtype=torch.float64)
    moved = block_error_rate(9, linear(snr + 0.7), 500, gap_db=0.7)
    torch.testing.assert_close(moved, block_error_rate(9, linear(snr), 500, gap_db=0.0))


def test_the_highest_mcs_meets_its_target():
    snr = linear(torch.arange(-10, 30, 1.0))
    chosen = highest_mcs(snr, 1000, target=0.1)
    assert (chosen.diff() >= 0).all() and chosen[0] == 0 and chosen[-1] == 28
    usable = chosen > 0
    assert (block_error_rate(chosen, snr, 1000)[usable] <= 0.1).all()
    higher = (chosen + 1).clamp(max=28)
    above = block_error_rate(higher, snr, 1000)
    # 16 and 17 have nearly the same efficiency
    assert ((above > 0.1) | (higher == chosen) | (chosen == 16)).all()


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="0 to 28"):
        transport_block_bits(29, 1)
    with pytest.raises(ValueError, match="target"):
        highest_mcs(torch.ones(1), 100, target=0.0)
