"""What ping, iperf, iw and tables say in their dialects, against known losses and delays."""

import json

import numpy as np
import pytest

from tsjepa.radio.trace_formats import read_links

LOST, DELAY = {1, 4, 8, 9}, 10.5 + np.arange(10)  # of ten; the last two too, which only a summary tells


def log_of(path, text, period_s=None, **columns):
    path.write_text(text)
    return read_links(path, columns, period_s)[""]


def lines(answer, lost, first, tail):
    """A ping of ten, its header, an answer or ``lost`` a line, its summary."""
    rows = [(lost if k in LOST else answer).format(n=first + k, d=DELAY[k], t=1_700_000_000 + k) for k in range(8)]
    return "\n".join(["PING 192.0.2.1 (192.0.2.1): 56 data bytes", *filter(None, rows), "", "---", tail])


PINGS = {
    "linux": lines("64 bytes from 192.0.2.1: icmp_seq={n} ttl=57 time={d} ms", "", 1,
                   "10 packets transmitted, 6 received, 40% packet loss, time 9013ms"),
    "linux -D -O": lines("[{t}.25] 64 bytes from 192.0.2.1: icmp_seq={n} ttl=57 time={d} ms",
                         "[{t}.25] no answer yet for icmp_seq={n}", 1, "10 packets transmitted, 6 received"),
    "linux, unreachable": lines("64 bytes from 192.0.2.1: icmp_seq={n} ttl=57 time={d} ms",
                                "From 192.0.2.9 icmp_seq={n} Destination Host Unreachable", 1,
                                "10 packets transmitted, 6 received, +2 errors"),
    "macos": lines("64 bytes from 192.0.2.1: icmp_seq={n} ttl=57 time={d} ms", "Request timeout for icmp_seq {n}", 0,
                   "10 packets transmitted, 6 packets received, 40.0% packet loss"),
    "busybox": lines("64 bytes from 192.0.2.1: seq={n} ttl=57 time={d} ms", "", 0,
                     "10 packets transmitted, 6 packets received, 40% packet loss"),
    "german": lines("64 Bytes von 192.0.2.1: icmp_seq={n} ttl=57 Zeit={d} ms", "", 1, "10 packets transmitted"),
}  # fmt: skip


@pytest.mark.parametrize("name", PINGS)
def test_ping_in_its_dialects(name, tmp_path):
    log = log_of(tmp_path / "ping.txt", PINGS[name])
    assert set(np.flatnonzero(log.columns["lost"]).tolist()) == LOST
    arrived = log.columns["lost"] == 0
    np.testing.assert_allclose(log.columns["delay_ms"][arrived], DELAY[arrived])
    np.testing.assert_allclose(log.time_s, np.arange(10), atol=0.02)


def test_runs_of_ping_in_one_file_follow_each_other(tmp_path):
    log = log_of(tmp_path / "ping.txt", PINGS["linux"] + "\n" + PINGS["linux"])
    np.testing.assert_array_equal(np.flatnonzero(log.columns["lost"]), sorted(LOST | {10 + k for k in LOST}))
    assert any("2 runs of ping are joined" in note for note in log.notes)


def test_the_numbers_of_a_long_ping_start_again(tmp_path):
    numbers = [65534, 65535, 0, 2]
    rows = [f"64 bytes from 192.0.2.1: icmp_seq={number} ttl=57 time=9 ms" for number in numbers]
    np.testing.assert_array_equal(log_of(tmp_path / "ping.txt", "\n".join(rows)).columns["lost"], [0, 0, 0, 1, 0])


def test_the_summary_of_a_long_ping_counts_every_start_of_its_numbers(tmp_path):
    rows = [f"64 bytes from 192.0.2.1: icmp_seq={k % 65536} ttl=57 time=9 ms" for k in range(1, 65601) if k != 65598]
    lost = log_of(tmp_path / "ping.txt", "\n".join([*rows, "65602 packets transmitted, 65599 received"])).columns[
        "lost"
    ]
    np.testing.assert_array_equal(np.flatnonzero(lost), [65597, 65600, 65601])


