"""Device and controller together, over real sockets in virtual time."""

import asyncio
import random
import re
import socket
from types import SimpleNamespace

import numpy as np
import pytest
import world
from world import Graphs, Machine, World

from tsjepa.live import device_loop, packet
from tsjepa.live.device_loop import Device
from tsjepa.live.link import Link
from tsjepa.live.packet import LARGEST, UPDATE, Dropped, Header, Update
from tsjepa.live.port import DROPS, Port, dropped_line
from tsjepa.live.seal import Seal, read_key


@pytest.fixture
def live(monkeypatch):
    made = World(monkeypatch)
    yield made
    made.close()


def applied(device) -> list[float]:
    return [float(row[0]) for row in device.machine.applied]


def weather(lost=(), delayed=None):
    """Loses the packets of some slots and delays others, seconds by slot."""
    delayed = delayed or {}
    return SimpleNamespace(delay=lambda device, episode, slot: np.inf if slot in lost else delayed.get(slot, 0.0))


def test_a_command_that_answers_an_update_is_applied_to_its_own_slot(live):
    live.control()
    device = live.device()
    live.run(20)
    np.testing.assert_allclose(applied(device), [-0.1 * slot for slot in range(20)], atol=1e-6)
    summary = live.controller.summary()
    assert summary["age_slots"] == {"1": 20}
    assert summary["counts"]["updates"] == 20
    assert device.summary()["commands"] == {"received": 20, "safe": 0, "held": 0}


def test_between_updates_the_controller_predicts_through_its_own_commands(live):
    live.control()
    device = live.device(period=3)
    live.run(7)
    expected, belief = [], 0.0
    for slot in range(7):
        belief = slot if slot % 3 == 0 else belief + expected[-1]
        expected.append(-0.1 * belief)
    np.testing.assert_allclose(applied(device), expected, atol=1e-6)
    assert live.controller.summary()["age_slots"] == {"1": 3, "2": 2, "3": 2}


def test_a_lost_update_is_predicted_too(live):
    live.control()
    device = live.device(weather=weather(lost={0, 1, 5}))
    live.run(8)
    after_loss = 4 - 0.4
    np.testing.assert_allclose(applied(device), [0, 0, -0.2, -0.3, -0.4, -0.1 * after_loss, -0.6, -0.7], atol=1e-6)
    assert device.counts["lost"] == 3


def test_a_late_update_is_brought_up_through_the_commands_since(live):
    """Delays of a slot: after the first answers the controller aims at the slot in which its command arrives."""
    live.control()
    device = live.device(weather=weather(delayed=dict.fromkeys(range(100), 0.02)))
    live.run(30)
    assert device.summary()["round_trip_slots"] == 1
    found = applied(device)
    for slot in range(10, 30):
        seen = slot - 1  # the update of the slot before, whose command is known
        assert found[slot] == pytest.approx(-0.1 * (seen + found[seen]), abs=1e-5)
    assert device.summary()["commands"]["held"] <= 3


def test_the_buffer_is_played_while_commands_are_lost(live):
    live.control(buffer=4, weather=weather(lost={3, 4, 5}))
    device = live.device()
    live.run(8)
    belief, expected = 2.0, []
    for _ in range(4):
        expected.append(-0.1 * belief)
        belief += expected[-1]
    np.testing.assert_allclose(applied(device)[2:6], expected, atol=1e-6)


def test_the_newest_update_wins_and_an_overtaken_one_is_dropped(live):
    live.control()
    live.device(weather=weather(delayed={4: 0.05}))
    live.run(12)
    assert live.controller.port.drops["overtaken"] == 1
    assert live.controller.beliefs.newest[0] == 11


def test_of_two_updates_that_wait_together_the_newer_is_used(live):
    live.control()
    device = live.device()
    live.run(3)
    for slot in (3, 4):
        device.slot = slot
        device.send(0, bytes((10 * slot, 0)))
    live.controller.port.drain()
    assert live.controller.beliefs.newest[0] == 4
    assert live.controller.port.drops["overtaken"] == 1
    assert live.controller.counts["updates"] == 4


def test_each_device_is_controlled_by_its_own_updates(live):
    live.control(devices=3)
    machine = Machine(2)
    machine.look = lambda: np.array([[10, 0], [50, 0]])
    first, second = live.device(machine, numbers=(0, 2)), live.device(numbers=(1,))
    live.run(4)
    assert [list(row) for row in first.machine.applied] == [[-1, -5]] * 4
    np.testing.assert_allclose(applied(second), [0, -0.1, -0.2, -0.3], atol=1e-6)


def test_a_device_that_hears_nothing_goes_safe_and_comes_back(live):
    live.control()
    graphs = Graphs()
    device = live.device(watchdog_s=0.1, safe=np.float32([7]), graphs=graphs)
    live.run(10)
    port = live.controller.port.address[1]
    live.controller.port.socket.close()  # as SIGKILL does
    live.run(20)
    silent = applied(device)[10:]
    assert silent[:4] == pytest.approx([-0.9] * 4)  # held until the watchdog's 100 ms are over
    assert silent[6:] == [7.0] * 14
    live.control(port=port)
    live.run(10)
    assert applied(device)[32:] == pytest.approx([-0.1 * slot for slot in range(32, 40)])


