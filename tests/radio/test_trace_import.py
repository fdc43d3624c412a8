"""Logs of radio links against logs written here with known losses, delays and offsets."""

import json

import numpy as np
import pytest

from tsjepa.cli import main
from tsjepa.radio import trace_import
from tsjepa.radio.trace_formats import read_links
from tsjepa.radio.trace_import import describe, import_trace, outages, parse_columns
from tsjepa.radio.traces import read_trace

parquet = pytest.importorskip("pyarrow.parquet")


def log_of(path, text, period_s=None, **columns):
    path.write_text(text)
    return read_links(path, columns, period_s)[""]


def test_a_table_with_units_in_its_names(tmp_path):
    log = log_of(tmp_path / "a.txt", "pub_time(ms) delay(s) sinr(db)\n1700000000000 0.02 7 \n1700000000055 0.03 8 \n")
    np.testing.assert_allclose(log.time_s, [0, 0.055], atol=1e-6)
    np.testing.assert_allclose(log.columns["delay_ms"], [20, 30])
    np.testing.assert_allclose(log.columns["sinr_db"], [7, 8])
    assert set(log.columns) == {"delay_ms", "sinr_db"} and not log.notes


def test_fields_without_a_name_are_left_out_and_named(tmp_path):
    log = log_of(tmp_path / "a.txt", "time rtt(ms)\n0 20 5 6\n1 21 5 6\n2 22 5 6\n")
    np.testing.assert_allclose(log.columns["delay_ms"], [20, 21, 22])
    assert log.notes == ["a.txt names 2 columns and has rows of 4 fields; the last 2 have no name and are left out."]


def test_missing_zero_and_dash_are_told_apart(tmp_path):
    log = log_of(tmp_path / "a.csv", "time_s,delay_ms,rsrp\n0,20,-90\n1,,-91\n2,-,0\n3,0,-92\n")
    delay = log.columns["delay_ms"]
    assert np.isnan(delay[1]) and np.isnan(delay[2]) and delay[3] == 0
    np.testing.assert_array_equal(log.columns["lost"], [0, 0, 1, 0])
    np.testing.assert_array_equal(np.isnan(log.columns["rsrp_dbm"]), [False, False, True, False])
    assert "delay_ms: 1 missing, 1 dashes, 1 zeros of 4." in log.notes
    entry = describe("a", log)
    assert (entry["lost"], entry["not_logged"], entry["late"]) == (1, 1, 0)


def test_columns_of_other_names_are_asked_for_and_given(tmp_path):
    text = "clock,ping\n0,20\n1,30\n"
    with pytest.raises(ValueError, match=r"no column of a\.csv is a time among clock, ping"):
        log_of(tmp_path / "a.csv", text)
    log = log_of(tmp_path / "a.csv", text, time_s="clock", delay_ms="ping")
    np.testing.assert_allclose(log.columns["delay_ms"], [20, 30])
    assert parse_columns("delay_ms='delay(ms)', time_s=clock") == {"delay_ms": "delay(ms)", "time_s": "clock"}
    with pytest.raises(ValueError, match="NAME=COLUMN"):
        parse_columns("delay=ping")


def packets(lost, offset_ms, late=()):
    """JSON lines of received packets, numbered from 100, sent every 100 ms; delays of 5 + (k mod 7) ms."""
    lines = []
    for number in range(60):
        if number in lost:
            continue
        sent = 1_700_000_000_000_000_000 + number * 100_000_000
        delay = 5 + number % 7 + (500 if number in late else 0)
        received = sent + int((delay + offset_ms) * 1e6)
        row = {
            "timestamp": received,
            "payload": {"seqnum": 100 + number, "src_timestamp_ns": str(sent), "runid": "run2"},
        }
        lines.append(json.dumps(row))
    return "\n".join(lines) + "\n"


