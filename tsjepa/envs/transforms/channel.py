"""The radio channel of every device in every slot."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, flag_spec, number_spec
from tsjepa.radio.deployment import PAPER_LITERAL, Deployment, large_scale
from tsjepa.radio.fading import jakes_gain, rayleigh_power
from tsjepa.radio.link import BLOCK_BANDWIDTH_HZ, TOTAL_BANDWIDTH_HZ, mean_snr, sinr, tx_power_for_target_dbm
from tsjepa.radio.loss import GilbertElliott, IidLoss, erased


class Channel(SlotTransform):
    """Draws each device's channel: large-scale per episode, fading (and packet loss) per slot.

    Every value is a pure function of (seed, device, episode, slot). So whoever is scheduled sees the same channel, and
    a device that resets leaves the others' channels alone. ``env.reset()`` goes on to the devices' next episode; two
    envs that are built alike replay the same episodes. Workers of a ``SerialEnv`` need different seeds.

    Writes, one per device: ``snr`` and ``mean_snr`` (linear, float32), ``path_loss_db`` (shadowing included), ``los``,
    the counters ``channel_episode`` and ``channel_slot``, and with a loss model ``loss_probability``, ``erased`` (a
    packet sent now is lost whatever its SNR) and ``loss_state``; with correlated fading ``gain`` [*B, 2] float64, real
    and imaginary part of the fading, whose square is ``snr`` over ``mean_snr``; with a repetition ``repeated_snr``,
    that of a packet which is sent again within the slot.

    Args:
        deployment: positions and large-scale propagation.
        tx_power_dbm: transmit power, unless ``snr_target_db`` is given.
        snr_target_db: power control that brings the mean SNR of every device to this target; one, or one a device [I].
        bandwidth_hz: bandwidth one transmission uses; the noise is in proportion.
        fading: "rayleigh" or "none".
        max_doppler_hz: 0 for fading that is independent from slot to slot, else the Doppler shift of Jakes' spectrum.
        sampling_interval: seconds per slot; only correlated fading depends on it.
        loss: packet loss beside the SNR, or None.
        interference_rise_db: by how much interference lifts the noise floor; ``snr`` and ``mean_snr`` are then SINRs.
        repetition_s: seconds from a packet to its repetition, or None; the fading of the two is independent unless it
            is correlated.
        seed: seed of all the channel's streams.
    """

    carried: tuple[str, ...] = ("channel_episode", "channel_slot", "path_loss_db", "los")

    def __init__(
        self,
        deployment: Deployment = Deployment(),  # noqa: B008 - frozen
        tx_power_dbm: float = 23.0,
        snr_target_db: float | Tensor | None = None,
        bandwidth_hz: float = BLOCK_BANDWIDTH_HZ,
        fading: str = "rayleigh",
        max_doppler_hz: float = 0.0,
        sampling_interval: float = 0.02,
        loss: IidLoss | GilbertElliott | None = None,
        interference_rise_db: float = 0.0,
        repetition_s: float | None = None,
        seed: int = 0,
    ):
        if fading not in ("rayleigh", "none"):
            raise ValueError(f"unknown fading {fading!r}: choose 'rayleigh' or 'none'")
        if max_doppler_hz < 0:
            raise ValueError(f"max_doppler_hz {max_doppler_hz:g} must be at least 0")
        keys = ["snr", "mean_snr", *self.carried]
        if loss is not None:
            keys += ["loss_probability", "erased", "loss_state"]
            self.carried = (*self.carried, "loss_state")
        self.correlated = fading == "rayleigh" and max_doppler_hz > 0
        keys += ["gain"] * self.correlated + ["repeated_snr"] * (repetition_s is not None)
        super().__init__(in_keys=[], out_keys=keys)
        self.deployment = deployment
        self.tx_power_dbm = tx_power_dbm
        self.snr_target_db = snr_target_db
        self.bandwidth_hz = bandwidth_hz
        self.fading = fading
        self.max_doppler_hz = max_doppler_hz
        self.sampling_interval = sampling_interval
        self.loss = loss
        self.interference_rise_db = interference_rise_db
        self.repetition_s = repetition_s
        self.seed = seed

    @classmethod
    def paper_literal(cls, tx_power_dbm: float = 23.0, seed: int = 0) -> "Channel":
        """The channel as printed: NLoS at 50 m without shadowing, and the whole 20 MHz for every device."""
        return cls(PAPER_LITERAL, tx_power_dbm=tx_power_dbm, bandwidth_hz=TOTAL_BANDWIDTH_HZ, seed=seed)

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        specs = {key: number_spec(incoming) for key in ("snr", "mean_snr", "path_loss_db")}
        specs |= {key: number_spec(incoming, dtype=torch.int64) for key in ("channel_episode", "channel_slot")}
        specs["los"] = flag_spec(incoming)
        if self.correlated:
            specs["gain"] = number_spec(incoming, 2, dtype=torch.float64)
        if self.repetition_s is not None:
            specs["repeated_snr"] = number_spec(incoming)
        if self.loss is not None:
            specs["loss_probability"] = number_spec(incoming)
            specs |= {key: flag_spec(incoming) for key in ("erased", "loss_state")}
        return specs

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        device = device_index(current)
        episode = before["channel_episode"] + 1 if before else torch.zeros_like(device)
        path_loss_db, los = large_scale(self.deployment, self.seed, device, episode)
        start = {
            "channel_episode": episode,
            "channel_slot": torch.full_like(device, -1),
            "path_loss_db": path_loss_db.to(torch.float32),
            "los": los,
        }
        if self.loss is not None:
            start["loss_state"] = self.loss.start(self.seed, device, episode)
        return start

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        device, episode, slot = device_index(current), previous["channel_episode"], previous["channel_slot"] + 1
        values = {key: previous[key] for key in ("channel_episode", "path_loss_db", "los")}
        mean = self._mean_snr(values["path_loss_db"])
        values |= {"channel_slot": slot, "mean_snr": mean.to(torch.float32)}
        if self.correlated:
            gain = self._gain(device, episode, slot)
            values |= {"gain": gain, "snr": (mean * gain.square().sum(-1)).to(torch.float32)}
        else:
            values["snr"] = (mean * self._power(device, episode, slot, "fading")).to(torch.float32)
        if self.repetition_s is not None and self.correlated:
            again = self._gain(device, episode, slot, self.repetition_s).square().sum(-1)
            values["repeated_snr"] = (mean * again).to(torch.float32)
        elif self.repetition_s is not None:
            values["repeated_snr"] = (mean * self._power(device, episode, slot, "repetition")).to(torch.float32)
        if self.loss is not None:
            state = self.loss.advance(previous["loss_state"], self.seed, device, episode, slot)
            probability = self.loss.loss_probability(state)
            lost = erased(probability, self.seed, device, episode, slot)
            values |= {"loss_state": state, "loss_probability": probability, "erased": lost}
        return values

    def _mean_snr(self, path_loss_db: Tensor) -> Tensor:
        power = self.tx_power_dbm
        if self.snr_target_db is not None:
            power = tx_power_for_target_dbm(path_loss_db, self.snr_target_db, self.bandwidth_hz)
        mean = mean_snr(path_loss_db, power, self.bandwidth_hz)
        return sinr(mean, self.interference_rise_db) if self.interference_rise_db else mean

    def _power(self, device: Tensor, episode: Tensor, slot: Tensor, stream: str) -> Tensor:
        if self.fading == "none":
            return torch.ones_like(slot, dtype=torch.float64)
        return rayleigh_power(self.seed, device, episode, slot, stream)

    def _gain(self, device: Tensor, episode: Tensor, slot: Tensor, later_s: float = 0.0) -> Tensor:
        time = slot.to(torch.float64) * self.sampling_interval + later_s
        return torch.stack(jakes_gain(self.seed, device, episode, time, self.max_doppler_hz), -1)


def device_index(current: TensorDictBase) -> Tensor:
    """Number of each row [*B], int64."""
    return torch.arange(current.batch_size.numel(), device=current.device).view(current.batch_size)
