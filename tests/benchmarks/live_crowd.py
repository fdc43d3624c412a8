"""What meets a controller in the benchmark of the live loop: many devices that replay payloads, and an enemy."""

import json
import random
import select
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from tsjepa.live.link import Link
from tsjepa.live.packet import HELLO, LARGEST, UPDATE, Dropped, Update, read_command, read_header
from tsjepa.live.plans import Plans
from tsjepa.live.port import parse_address
from tsjepa.live.seal import Seal
from tsjepa.live.timing import Durations

SLOT = 0.02
LOW, HIGH = np.float32([-20.0]), np.float32([20.0])


def replay(address: str, devices: int, seconds: float, payload_bytes: int, every_second: Callable[[], None]) -> dict:
    """Sends updates of ``devices``, spread over the slot; what came back, and how long after the update."""
    port, rng = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), np.random.default_rng(0)
    port.connect(parse_address(address))
    port.setblocking(False)
    port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    links, plans = [Link(number) for number in range(devices)], [Plans() for _ in range(devices)]
    payloads = [rng.integers(0, 255, payload_bytes, np.uint8).tobytes() for _ in range(64)]
    answered, sent_at = Durations(), np.zeros((devices, 64))
    counts = {"sent": 0, "commands": 0, "prompt": 0, "late_sends": 0}

    def hear(slot: int) -> None:
        while True:
            try:
                data = port.recv(LARGEST)
            except BlockingIOError:
                return
            header = read_header(data)
            try:
                links[header.device].accept(header)
            except Dropped:
                continue
            if header.kind == HELLO:
                continue
            command = read_command(data[32:], LOW, HIGH)
            counts["commands"] += 1
            if command.prompt:
                counts["prompt"] += 1
                plans[header.device].measure(slot - command.answers)
                answered.add(time.monotonic() - sent_at[header.device, command.answers % 64])

    for link in links:
        port.send(link.header(HELLO).pack())
        time.sleep(0.002)
        hear(0)
    started, tick = time.monotonic(), 0
    while (when := tick * SLOT / devices) < seconds:
        while (left := started + when - time.monotonic()) > 0:
            if select.select([port], [], [], left)[0]:
                hear(tick // devices)
        counts["late_sends"] += left < -1e-3
        slot, number = divmod(tick, devices)
        update = Update(plans[number].round_trip, payloads[tick % 64])
        sent_at[number, slot % 64] = time.monotonic()
        port.send(links[number].header(UPDATE, slot).pack() + update.pack())
        counts["sent"] += 1
        if tick % (devices * 50) == 0:
            every_second()
        tick += 1
    port.close()
    return {**counts, "update_to_command_ms": answered.summary()}


class Relay(threading.Thread):
    """Passes datagrams on between a device process and its controller, and keeps the device's last ones."""

    def __init__(self, controller: str) -> None:
        super().__init__(daemon=True)
        self.near, self.far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self.near.bind(("127.0.0.1", 0))
        self.far.connect(parse_address(controller))
        self.address = f"127.0.0.1:{self.near.getsockname()[1]}"
        self.recorded: deque[bytes] = deque(maxlen=2000)

    def run(self) -> None:
        """For as long as the process lives."""
        device = None
        while True:
            for ready in select.select([self.near, self.far], [], [])[0]:
                try:
                    data, source = ready.recvfrom(LARGEST)
                    if ready is self.near:
                        device = source
                        self.recorded.append(data)
                        self.far.send(data)
                    elif device is not None:
                        self.near.sendto(data, device)
                except OSError:
                    continue


def attack(address: str, count: int, recorded: str) -> dict:
    """Sends hostile datagrams as fast as it can: random, truncated, replayed, oversized, and with another key's seal.

    Args:
        address: of the controller.
        count: datagrams.
        recorded: file with sealed updates of this very run, in lines of hexadecimal digits.
    """
    enemy, rng, target = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), random.Random(0), parse_address(address)
    known = [bytes.fromhex(line) for line in Path(recorded).read_text().split()]
    other = Seal(ChaCha20Poly1305(bytes(32)))
    kinds = {"random": 0, "truncated": 0, "replayed": 0, "oversized": 0, "wrong key": 0}
    started = time.monotonic()
    for number in range(count):
        kind = (*kinds,)[number % len(kinds)]
        data = rng.choice(known)
        if kind == "random":
            data = rng.randbytes(rng.randrange(1, 400))
        elif kind == "truncated":
            data = data[: rng.randrange(len(data))]
        elif kind == "oversized":
            data = data + bytes(rng.randrange(LARGEST, 2 * LARGEST))
        elif kind == "wrong key":
            data = other.close(read_header(data)._replace(sequence=number), data[32:-16])
        enemy.sendto(data, target)
        kinds[kind] += 1
    enemy.close()
    return {"hostile": kinds, "seconds": time.monotonic() - started}


def waits_for_hello(address: str) -> Callable[[], float]:
    """Listens in a controller's place; the function returns when the first datagram has come."""
    port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port.bind(parse_address(address))
    port.settimeout(120)

    def wait() -> float:
        port.recv(LARGEST)
        now = time.monotonic()
        port.close()
        return now

    return wait


if __name__ == "__main__":  # the enemy is a process of its own
    print(json.dumps(attack(sys.argv[1], int(sys.argv[2]), sys.argv[3])))