def test_a_packet_log_tells_lost_late_and_the_offset_of_the_clocks(tmp_path):
    lost = {7, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29}
    log = log_of(tmp_path / "log_run1.json", packets(lost, offset_ms=-8, late={40}))
    assert len(log.time_s) == 60 and log.period_s == pytest.approx(0.1)
    np.testing.assert_array_equal(np.flatnonzero(log.columns["lost"]), sorted(lost))
    expected = np.array([k % 7 + (500 if k == 40 else 0) for k in range(60)], float)  # the smallest delay is zero
    expected[sorted(lost)] = np.nan
    np.testing.assert_allclose(log.columns["delay_ms"], expected, atol=1e-3)
    assert any("The offset of -3.0 ms is taken out" in note for note in log.notes)
    assert any("name says run1, its rows say run2" in note for note in log.notes)
    assert outages(log) == [{"start_s": pytest.approx(1.9), "duration_s": pytest.approx(1.1), "kind": "lost"}]
    entry = describe("log", log)
    assert (entry["received"], entry["lost"], entry["late"], entry["not_logged"]) == (49, 11, 1, 0)


def test_delays_of_one_clock_are_kept(tmp_path):
    log = log_of(tmp_path / "log.json", packets((), offset_ms=0))
    assert log.columns["delay_ms"][0] == pytest.approx(5) and "none is negative" in log.notes[0]


def test_packets_that_come_twice_or_out_of_order_count_once(tmp_path):
    lines = packets((), 0).splitlines()
    log = log_of(tmp_path / "log.json", "\n".join([lines[1], lines[0], *lines[2:], lines[5]]))
    assert len(log.time_s) == 60 and log.columns["lost"].sum() == 0
    assert "1 packets were received twice; the first counts." in log.notes


@pytest.mark.parametrize(
    ("size", "start", "count", "every"),
    [(1 << 16, 65500, 101, 2), (1 << 16, 0, 66_001, 10), (1 << 32, 4294967290, 21, 2)],
)
def test_numbers_that_start_again_are_counted_on(tmp_path, size, start, count, every):
    """One packet of ``every`` came, and where the numbers start again two came in the wrong order."""
    kept = list(range(0, count, every))
    turn = next(place for place, k in enumerate(kept) if start + k >= size)
    kept[turn - 1 : turn + 1] = kept[turn], kept[turn - 1]
    rows = [f"{(start + k) % size},{k / 50:.2f},{k / 50 + 0.004:.3f}\n" for k in kept]
    log = log_of(tmp_path / "log.csv", "seq,tx_time,rx_time\n" + "".join(rows))
    np.testing.assert_array_equal(log.columns["lost"], np.arange(count) % every > 0)
    np.testing.assert_allclose(log.time_s, np.arange(count) / 50, atol=1e-9)
    assert "The sequence numbers start again 1 times; they are counted on." in log.notes


def test_ping(tmp_path):
    lines = ["PING host (10.0.0.1) 56(84) bytes of data."]
    lines += [f"[17000000{k:02d}.5] 64 bytes from 10.0.0.1: icmp_seq={k} ttl=60 time={10 + k}.5 ms" for k in (1, 2, 5)]
    log = log_of(tmp_path / "ping.txt", "\n".join([*lines, "[1700000003.5] no answer yet for icmp_seq=3"]))
    np.testing.assert_array_equal(log.columns["lost"], [0, 0, 1, 1, 0])
    np.testing.assert_allclose(log.columns["delay_ms"][[0, 1, 4]], [11.5, 12.5, 15.5])
    np.testing.assert_allclose(log.time_s, range(5), atol=0.01)


def test_iperf3_text_and_json(tmp_path):
    row = "[  5]   {0}.00-{1}.00   sec   128 KBytes  1.05 Mbits/sec  0.045 ms  {2}/100 ({2}%)"
    lines = [row.format(k, k + 1, 3 * k) for k in range(4)]
    total = "[  5]   0.00-4.00   sec   512 KBytes  1.05 Mbits/sec  0.045 ms  18/400 (4.5%)  receiver"
    log = log_of(tmp_path / "iperf.txt", "\n".join([*lines, "- - - -", total]))
    np.testing.assert_allclose(log.columns["lost"], [0, 0.03, 0.06, 0.09])
    assert "delay_ms" not in log.columns
    sums = [{"sum": {"start": k, "end": k + 1, "lost_packets": 3 * k, "packets": 100}} for k in range(4)]
    log = log_of(tmp_path / "iperf.json", json.dumps({"start": {}, "intervals": sums}, indent=1))
    np.testing.assert_allclose(log.columns["lost"], [0, 0.03, 0.06, 0.09])