WINDOWS = {
    "english": ("Pinging 192.0.2.1 with 32 bytes of data:", "Reply from 192.0.2.1: bytes=32 time={}ms TTL=117",
                "Request timed out.", "Ping statistics for 192.0.2.1:"),
    "german": ("Ping wird ausgeführt für 192.0.2.1 mit 32 Bytes Daten:",
               "Antwort von 192.0.2.1: Bytes=32 Zeit={}ms TTL=57",
               "Zeitüberschreitung der Anforderung.", "Ping-Statistik für 192.0.2.1:"),
    "french": ("Envoi d'une requête 'Ping'  192.0.2.1 avec 32 octets de données :",
               "Réponse de 192.0.2.1 : octets=32 temps={} ms TTL=57", "Délai d'attente de la demande dépassé.",
               "Statistiques Ping pour 192.0.2.1:"),
    "version 6": ("Pinging 2001:db8::1 with 32 bytes of data:", "Reply from 2001:db8::1: time<{}ms",
                  "Destination host unreachable.", "Ping statistics for 2001:db8::1:"),
}  # fmt: skip


@pytest.mark.parametrize("name", WINDOWS)
def test_ping_of_windows_in_any_language(name, tmp_path):
    header, answer, lost, statistics = WINDOWS[name]
    rows = [lost if k in LOST else answer.format(int(DELAY[k])) for k in range(10)]
    text = "\r\n".join(["", header, *rows, "", statistics, "    Packets: Sent = 10, Received = 6, Lost = 4,",
                        "Approximate round trip times in milli-seconds:", "    Minimum = 10ms"])  # fmt: skip
    log = log_of(tmp_path / "ping.txt", text)
    assert set(np.flatnonzero(log.columns["lost"]).tolist()) == LOST and len(log.time_s) == 10


STREAM = "[{id:>3}]   {a}.00-{b}.00   sec   128 KBytes  1.05 Mbits/sec  0.045 ms  {l}/100 ({l}%)  {tail}"


def iperf_rows(stream, losses, tail=""):
    return [STREAM.format(id=stream, a=k, b=k + 1, l=lost, tail=tail) for k, lost in enumerate(losses)]


def test_iperf_sums_up_streams_and_leaves_sums_of_intervals_out(tmp_path):
    first, second = [0, 10, 20], [10, 10, 40]
    summaries = [
        STREAM.format(id=5, a=0, b=3, l=99, tail="sender"),
        STREAM.format(id=5, a=0, b=3, l=10, tail="receiver"),
    ]
    separate = [*iperf_rows(5, first), *iperf_rows(7, second), *summaries]
    log = log_of(tmp_path / "iperf.txt", "\n".join(separate))
    np.testing.assert_allclose(log.columns["lost"], [0.05, 0.1, 0.3])
    summed = [row.replace("[  9]", "[SUM]") for row in iperf_rows(9, [5, 10, 30])]
    log = log_of(tmp_path / "iperf.txt", "\n".join([*separate, *summed]))
    np.testing.assert_allclose(log.columns["lost"], [0.05, 0.1, 0.3])
    omitted = [STREAM.format(id=5, a=0, b=1, l=77, tail="(omitted)")]
    log = log_of(tmp_path / "iperf.txt", "\n".join([*omitted, *iperf_rows(5, first)]))
    np.testing.assert_allclose(log.columns["lost"], [0, 0.1, 0.2])


def test_iperf_2_and_stamps_before_the_rows(tmp_path):
    rows = ["[  3]  0.0- 1.0 sec  128 KBytes  1.05 Mbits/sec   0.045 ms    0/   89 (0%)",
            "[  3]  1.0- 2.0 sec  128 KBytes  1.05 Mbits/sec   0.045 ms   89/   89 (1e+02%)"]  # fmt: skip
    np.testing.assert_allclose(log_of(tmp_path / "iperf.txt", "\n".join(rows)).columns["lost"], [0, 1])
    stamped = ["Tue Nov 14 22:13:20 2023 " + row for row in iperf_rows(5, [0, 10])]
    np.testing.assert_allclose(log_of(tmp_path / "iperf.txt", "\n".join(stamped)).columns["lost"], [0, 0.1])


def test_iperf_over_tcp_gives_round_trips_or_says_what_to_log(tmp_path):
    intervals = [{"streams": [{"start": k, "end": k + 1, "rtt": 20000 + 1000 * k}], "sum": {"start": k, "end": k + 1}}
                 for k in range(4)]  # fmt: skip
    for text in (
        json.dumps({"start": {}, "intervals": intervals, "end": {}}),
        "\n".join(json.dumps({"event": "interval", "data": interval}) for interval in intervals),
    ):
        log = log_of(tmp_path / "iperf.json", text)
        np.testing.assert_allclose(log.columns["delay_ms"], [20, 21, 22, 23])
        assert "lost" not in log.columns
    row = "[  5]   0.00-1.00   sec  11.2 MBytes  94.0 Mbits/sec    0   64.0 KBytes"
    with pytest.raises(ValueError, match="log the receiver of a UDP test"):
        log_of(tmp_path / "iperf.txt", row)