def test_a_device_that_starts_anew_is_controlled_anew(live):
    live.control()
    first = live.device()
    live.run(10)
    live.devices.clear()
    first.port.socket.close()
    second = live.device()
    live.run(5)
    np.testing.assert_allclose(applied(second), [-0.1 * slot for slot in range(5)], atol=1e-6)


def test_a_controller_that_hears_nothing_for_long_says_nothing(live):
    live.control()
    device = live.device(weather=weather(lost=set(range(3, 500))))
    live.run(150)
    sent = live.controller.counts["commands"]
    assert sent <= 3 + 64
    live.run(20)
    assert live.controller.counts["commands"] == sent
    assert applied(device)[-10:] == [0.0] * 10  # safe


@pytest.mark.parametrize("spoilt", [np.nan, np.inf, 21.0])
def test_a_command_out_of_range_never_leaves(live, spoilt, capsys):
    graphs = Graphs()
    live.control(graphs=graphs)
    device = live.device()
    live.run(5)
    graphs.spoil = spoilt
    live.run(5)
    assert all(np.isfinite(applied(device)))
    if np.isfinite(spoilt):
        assert applied(device)[5:] == [20.0] * 5  # clipped
    elif np.isinf(spoilt):
        assert max(applied(device)) <= 20
    else:
        assert live.controller.counts["refused"] == 5
        assert capsys.readouterr().err.count("the model's command for device 0 is no finite number") == 1


def attack(rng: random.Random, recorded: list[bytes], seal: Seal, changes: bool):
    """One hostile datagram: random, truncated, replayed, oversized, sealed with another key, or with a bit changed."""
    kind = rng.randrange(5 + changes)
    if kind == 0 or not recorded:
        return rng.randbytes(rng.randrange(0, 100))
    if kind == 1:
        return rng.choice(recorded)[: rng.randrange(0, 60)]
    if kind == 2:
        return rng.choice(recorded)
    if kind == 3:
        return rng.choice(recorded) + bytes(rng.randrange(LARGEST, 3 * LARGEST))
    head = Header(UPDATE, rng.randrange(12), rng.getrandbits(64), rng.getrandbits(32), rng.getrandbits(64), 1, 10**6)
    if kind == 4:
        return seal.close(head, Update(0, b"\x63\x63").pack())
    changed = bytearray(rng.choice(recorded))
    changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


@pytest.mark.parametrize("sealed", [True, False])
def test_hostile_datagrams_change_nothing(live, tmp_path, sealed):
    """Without a key only those who cannot change a packet on its way are kept out."""
    (tmp_path / "key").write_text("ab" * 32)
    (tmp_path / "other").write_text("cd" * 32)
    key = read_key(str(tmp_path / "key") if sealed else None)
    other = read_key(str(tmp_path / "other") if sealed else None)
    live.control(devices=10, seal=key)
    devices = [live.device(numbers=(number,), seal=key) for number in range(10)]
    recorded, rng = [], random.Random(0)
    enemy = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for device, _ in live.devices:
        send = device.port.send
        device.port.send = lambda data, address=None, send=send: (recorded.append(data), send(data, address))

    def hostile(address):
        for _ in range(12):
            enemy.sendto(attack(rng, recorded[-500:], other, changes=sealed), address)

    live.run(30, hostile)
    enemy.close()
    for device in devices:
        np.testing.assert_allclose(applied(device), [-0.1 * slot for slot in range(30)], atol=1e-6)
    controller = live.controller
    assert controller.counts["updates"] == 10 * 30
    assert controller.counts["commands"] == 10 * 30
    assert controller.port.received == 10 + 10 * 30 + 12 * world.TICKS * 30
    assert sum(controller.port.drops.values()) == 10 + 12 * world.TICKS * 30  # each counted, the ten hellos too
    reasons = {"size", "version", "kind", "replayed"} | ({"forged"} if sealed else {"session", "shape", "device"})
    assert all(controller.port.drops[reason] for reason in reasons)
    assert set(controller.port.drops) == set(DROPS)
    assert not controller.waiting


def test_an_unknown_device_is_dropped_and_counted_and_both_ends_tell(live, capsys):
    live.control(devices=2)
    device = live.device(numbers=(2,))
    live.run(5)
    assert live.controller.port.drops["device"] == 6
    assert applied(device) == [0.0] * 5
    live.run(100)
    there, here = capsys.readouterr().err.splitlines()
    assert there.startswith("tsjepa controller: a datagram is dropped: device (a --number that is not known here) from")
    place = f"127.0.0.1:{live.controller.port.address[1]}"
    assert here.startswith(f"tsjepa device: no command came from {place} in 1.5 s for device 2 (datagrams sent there: ")
    assert "--num_devices is above 2, the --number here" in here
    assert device.summary()["devices_without_a_command"] == [2]