def test_iw_text(tmp_path):
    block = "Connected to 02:00:00:00:00:01 (on wlan0)\n\tSSID: lab\n\tsignal: -{} dBm\n"
    log = log_of(tmp_path / "iw.txt", block.format(60) + "Not connected.\n" + block.format(65), period_s=0.5)
    np.testing.assert_allclose(log.columns["rsrp_dbm"], [-60, np.nan, -65])
    np.testing.assert_allclose(log.time_s, [0, 0.5, 1])
    assert any("1 of 3 polls found no connection" in note for note in log.notes)
    with pytest.raises(ValueError, match="--period_s"):
        read_links(tmp_path / "iw.txt", {})


def test_mahimahis_opportunities_are_the_wait_for_the_next_one(tmp_path):
    log = log_of(tmp_path / "link.trace", "3\n3\n25\n90\n", period_s=0.02)
    np.testing.assert_allclose(log.columns["delay_ms"], [3, 5, 50, 30, 10])  # at 0, 20, 40, 60, 80 ms


@pytest.mark.parametrize("last", [4001, 4100, 8191])
def test_a_packet_sent_at_an_opportunity_does_not_wait(tmp_path, last):
    log = log_of(tmp_path / "link.trace", "".join(f"{ms}\n" for ms in range(1, last + 1)), period_s=0.001)
    np.testing.assert_array_equal(log.columns["delay_ms"], np.arange(last) == 0)  # the first is 1 ms away
    np.testing.assert_allclose(log.time_s, np.arange(last) / 1000, atol=1e-12)


def test_a_pause_of_the_log_is_not_a_loss(tmp_path):
    log = log_of(tmp_path / "a.csv", "time_s,delay_ms\n" + "".join(f"{k},5\n" for k in (0, 1, 2, 3, 20, 21)))
    assert outages(log) == [{"start_s": 3, "duration_s": 17, "kind": "not logged"}]


def test_the_normal_form_has_the_columns_that_the_logs_tell_and_a_device_a_file(tmp_path, capsys):
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "a.json").write_text(packets({7}, -8))
    (folder / "b.csv").write_text("time_s,rsrp\n0,-90\n1,-91\n")
    (folder / "README.md").write_text("# about these logs\nThey are logs.\n")
    assert main(["trace", "import", str(folder), str(tmp_path / "out.parquet")]) == 0
    table = parquet.read_table(tmp_path / "out.parquet")
    assert table.column_names == ["time_s", "device", "delay_ms", "rsrp_dbm", "lost"]
    device = table["device"].to_numpy()
    assert (device == 0).sum() == 60 and (device == 1).sum() == 2
    assert np.isnan(table["lost"].to_numpy()[device == 1]).all()
    report = json.loads((tmp_path / "out.json").read_text())
    assert [entry["name"] for entry in report["skipped"]] == ["README.md"]
    assert (tmp_path / "out.png").is_file() and "received 59 of 60" in capsys.readouterr().out
    assert sorted(file.name for file in tmp_path.iterdir()) == ["logs", "out.json", "out.parquet", "out.png"]


