"""The same link, logged as strangers log theirs: every way gives the same delays and losses."""

import codecs
import gzip
import json

import numpy as np
import pytest

from tsjepa.radio.trace_formats import read_links

ROWS, STEP_S, SINCE_1970 = 30, 0.05, 1_700_000_000
DELAY = 20.0 + np.arange(ROWS) % 9
NUMBERS = np.arange(ROWS) + np.arange(ROWS) // 5  # every sixth packet was lost


def rows(mark: str, names: str, cells, end: str = "\n") -> str:
    return names + end + "".join(mark.join(map(str, cells(k))) + end for k in range(ROWS))


def seconds(k: int) -> str:
    return f"{SINCE_1970 + STEP_S * k:.3f}"


TABLES = {
    "semicolons.csv": rows(";", "time;delay [ms]", lambda k: (seconds(k), DELAY[k])),
    "decimal-commas.csv": rows(
        ";", "time;rtt(ms)", lambda k: (f"{STEP_S * k:.2f}".replace(".", ","), f"{DELAY[k]:.1f}".replace(".", ",")),
        "\r\n",
    ),
    "mark.csv": codecs.BOM_UTF8 + rows(",", "timestamp,latency", lambda k: (seconds(k), DELAY[k])).encode(),
    "utf16.csv": rows(",", "time_s,delay_ms", lambda k: (STEP_S * k, DELAY[k])).encode("utf-16"),
    "packed.csv.gz": gzip.compress(
        rows(
            ",", "timestamp_ns,RTT (us)", lambda k: ((SINCE_1970 * 20 + k) * 50_000_000, int(1000 * DELAY[k]))
        ).encode()
    ),
    "uptime.csv": rows(",", "t_ns,delay_ms", lambda k: (2 * 10**14 + 50_000_000 * k, DELAY[k])),
    "quoted.csv": rows(",", '"time_ms","delay_s"', lambda k: (f'"{50 * k}"', f'"{DELAY[k] / 1000}"')),
    "commented.txt": "# by hand\n" + rows(" ", "# time_s delay_ms", lambda k: (STEP_S * k, DELAY[k])),
    "dates.csv": rows(",", "datetime,delay_ms", lambda k: (f"2024-01-01T00:00:{STEP_S * k:06.3f}+01:00", DELAY[k])),
    "list.json": json.dumps([{"time": SINCE_1970 + STEP_S * k, "delay_ms": DELAY[k]} for k in range(ROWS)], indent=1),
    "mark.jsonl": "\ufeff"
    + "".join(json.dumps({"time": SINCE_1970 + STEP_S * k, "delay_ms": DELAY[k]}) + "\r\n" for k in range(ROWS)),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_a_table_of_delays_is_read_however_it_is_written(name, tmp_path):
    content = TABLES[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    log = read_links(tmp_path / name, {})[""]
    np.testing.assert_allclose(log.columns["delay_ms"], DELAY, rtol=1e-9)
    np.testing.assert_allclose(log.time_s, STEP_S * np.arange(ROWS), atol=1e-6)
    assert log.period_s == pytest.approx(STEP_S, abs=1e-6)


def stamps(k: int) -> tuple[float, float]:
    """When packet k was sent and received, seconds since 1970."""
    return SINCE_1970 + STEP_S * NUMBERS[k], SINCE_1970 + STEP_S * NUMBERS[k] + DELAY[k] / 1000


PACKETS = {
    "seconds.csv": rows(
        ",", "seq,tx_time,rx_time", lambda k: (NUMBERS[k], f"{stamps(k)[0]:.4f}", f"{stamps(k)[1]:.4f}")
    ),
    "from-zero.csv": rows(
        ";", "seq;sent_ns;recv_ns",
        lambda k: (NUMBERS[k], NUMBERS[k] * 50_000_000, NUMBERS[k] * 50_000_000 + int(DELAY[k]) * 10**6),
    ),
    "uptime.csv": rows(
        ",", "seq,sent_ns,recv_ns",
        lambda k: (NUMBERS[k], 2 * 10**14 + NUMBERS[k] * 50_000_000,
                   2 * 10**14 + NUMBERS[k] * 50_000_000 + int(DELAY[k]) * 10**6),
    ),
    "seconds.jsonl": "".join(
        json.dumps({"seq": int(NUMBERS[k]), "sent_time": round(stamps(k)[0], 4), "timestamp": round(stamps(k)[1], 4)})
        + "\n"
        for k in range(ROWS)
    ),
    "two-units.jsonl": "".join(
        json.dumps({"seq": int(NUMBERS[k]), "src_timestamp_ns": str((SINCE_1970 * 20 + int(NUMBERS[k])) * 50_000_000),
                    "timestamp": SINCE_1970 * 1000 + int(NUMBERS[k]) * 50 + int(DELAY[k])}) + "\n"
        for k in range(ROWS)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PACKETS)
def test_a_log_of_packets_is_read_whatever_its_stamps_count_in(name, tmp_path):
    (tmp_path / name).write_text(PACKETS[name])
    log = read_links(tmp_path / name, {})[""]
    assert log.kind == "packet log" and log.period_s == pytest.approx(STEP_S, abs=1e-5)
    arrived = log.columns["lost"] == 0
    np.testing.assert_array_equal(np.flatnonzero(arrived), NUMBERS)
    np.testing.assert_allclose(log.columns["delay_ms"][arrived], DELAY, atol=0.15)


def test_ping_of_windows_has_no_numbers_and_its_lost_ones_are_lost(tmp_path):
    lines = ["Pinging 192.0.2.1 with 32 bytes of data:"]
    for k in range(ROWS):
        reply = f"Reply from 192.0.2.1: bytes=32 time={DELAY[k]:.0f}ms TTL=117"
        lines.append("Request timed out." if k % 6 == 0 else reply)
    lines.append("    Packets: Sent = 30, Received = 25, Lost = 5 (16% loss),")
    (tmp_path / "ping.txt").write_text("\r\n".join(lines))
    log = read_links(tmp_path / "ping.txt", {})[""]
    np.testing.assert_array_equal(log.columns["lost"], np.arange(ROWS) % 6 == 0)
    np.testing.assert_array_equal(log.columns["delay_ms"][1:6], DELAY[1:6])


def test_a_dump_of_stations_is_signal_text(tmp_path):
    blocks = [f"Station 00:00:5e:00:53:01 (on wlan0)\n\tsignal:  \t-{60 + k} [-62, -65] dBm\n" for k in range(5)]
    (tmp_path / "dump.txt").write_text("".join(blocks))
    np.testing.assert_array_equal(
        read_links(tmp_path / "dump.txt", {}, 1.0)[""].columns["rsrp_dbm"], -60.0 - np.arange(5)
    )


def test_signal_text_in_rows_has_the_unit_of_its_stamps(tmp_path):
    texts = [{"timestamp_ns": 2 * 10**14 + 50_000_000 * k, "phy": f"signal: -{60 + k} dBm"} for k in range(5)]
    (tmp_path / "phy.json").write_text("\n".join(json.dumps(row) for row in texts))
    log = read_links(tmp_path / "phy.json", {})[""]
    np.testing.assert_allclose(log.time_s, STEP_S * np.arange(5), atol=1e-6)