def test_iw_with_a_time_before_each_poll_and_several_stations(tmp_path):
    block = "Station 02:00:00:00:00:0{} (on wlan0)\n\tsignal:  \t-{} [-62, -65] dBm\n\tbeacon signal avg:\t-9 dBm\n"
    text = "".join(f"{1_700_000_000 + 2 * k}.5\n" + block.format(1, 60 + k) + block.format(2, 80) for k in range(3))
    log = log_of(tmp_path / "dump.txt", text + block.format(1, 63))
    np.testing.assert_array_equal(log.columns["rsrp_dbm"], [-60, -61, -62, -63])
    np.testing.assert_allclose(log.time_s, [0, 2, 4, 4])
    assert any("2 stations; 02:00:00:00:00:01" in note for note in log.notes)


def test_a_delivery_opportunity_far_away_is_refused_before_memory_is_taken(tmp_path):
    with pytest.raises(ValueError, match="--period_s"):
        log_of(tmp_path / "link.trace", "1\n2\n900000000\n")


TABLES = {
    "micro sign": "time [s];RTT [µs]\n0;20000\n1;30000\n",
    "other micro sign": "time (s),latency (μs)\n0,20000\n1,30000\n",
    "in words": "time,delay (milliseconds)\n0,20\n1,30\n",
    "units below the names": "time,delay\ns,us\n0,20000\n1,30000\n",
    "nested": '{"t": 0, "link": {"rtt_us": 20000}}\n{"t": 1, "link": {"rtt_us": 30000}}\n',
    "over midnight": "time,delay_ms\n23:59:59.5,20\n00:00:00.5,30\n",
}


@pytest.mark.parametrize("name", TABLES)
def test_units_of_tables(name, tmp_path):
    log = log_of(tmp_path / "a.txt", TABLES[name])
    np.testing.assert_allclose(log.columns["delay_ms"], [20, 30])
    np.testing.assert_allclose(log.time_s, [0, 1])


def test_a_unit_that_nobody_knows_is_refused_and_a_missing_one_is_said(tmp_path):
    with pytest.raises(ValueError, match="the unit jiffies of delay"):
        log_of(tmp_path / "a.csv", "time,delay (jiffies)\n0,2\n1,3\n")
    with pytest.raises(ValueError, match="the unit fortnights of time"):
        log_of(tmp_path / "a.csv", "time (fortnights),delay (ms)\n0,2\n1,3\n")
    assert (
        "delay names no unit: it is taken for milliseconds." in log_of(tmp_path / "a.csv", "t,delay\n0,2\n1,3\n").notes
    )


def test_losses_as_words_percent_and_counts(tmp_path):
    np.testing.assert_array_equal(
        log_of(tmp_path / "a.csv", "t,lost\n0,True\n1,False\n2,True\n").columns["lost"], [1, 0, 1]
    )
    np.testing.assert_allclose(log_of(tmp_path / "a.csv", "t,loss (%)\n0,0\n1,50\n").columns["lost"], [0, 0.5])
    with pytest.raises(ValueError, match="lost runs to 12; a loss is 0, 1, a share"):
        log_of(tmp_path / "a.csv", "t,lost\n0,0\n1,12\n")


def test_delays_below_zero_are_another_clock_or_a_mark_of_a_loss(tmp_path):
    log = log_of(tmp_path / "a.csv", "t,owd_ms\n0,-3\n1,-1\n2,4\n")
    np.testing.assert_allclose(log.columns["delay_ms"], [0, 2, 7])
    assert any("The offset of -3.0 ms is taken out" in note for note in log.notes)
    log = log_of(tmp_path / "a.csv", "t,rtt_ms\n0,5\n1,-1\n2,4\n3,-1\n")
    np.testing.assert_array_equal(log.columns["lost"], [0, 1, 0, 1])
    np.testing.assert_array_equal(np.isnan(log.columns["delay_ms"]), [False, True, False, True])


def test_a_table_of_several_devices_is_a_link_each(tmp_path):
    rows = "".join(f"{k},{device},{10 * number + k}\n" for k in range(4) for number, device in enumerate(("a", "b"), 1))
    (tmp_path / "a.csv").write_text("time_s,ue_id,delay_ms\n" + rows)
    links = read_links(tmp_path / "a.csv", {})
    assert list(links) == ["ue_id=a", "ue_id=b"]
    for number, log in enumerate(links.values(), 1):
        np.testing.assert_allclose(log.columns["delay_ms"], 10 * number + np.arange(4))
        np.testing.assert_allclose(log.time_s, np.arange(4))