def test_an_import_that_fails_leaves_table_picture_and_report_of_the_one_before(tmp_path, monkeypatch):
    (tmp_path / "log.json").write_text(packets({7}, -8))
    import_trace(str(tmp_path / "log.json"), str(tmp_path / "out.parquet"))
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    (tmp_path / "other.json").write_text(packets({7, 9}, -8))
    monkeypatch.setattr(trace_import, "draw", lambda path, logs: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        import_trace(str(tmp_path / "other.json"), str(tmp_path / "out.parquet"))
    (tmp_path / "other.json").unlink()
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_inspect_tells_a_log_and_how_to_import_it(tmp_path, capsys):
    (tmp_path / "log.json").write_text(packets({7}, -8))
    assert main(["inspect", str(tmp_path / "log.json")]) == 0
    said = capsys.readouterr().out
    assert "packet log" in said and f"tsjepa trace import {tmp_path / 'log.json'} log.parquet" in said


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty"),
        ("once upon a time\nthere was no log here at all\n", "is no log of a radio link"),
        ("time,delay\nx,5\n", "holds no row with a time"),
        ('{"seq": 1, "word": "a"}\n', "has sequence numbers and no time"),
        (
            '{"seq": 1, "sent_ns": 1700000000000000000}\n{"seq": 9000000000, "sent_ns": 1700000000000000001}\n',
            "run over",
        ),
        ('{"a": 1}\n\n{"a": \n', "line 3 of log.txt is no JSON"),
        ("version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        ("5\n3\n", "do not rise"),
    ],
)
def test_what_is_no_log_is_refused_in_one_sentence_and_leaves_nothing(tmp_path, text, sentence):
    (tmp_path / "log.txt").write_text(text)
    with pytest.raises(ValueError, match=sentence):
        import_trace(str(tmp_path / "log.txt"), str(tmp_path / "out.parquet"))
    assert [file.name for file in tmp_path.iterdir()] == ["log.txt"]


def test_what_import_writes_is_what_the_radio_reads(tmp_path):
    (tmp_path / "log.json").write_text(packets({7, 8}, -8))
    import_trace(str(tmp_path / "log.json"), str(tmp_path / "out.parquet"))
    trace = read_trace(tmp_path / "out.parquet")
    assert trace.names == ("0",)
    np.testing.assert_array_equal(np.flatnonzero(trace.values["lost"].numpy()), [7, 8])
    np.testing.assert_allclose(trace.time_s.numpy(), 0.1 * np.arange(60), atol=1e-6)
    assert trace.values["delay_ms"].isnan().sum() == 2


@pytest.mark.parametrize(
    "text",
    [
        ",time_s,delay_ms,rssi\n0,0.0,20,-90\n1,0.1,21,-91\n2,0.2,22,-92\n",  # as pandas writes its index
        "time_s,,delay_ms,rssi\n0.0,x,20,-90\n0.1,x,21,-91\n0.2,x,22,-92\n",
        'time_s,"delay (ms)",rssi\n"0,0","20,0","-90,0"\n"0,1","21,0","-91,0"\n"0,2","22,0","-92,0"\n',
        "time_s;delay_ms;rssi;\n0,0;20;-90;\n0,1;21;-91;\n0,2;22;-92;\n",
    ],
)
def test_a_column_without_a_name_moves_no_other_and_quotes_are_read(tmp_path, text):
    log = log_of(tmp_path / "a.csv", text)
    np.testing.assert_allclose(log.time_s, [0, 0.1, 0.2])
    np.testing.assert_allclose(log.columns["delay_ms"], [20, 21, 22])
    np.testing.assert_allclose(log.columns["rsrp_dbm"], [-90, -91, -92])


def test_a_pause_is_reported_beside_losses_and_only_once(tmp_path):
    rows = [(0.1 * row + (60 if row >= 20 else 0), int(40 <= row < 50)) for row in range(80)]
    text = "time_s,delay_ms,lost\n" + "".join(f"{time:.1f},20,{lost}\n" for time, lost in rows)
    found = outages(log_of(tmp_path / "a.csv", text))
    assert [(gap["kind"], round(gap["start_s"], 1), round(gap["duration_s"], 1)) for gap in found] == [
        ("not logged", 1.9, 60.1),
        ("lost", 63.9, 1.1),
    ]
    text = "time_s,delay_ms,lost\n" + "".join(
        f"{0.1 * row:.1f},20,{'' if 10 <= row < 20 else 0}\n" for row in range(40)
    )
    (found,) = outages(log_of(tmp_path / "b.csv", text))
    assert (found["kind"], round(found["duration_s"], 1)) == ("not logged", 1.1)