def test_a_silence_is_told_of_once_until_a_command_comes(live, capsys):
    live.control(devices=3)
    device = live.device(numbers=(0, 1, 2))
    live.run(10)
    port = live.controller.port.address[1]
    for silences in (1, 2):
        live.controller.port.socket.close()
        live.run(70)
        assert not capsys.readouterr().err.count("no command came")  # 1.4 s are no silence
        live.run(100)
        said = capsys.readouterr().err
        assert said.count("no command came") == 1 and "for 3 devices, 0 to 2 (" in said, silences
        live.control(devices=3, port=port)
        live.run(10)
    assert device.summary()["devices_without_a_command"] == []


@pytest.mark.parametrize("answered", [False, True])
def test_a_device_that_waits_for_its_controller_tells_what_to_check(live, monkeypatch, capsys, answered):
    """It knocks ten times a second. Its number is not known there, or is that of all but the last of its devices."""
    live.control(devices=2)
    numbers = [0, 1, 2] if answered else [7]
    address = live.controller.port.address[:2]
    device, stop, knocks = Device(Graphs(), Machine(len(numbers)), numbers, address, Seal()), asyncio.Event(), []

    async def sleep(seconds):
        live.now += seconds
        knocks.append(live.now)
        live.controller.port.drain()
        device.port.drain()
        if len(knocks) == 40:
            stop.set()

    monkeypatch.setattr(device_loop, "asyncio", SimpleNamespace(sleep=sleep))
    asyncio.run(device.run(None, stop))
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("tsjepa device")]
    assert len(said) == 1
    sent = re.search(rf"in 1\.5 s for device {numbers[-1]} \(datagrams sent there: (\d+)\)", said[0])
    assert 15 <= int(sent[1]) - len(numbers) + 1 <= 20
    assert device.summary()["devices_without_a_command"] == [numbers[-1]]


def test_a_log_that_cannot_be_written_ends_and_the_loop_goes_on(live, capsys):
    live.control().log = SimpleNamespace(write=lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    device = live.device()
    live.run(5)
    np.testing.assert_allclose(applied(device), [-0.1 * slot for slot in range(5)], atol=1e-6)
    assert capsys.readouterr().err.count("the log ends here, it cannot be written (No space left on device)") == 1


def test_an_address_that_is_taken_or_that_there_is_not_is_named():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        number = taken.getsockname()[1]
        with pytest.raises(OSError, match=rf"listen at 127\.0\.0\.1:{number} \(.*\): .* give --bind a free port"):
            Port(print, bind=("127.0.0.1", number))
    with pytest.raises(OSError, match=r"^\[::1::\]:1 cannot be reached \(.*\): give --controller"):
        Port(print, connect=("::1::", 1))
    with pytest.raises(OSError, match=r"^a\.\.b:1 cannot be reached"):
        Port(print, connect=("a..b", 1))


def test_what_was_dropped_is_listed_by_its_reason():
    assert dropped_line(dict.fromkeys(DROPS, 0)) == "0 datagrams dropped"
    expected = (
        "5 datagrams dropped: 2 forged (another --key, or changed on its way), 3 stale (an answer to nothing recent)"
    )
    assert dropped_line({"size": 0, "forged": 2, "stale": 3}) == expected


def test_a_controller_of_another_key_is_not_obeyed(live, tmp_path):
    for name in ("ab", "cd"):
        (tmp_path / name).write_text(name * 32)
    live.control(seal=read_key(str(tmp_path / "ab")))
    device = live.device(seal=read_key(str(tmp_path / "cd")))
    live.run(5)
    assert applied(device) == [0.0] * 5
    assert live.controller.port.drops["forged"] == 6


def test_a_device_takes_nothing_that_its_controller_did_not_send(live):
    live.control()
    device = live.device()
    live.run(3)
    rogue = Link(0)
    rogue.peer = device.links[0].session  # as whoever can read along knows it
    head = rogue.header(packet.COMMAND, 3)._replace(echo=10**6)
    live.controller.port.send(
        head.pack() + packet.Command(2, True, np.float32([[9]])).pack(), live.controller.addresses[0]
    )
    live.run(3)
    assert 9.0 not in applied(device)
    assert device.port.drops["stale"] == 1


@pytest.mark.parametrize("slot", [2**31 - 1, -(2**31)])
def test_an_update_of_a_slot_that_no_command_can_follow_is_dropped(live, slot):
    controller, device = live.control(), live.device()
    live.run(5)
    header = device.links[0].header(UPDATE, slot)
    datagram = Seal(None).close(header, Update(0, bytes(controller.graphs.payload_bytes)).pack())
    with pytest.raises(Dropped, match="range"):
        controller.hear(datagram, ("device", 1))
    live.run(5)
    assert controller.counts["updates"] >= 9
