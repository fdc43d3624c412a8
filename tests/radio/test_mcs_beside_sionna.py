"""MCS table, transport blocks and block errors against Sionna's: a few of its points always, all of it where installed.

Its table of block errors was simulated with NR's LDPC code, for the MCS table of TS 38.214 5.1.3.1-1; ours is an
approximation with one gap for all MCS. Points of the two are compared by the SNR at which ours has the same error rate.
"""

import importlib.util
import json
from pathlib import Path

import pytest
import torch

from tsjepa.radio.mcs import CODE_RATE, MODULATION_ORDER, block_error_rate, transport_block_bits

HOME = importlib.util.find_spec("sionna")
installed = pytest.mark.skipif(HOME is None, reason="Sionna is not installed: pip install sionna-no-rt")
GRID_DB = torch.arange(-15, 30, 0.005, dtype=torch.float64)
# MCS, bits, SNR in dB, block error rate: of sionna/sys/bler_tables/PDSCH_table1.json, Sionna 2.2.0, Apache 2.0
POINTS = [
    (4, 500, -1.4286, 0.089),
    (6, 1000, 0.3571, 0.2273),
    (10, 100, 2.1429, 0.875),
    (10, 100, 3.9286, 0.1557),
    (11, 2000, 3.9286, 0.511),
    (14, 500, 7.5, 0.0353),
    (19, 1000, 11.0714, 0.026),
    (25, 2000, 16.4286, 0.1477),
]


def distance_db(mcs: int, bits: int, decibel: float, rate: float) -> float:
    """How many decibels more our curve needs for this error rate."""
    ours = block_error_rate(mcs, 10 ** (GRID_DB / 10), bits)
    return GRID_DB[int((ours <= rate).nonzero()[0])].item() - decibel


@pytest.mark.parametrize("mcs, bits, decibel, rate", POINTS)
def test_points_of_the_simulated_curves(mcs, bits, decibel, rate):
    assert abs(distance_db(mcs, bits, decibel, rate)) < 0.7


@installed
def test_all_simulated_curves_of_blocks_of_a_hundred_bits_and_more():
    table = Path(HOME.submodule_search_locations[0]) / "sys" / "bler_tables" / "PDSCH_table1.json"
    curves = json.loads(table.read_text())["category"]["1"]["index"]["1"]["MCS"]
    apart = {bits: [] for bits in (100, 500, 1000, 2000)}
    for mcs, curve in curves.items():
        for bits, distances in apart.items():
            for decibel, rate in zip(curve["SNR_db"], curve["CBS"][str(bits)]["BLER"], strict=True):
                if 0.02 <= rate <= 0.98:
                    distances.append(distance_db(int(mcs), bits, decibel, rate))
    for bits, distances in apart.items():
        distances = torch.tensor(distances)
        assert len(distances) >= 13
        assert distances.mean().abs() < 0.15 and distances.abs().max() < (1.25 if bits == 100 else 0.7)


@installed
@pytest.mark.slow
def test_the_table_and_the_transport_blocks_are_the_same():
    utils = pytest.importorskip("sionna.phy.nr.utils", reason="a package that Sionna needs is not installed")
    order, rate = utils.decode_mcs_index(torch.arange(29), table_index=1, is_pusch=False)
    assert torch.equal(order.to(MODULATION_ORDER), MODULATION_ORDER) and torch.equal(rate.to(CODE_RATE), CODE_RATE)
    for blocks in (1, 2, 5, 10, 37, 106, 273):
        for mcs in range(29):
            theirs = utils.calculate_tb_size(
                int(MODULATION_ORDER[mcs]),
                float(CODE_RATE[mcs]),
                num_prbs=blocks,
                num_ofdm_symbols=14,
                num_dmrs_per_prb=12,
            )
            assert transport_block_bits(mcs, blocks).item() == int(theirs[0])
