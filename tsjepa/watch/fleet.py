"""A fleet that runs on and on, while its size and its radio may change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from tensordict import TensorDictBase

from tsjepa.evaluation.rollouts import Loop, one_slot
from tsjepa.evaluation.shown import believed
from tsjepa.watch.setting import Setting, Snapshot, with_setting

FLIGHTS = ("in_flight_slot", "command_flight_slot")  # -1 where no packet is
DOWN_S = 2.0  # seconds that a device which has failed is shown before it starts anew
MEMORY_S = 2.0  # time constant of the means that are shown
PUSH_SLOTS = 1.5  # of the actuator's largest command: a blow that most controllers survive
# of the machines and of what the far end knows of them; channels and queues begin anew with a new radio, and what was
# in flight is gone
KEPT = ("physics_state", "state", "reference", "scene", "episode", "slot")
KEPT += ("belief", "informed", "received", "held_command", "age_of_information", "device_belief")
KEPT += ("received_slot", "command_history", "command_buffer", "command_slot", "sent_buffer", "sent_slot")
KEPT += ("belief_trail", "recent_commands", "predicted_slots")  # of a predictor of several strides


class RunningFleet:
    """Closed loops that never end; a device that has failed starts anew after a while.

    Args:
        loop: plant, controller and what else of the radio no slider sets.
        setting: where the sliders stand.
        seed: of starts, noise, channels and losses.

    Raises:
        ValueError: a setting that does not fit the controller.
    """

    def __init__(self, loop: Loop, setting: Setting, seed: int = 0) -> None:
        self.loop, self.seed, self.slots_run, self.complaint = loop, seed, 0, ""
        self._begin(setting)

    def change(self, setting: Setting) -> None:
        """Runs on with another setting: the machines go on from where they are, more are added or the last ones go.

        A setting that cannot be is not taken; the snapshots' complaint says why.
        """
        if setting == self.setting:
            return
        before, kept = self.now, (self.score, self.down, self.heard)
        try:
            self._begin(setting)
        except ValueError as error:
            self.complaint = str(error)
            return
        self.complaint = ""
        carry_on(before, self.now)
        for old, new in zip(kept, (self.score, self.down, self.heard), strict=True):
            both = min(len(old), len(new))
            new[:both] = old[:both]

    def push(self, device: int) -> None:
        """Hits one device; its controller is not told. One that has gone with its fleet's size is not hit."""
        if device < self.setting.devices:
            self.now = self.env.base_env.push(self.now, device, PUSH_SLOTS)

    @torch.no_grad()
    def slot(self) -> None:
        """Runs one slot of all devices."""
        now = self.policy(self.now)
        self.belief = believed(self.loop, now, self.belief)
        self.sent |= now["scheduled"]
        self.delivered |= now["delivered"]
        self.heard |= now["delivered"]
        now = one_slot(self.env, now)
        failed = torch.as_tensor(np.asarray(self.loop.plant.failed(now["state"])))
        score = now["reward"][..., 0].masked_fill(failed, 0.0)
        share = self.loop.plant.spec.slot / MEMORY_S
        self.score = torch.lerp(self.score, score, min(1.0, share))
        bits = float(now["payload_bits"].sum()) / self.loop.plant.spec.slot
        self.bit_rate += min(1.0, share) * (bits - self.bit_rate)
        self.down = torch.where(failed, self.down + 1, 0)
        again = self.down * self.loop.plant.spec.slot >= DOWN_S
        if bool(again.any()):
            now = self.env.reset(now.set("_reset", again.unsqueeze(-1)))
            self.heard &= ~again
            self.down[again] = 0
        self.now = now
        self.slots_run += 1

    def snapshot(self, pace: float = 1.0) -> Snapshot:
        """What is to be shown, and since the snapshot before who has sent."""
        failed = np.asarray(self.loop.plant.failed(self.now["state"]))
        shown = Snapshot(
            setting=replace(self.setting),
            slot=self.slots_run,
            pace=pace,
            complaint=self.complaint,
            scenes=self.now["scene"][:, -1].numpy().copy(),
            beliefs=None if self.belief is None else self.belief.numpy().copy(),
            heard=self.heard.numpy().copy(),
            sent=self.sent.numpy().copy(),
            delivered=self.delivered.numpy().copy(),
            age=self.now["age_of_information"].numpy().copy(),
            score=self.score.numpy().copy(),
            failed=failed,
            bit_rate=self.bit_rate,
        )
        self.sent, self.delivered = torch.zeros_like(self.sent), torch.zeros_like(self.delivered)
        return shown

    def _begin(self, setting: Setting) -> None:
        loop = with_setting(self.loop, setting)
        env, policy = loop.env(self.seed), loop.policy()
        self.now, self.env, self.policy = env.reset(), env, policy
        self.loop, self.setting, count = loop, replace(setting), setting.devices
        self.belief, self.bit_rate = believed(loop, self.now, None), 0.0
        self.score, self.down = torch.zeros(count), torch.zeros(count, dtype=torch.int64)
        self.sent, self.delivered, self.heard = torch.zeros(3, count, dtype=torch.bool).unbind()


def carry_on(before: TensorDictBase, now: TensorDictBase) -> None:
    """Puts machines and beliefs of the fleet ``before`` into ``now``, as many as both have.

    What has another shape there, such as frames that are received in place of embeddings, begins anew.
    """
    both = min(before.shape[0], now.shape[0])
    for key in KEPT:
        old, new = before.get(key, None), now.get(key, None)
        if old is not None and new is not None and old.shape[1:] == new.shape[1:]:
            new[:both] = old[:both]
    for key in FLIGHTS:
        if (numbers := now.get(key, None)) is not None:
            numbers[:both] = -1
