"""Sessions and sequence numbers: each packet counts once, and none of an earlier life."""

import pytest

from tsjepa.live import link as links
from tsjepa.live.link import WINDOW, Link
from tsjepa.live.packet import COMMAND, HELLO, UPDATE, Dropped


def greeted() -> tuple[Link, Link]:
    """A device and a controller that know each other."""
    device, controller = Link(3), Link(3)
    greet(device, controller)
    return device, controller


def greet(device: Link, controller: Link) -> None:
    knock = device.header(HELLO)
    with pytest.raises(Dropped, match=r"session|stale"):
        controller.accept(knock)
    device.accept(controller.hello(knock))
    controller.accept(device.header(UPDATE))


def test_nothing_counts_before_both_know_each_other():
    device, controller = Link(3), Link(3)
    with pytest.raises(Dropped, match="session"):
        controller.accept(device.header(UPDATE))
    with pytest.raises(Dropped, match="session"):
        device.accept(controller.header(COMMAND))
    greet(device, controller)
    device.accept(controller.header(COMMAND))


def test_a_packet_counts_once_also_when_overtaken():
    device, controller = greeted()
    sent = [device.header(UPDATE) for _ in range(WINDOW)]
    order = [sent[5], sent[2], sent[-1], sent[0]]
    for packet in order:
        controller.accept(packet)
    for packet in order:
        with pytest.raises(Dropped, match="replayed"):
            controller.accept(packet)
    for packet in sent:
        if packet not in order:
            controller.accept(packet)


def test_what_was_overtaken_by_too_many_counts_as_a_replay():
    device, controller = greeted()
    controller.accept(device.header(UPDATE))  # so that it has heard of more than its own hello
    old = device.header(UPDATE)
    for _ in range(WINDOW):
        newest = device.header(UPDATE)
    controller.accept(newest)
    with pytest.raises(Dropped, match="replayed"):
        controller.accept(old)


def test_an_answer_to_nothing_recent_is_stale_until_a_hello():
    device, controller = greeted()
    for _ in range(WINDOW):
        controller.header(COMMAND)  # none of them arrives
    late = device.header(UPDATE)
    with pytest.raises(Dropped, match="stale"):
        controller.accept(late)
    device.accept(controller.hello(late))
    controller.accept(device.header(UPDATE))


def test_packets_of_an_earlier_life_of_the_device_never_count_again():
    device, controller = greeted()
    recorded = [device.header(UPDATE) for _ in range(10)]
    again = Link(3)
    greet(again, controller)
    for packet in recorded:
        with pytest.raises(Dropped, match="session"):
            controller.accept(packet)
    controller.accept(again.header(UPDATE))


def test_packets_of_an_earlier_life_of_the_controller_never_count_again():
    device, controller = greeted()
    recorded = [controller.header(COMMAND) for _ in range(10)]
    again = Link(3)
    refused = device.header(UPDATE)
    with pytest.raises(Dropped, match="session"):
        again.accept(refused)
    device.accept(again.hello(refused))
    again.accept(device.header(UPDATE))
    for packet in recorded:
        with pytest.raises(Dropped, match="session"):
            device.accept(packet)
    device.accept(again.header(COMMAND))


def test_a_replayed_hello_changes_nothing():
    device, controller = Link(3), Link(3)
    knock = device.header(HELLO)
    hello = controller.hello(knock)
    device.accept(hello)
    controller.accept(device.header(UPDATE))
    with pytest.raises(Dropped):
        device.accept(hello)
    with pytest.raises(Dropped):
        controller.accept(knock)
    device.accept(controller.header(COMMAND))
    controller.accept(device.header(UPDATE))


def test_a_session_ends_before_its_numbers_come_again(monkeypatch):
    monkeypatch.setattr(links, "LAST_SEQUENCE", 5)
    device, controller = greeted()
    seen = set()
    for _ in range(20):
        packet = device.header(UPDATE)
        assert (packet.session, packet.sequence) not in seen
        seen.add((packet.session, packet.sequence))
        try:
            controller.accept(packet)
        except Dropped:
            device.accept(controller.hello(packet))
    assert len({session for session, _ in seen}) > 3
