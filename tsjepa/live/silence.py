"""Says when no command comes: for which devices, from where, and what to check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tsjepa.live.notices import tell
from tsjepa.live.port import Port, dropped_line

SILENCE_S = 1.5
CHECKS = 4  # in a silence; devices that fall silent together are told of together


class Silence:
    """Tells of devices that have had no command for some time, once until the next one comes.

    Args:
        port: connected to the controller.
        place: HOST:PORT of the controller.
        patience_s: seconds without a command.
    """

    def __init__(self, port: Port, place: str, patience_s: float) -> None:
        self.port, self.place, self.patience_s = port, place, patience_s
        self.told: set[int] = set()
        self.next_check = 0.0

    def check(self, now: float, heard: Mapping[int, float]) -> None:
        """Tells what there is to tell.

        Args:
            now: seconds by any clock.
            heard: by the number of a device, when its last command came.
        """
        if now < self.next_check:
            return
        self.next_check = now + self.patience_s / CHECKS
        silent = {number for number, at in heard.items() if now - at > self.patience_s}
        if silent - self.told:
            tell("device", self.sentence(sorted(silent), f"in {self.patience_s:.1f} s"))
        self.told = silent

    def sentence(self, numbers: Sequence[int], when: str) -> str:
        """What is known of the silence of devices, in their order, and what to check."""
        first, last = numbers[0], numbers[-1]
        who = f"device {last}" if first == last else f"{len(numbers)} devices, {first} to {last}"
        facts = [f"datagrams sent there: {self.port.sent}"]
        facts += [f"the network's answer: {self.port.trouble}"] if self.port.trouble else []
        facts += [dropped_line(self.port.drops)] if any(self.port.drops.values()) else []
        return (
            f"no command came from {self.place} {when} for {who} ({'; '.join(facts)}). Check that `tsjepa controller` "
            f"runs there with the same graphs and --key, and that its --num_devices is above {last}, the --number here."
        )
