"""Traces: read, put on slots, looped, stretched and described; a public one where it is at hand."""

import importlib.util
import math
from pathlib import Path

import pytest
import torch

from tsjepa.radio.trace_formats import read_links
from tsjepa.radio.traces import Trace, describe, on_slots, read_trace, write_trace

WILD = Path(__file__).parents[2].parent / "shared" / "wild" / "traces"
TEXT = """time_s,device,snr_db,lost
10.00,b,20,0
10.00,a,5.5,0
10.05,a,,1
10.21,a,7.5,0
10.02,b,22,0
10.03,b,24,1
"""


@pytest.fixture
def trace(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_text(TEXT)
    return read_trace(path)


def same(first, second):
    assert first.names == second.names and first.values.keys() == second.values.keys()
    for one, other in zip((*first[:2], *first.values.values()), (*second[:2], *second.values.values()), strict=True):
        torch.testing.assert_close(one, other, equal_nan=True)


def test_rows_are_sorted_by_device_and_time_from_zero(trace):
    assert trace.names == ("b", "a")
    assert trace.device.tolist() == [0, 0, 0, 1, 1, 1]
    torch.testing.assert_close(trace.time_s, torch.tensor([0, 0.02, 0.03, 0, 0.05, 0.21], dtype=torch.float64))
    assert trace.values["snr_db"][[0, 1, 2, 3, 5]].tolist() == [20, 22, 24, 5.5, 7.5]
    assert math.isnan(trace.values["snr_db"][4])
    assert "rsrp_dbm" not in trace.values


def test_slots_hold_the_last_value_and_count_the_rows(trace):
    grid = on_slots(trace, 0.02)
    assert grid.rows.tolist() == [[1, 2, *[0] * 9], [1, 0, 1, *[0] * 7, 1]]
    assert grid.values["snr_db"].tolist() == [[20, *[24] * 10], [*[5.5] * 10, 7.5]]
    lost = grid.values["lost"]
    assert lost[0, :2].tolist() == [0, 1] and lost[1, [0, 2, 10]].tolist() == [0, 1, 0]
    assert lost[:, 3:10].isnan().all()


def test_before_the_first_value_there_is_none():
    late = Trace(
        torch.tensor([0.0, 0.1]).double(), torch.tensor([0, 1]), ("a", "b"), {"snr_db": torch.ones(2).double()}
    )
    assert on_slots(late, 0.05).values["snr_db"][1].isnan().tolist() == [True, True, False]


def test_stretching_plays_slower(trace):
    slow = on_slots(trace, 0.02, stretch=2.0)
    assert slow.rows.shape == (2, 22)
    assert slow.values["snr_db"][0].tolist() == [20, 20, 22, *[24] * 19]


def test_a_trace_survives_a_file(trace, tmp_path):
    write_trace(tmp_path / "again.csv", trace)
    again = read_trace(tmp_path / "again.csv")
    same(again, trace)
    assert [file.name for file in tmp_path.glob("again*")] == ["again.csv"]


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="pyarrow is not installed")
def test_a_trace_survives_parquet(trace, tmp_path):
    write_trace(tmp_path / "trace.parquet", trace)
    same(read_trace(tmp_path / "trace.parquet"), trace)


def test_what_is_played_is_said_in_one_sentence(trace):
    said = describe(trace, 0.02, slots=110, gap_s=0.1)
    assert said == (
        "2 devices, 6 rows over 0.2 s; a row every 20 ms; 11 slots of 20 ms; played 10.0 times; "
        "1 gap of more than 0.1 s, the longest of 0.2 s from 0.1 s on, in which the last value is held; "
        "33.3 % of the packets lost."
    )
    assert "stretched 2 times; of which 5 are played; no gaps" in describe(trace, 0.02, 2.0, slots=5)


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "is empty"),
        ("time_s,snr_db\n", "no rows"),
        ("time,snr_db\n1,2\n", "needs time_s"),
        ("time_s,color\n1,2\n", "needs time_s and one of"),
        ("time_s,snr_db\n1,2\n1,2,3\n", "line 3 has 3 cells"),
        ("time_s,snr_db\n1,good\n", "column snr_db does not hold a number"),
        ("time_s,snr_db\n,3\n2,3\n", "row 1 has no time"),
    ],
)
def test_bad_files_are_named(text, said, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=said):
        read_trace(path)


def test_bad_slots_are_rejected(trace):
    with pytest.raises(ValueError, match="stretch 0"):
        on_slots(trace, 0.02, stretch=0.0)


@pytest.mark.skipif(not WILD.exists(), reason="no public traces beside the checkout")
def test_a_vehicles_control_messages_over_5g(tmp_path):
    """CICV5G (Tongji University), brought into the normal form: a message every 55 ms, of which none is missing."""
    path = next((WILD / "vehicle-5g").rglob("urban_n78_v0_run03.txt"))
    log = read_links(path, {}, None)[""]
    columns = {name: torch.from_numpy(column) for name, column in log.columns.items()}
    device = torch.zeros(len(log.time_s), dtype=torch.int64)
    write_trace(tmp_path / "vehicle.csv", Trace(torch.from_numpy(log.time_s), device, ("0",), columns))
    trace = read_trace(tmp_path / "vehicle.csv")
    grid = on_slots(trace, 0.02)
    assert 10 < trace.values["delay_ms"].nanmedian() < 60
    assert grid.values["sinr_db"].isfinite().all()
    assert 0.3 < (grid.rows > 0).double().mean() < 0.45
    assert "a row every 55 ms" in describe(trace, 0.02)
