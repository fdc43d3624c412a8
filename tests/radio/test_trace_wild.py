"""Public logs of radio links that nobody of this project made."""

import json

import numpy as np
import pytest
from recordings import wild

from tsjepa.cli import main
from tsjepa.radio.trace_import import import_trace

parquet = pytest.importorskip("pyarrow.parquet")


def test_every_file_of_the_vehicle_gives_delays_in_milliseconds(tmp_path):
    report = import_trace(str(wild("traces/vehicle-5g")), str(tmp_path / "vehicle.parquet"))
    devices = {entry["name"].rpartition("/")[2]: entry for entry in report["devices"]}
    assert len(devices) == 5 and all(16 <= entry["delay_ms"]["median"] <= 32 for entry in devices.values())
    assert max(entry["delay_ms"]["most"] for entry in devices.values()) == 1567
    assert devices["s2w_n78_v50_run02.txt"]["notes"] == [
        "s2w_n78_v50_run02.txt names 10 columns and has rows of 12 fields; the last 2 have no name and are left out."
    ]
    assert sorted(round(1000 * entry["period_s"]) for entry in devices.values()) == [55, 55, 55, 55, 105]
    table = parquet.read_table(tmp_path / "vehicle.parquet")
    assert table.column_names == ["time_s", "device", "delay_ms", "rsrp_dbm", "sinr_db"]
    assert table.num_rows == 665 + 481 + 956 + 317 + 512
    assert np.isfinite(table["sinr_db"].to_numpy()).all()
    assert all(file["name"] == "README.md" for file in report["skipped"])


def test_the_worst_file_of_the_shipyard_has_190_of_438_packets_and_a_hole_of_124_seconds(tmp_path, capsys):
    path = wild("traces/shipyard-wifi/logs/log_perama_site_ac_20mhz_5ghz_run1_loc3.json")
    assert main(["trace", "import", str(path), str(tmp_path / "ship.parquet")]) == 0
    (entry,) = json.loads((tmp_path / "ship.json").read_text())["devices"]
    assert (entry["received"], entry["received"] + entry["lost"]) == (190, 438)
    assert entry["period_s"] == pytest.approx(0.5, abs=1e-4)
    assert entry["outages"][0]["duration_s"] == pytest.approx(124.5, abs=0.01) and entry["outages"][0]["kind"] == "lost"
    said = capsys.readouterr().out
    assert "received 190 of 438" in said and "outage   124.5 s from 94.0 s: lost" in said
    assert "83 of 190 one-way delays are negative" in said and "offset of -30.6 ms is taken out" in said


def test_the_other_files_of_the_shipyard(tmp_path):
    report = import_trace(str(wild("traces/shipyard-wifi")), str(tmp_path / "ship.parquet"))
    kinds = {entry["name"].rpartition("/")[2]: entry for entry in report["devices"]}
    signal = kinds["log_perama_site_ax_20mhz_24ghz_tcp_single_UL_run1_loc2_phy.json"]
    assert signal["kind"] == "iw" and signal["rsrp_dbm"] == [-74, -65]
    other = kinds["log_perama_site_ax_20mhz_24ghz_run2_loc1.json"]
    assert "The file's name says run2, its rows say run1." in other["notes"] and other["lost"] == 0
    assert {file["name"] for file in report["skipped"]} == {"LICENSE", "README.md"}
