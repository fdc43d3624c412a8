"""Joules that each device spends on its updates."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, active_rows, number_spec
from tsjepa.radio.energy import EnergyModel
from tsjepa.radio.link import BLOCK_BANDWIDTH_HZ, UNIT_DURATION_S, tx_power_for_target_dbm


class Energy(SlotTransform):
    """Writes ``energy_j`` [*B] float32: what a device's camera, encoder and radio take in this slot.

    A silent device takes nothing, or ``encode_j`` if it ``watches``: it draws and encodes in every slot to know its
    need or to remember.

    Reads ``scheduled``, ``resource_units`` and ``transmissions`` where they are written, and ``path_loss_db`` for the
    power that reaches ``snr_target_db``.

    Args:
        model: joules and watts.
        tx_power_dbm: power in one resource block, unless ``snr_target_db`` is given and there is a path loss.
        snr_target_db: mean SNR that power control reaches; one, or one a device [I].
    """

    watches = False

    def __init__(self, model: EnergyModel, tx_power_dbm: float = 23.0, snr_target_db: float | Tensor | None = None):
        super().__init__(in_keys=[], out_keys=["energy_j"])
        self.model, self.tx_power_dbm, self.snr_target_db = model, tx_power_dbm, snr_target_db

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        return {"energy_j": number_spec(incoming)}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        sent = active_rows(current, "scheduled", None)
        loss, units = current.get("path_loss_db", None), current.get("resource_units", None)
        power = torch.full(sent.shape, float(self.tx_power_dbm), dtype=torch.float64)
        if self.snr_target_db is not None and loss is not None:
            power = tx_power_for_target_dbm(loss, self.snr_target_db, BLOCK_BANDWIDTH_HZ)
        transmissions = current.get("transmissions", None)
        airtime = torch.full(sent.shape, self.model.airtime_s, dtype=torch.float64)
        if units is not None:
            # a grant has room for the repetition too, which is used where there is one
            airtime = units * UNIT_DURATION_S / (1 if transmissions is None else 2)
        if transmissions is not None:
            airtime = airtime * transmissions
        silent = self.model.encode_j if self.watches else 0.0
        return {"energy_j": torch.where(sent, self.model.joules(power, airtime), silent).to(torch.float32)}
