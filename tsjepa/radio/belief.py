"""What the base station believes of each link: one class for each kind of channel knowledge.

All have three methods, pure functions of tensors with I devices on the last dimension and any batch before it:

    start(shape, device) -> memory [*shape, width], float64
    restart(memory) -> memory at the start of an episode, with what outlives the one before
    step(memory, mean_snr, snr, sent, arrived) -> (memory, Link)

``step`` is called once a slot: with the channel of this slot and the outcome of the slot before, it returns what may be
known of this slot. ``mean_snr`` and ``snr`` [..., I] are linear; each class looks only at what it is allowed to know.
Hidden loss states are never known: their probability follows from the acknowledgements. ``PredictedCsi`` is also given
the complex gains.
"""

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from tsjepa.radio import feedback, posterior
from tsjepa.radio.decoding import Decoding, as_decoding
from tsjepa.radio.feedback import AckLearned
from tsjepa.radio.knowledge import Link
from tsjepa.radio.loss import GilbertElliott, IidLoss
from tsjepa.radio.prediction import gain_predictor

_UNKNOWN = -1.0  # an SNR that was not measured
_LAGS = 1001


@cache
def _correlations(max_doppler_hz: float, slot_s: float, fading: str) -> Tensor:
    if fading == "none":
        return torch.ones(_LAGS, dtype=torch.float64)
    table = posterior.fading_correlation(slot_s * torch.arange(_LAGS, dtype=torch.float64), max_doppler_hz)
    table[-1] = 0.0
    return table


@dataclass(frozen=True)
class PerfectCsi:
    """The SNR of this slot is known; a measurement of the uplink by the base station costs no bits.

    Args:
        decoding: when a packet is decoded; a number is the linear SNR from which on it is.
        loss: the model of packet losses beside the SNR, its parameters known, its state not.
        max_doppler_hz: 0 for fading that is independent from slot to slot, else that of Jakes' spectrum.
        slot_s: seconds per slot; only correlated fading depends on it.
        fading: "rayleigh" or "none".
    """

    decoding: float | Decoding
    loss: IidLoss | GilbertElliott | None = None
    max_doppler_hz: float = 0.0
    slot_s: float = 0.02
    fading: str = "rayleigh"

    @property
    def decoder(self) -> Decoding:
        return as_decoding(self.decoding)

    @property
    def width(self) -> int:
        """Numbers per device that are remembered: P[bad loss state] and P[decodable], and what a subclass adds."""
        return 2

    def start(self, shape: tuple[int, ...], device: torch.device | str = "cpu") -> Tensor:
        memory = torch.zeros((*shape, self.width), dtype=torch.float64, device=device)
        memory[..., 0] = self.loss.bad_share if isinstance(self.loss, GilbertElliott) else 0.0
        return memory

    def restart(self, memory: Tensor) -> Tensor:
        return self.start(memory.shape[:-1], memory.device)

    def step(self, memory: Tensor, mean_snr: Tensor, snr: Tensor, sent: Tensor, arrived: Tensor) -> tuple[Tensor, Link]:
        bad = self._bad(memory[..., 0], sent, arrived, memory[..., 1])
        decodable = self.decoder.given_snr(snr, mean_snr)
        return torch.stack((bad, decodable), -1), self._link(snr, decodable, bad)

    def correlation(self, slots: Tensor | int) -> Tensor:
        """Correlation of the fading over a lag in whole slots, [...] float64; 0 beyond a thousand."""
        table = _correlations(self.max_doppler_hz, self.slot_s, self.fading)
        lag = torch.as_tensor(slots).clamp(max=_LAGS - 1).to(torch.int64)
        return table.to(lag.device)[lag]

    def _bad(self, bad: Tensor, sent: Tensor, arrived: Tensor, decodable: Tensor) -> Tensor:
        """P[bad loss state] in this slot, from that of the slot before and its outcome."""
        if not isinstance(self.loss, GilbertElliott):
            return bad
        return feedback.predict_bad(self.loss, feedback.update_bad(self.loss, bad, sent, arrived, decodable))

    def _lost(self, bad: Tensor) -> Tensor | float:
        if isinstance(self.loss, GilbertElliott):
            return feedback.loss_given_bad(self.loss, bad)
        return 0.0 if self.loss is None else self.loss.mean

    def _link(self, snr: Tensor, decodable: Tensor, bad: Tensor) -> Link:
        return Link(snr.to(torch.float64), decodable * (1.0 - self._lost(bad)), decodable > 0)


@dataclass(frozen=True)
class StatisticalCsi(PerfectCsi):
    """The mean SNR is known, how fast the channel fades, and the outcome of each device's last transmission.

    After an ACK the SNR was above the threshold, after a NACK probably below; where the fading is correlated, that says
    something about this slot (of earlier outcomes nothing is remembered).
    """

    @property
    def width(self) -> int:
        return 4

    def step(self, memory: Tensor, mean_snr: Tensor, snr: Tensor, sent: Tensor, arrived: Tensor) -> tuple[Tensor, Link]:
        bad, decodable, above, since = memory.unbind(-1)
        above, since = self._last_outcome(decodable, self._lost(bad), above, since, sent, arrived)
        bad = self._bad(bad, sent, arrived, decodable)
        decodable = self._decodable(mean_snr, above, since)
        return torch.stack((bad, decodable, above, since), -1), self._link(mean_snr, decodable, bad)

    @staticmethod
    def _last_outcome(decodable, lost, above, since, sent, arrived):
        """P[above the threshold] at a device's last transmission, and the slots since; 0 slots: never."""
        erased = decodable * lost
        missed = erased / (1.0 - decodable + erased).clamp(min=1e-300)
        above = torch.where(sent, torch.where(arrived, 1.0, missed), above)
        return above, torch.where(sent, 1.0, torch.where(since > 0, since + 1.0, since))

    def _decodable(self, mean_snr: Tensor, above: Tensor, since: Tensor) -> Tensor:
        mean_snr = mean_snr.to(torch.float64)
        if self.fading == "none":
            return self.decoder.given_snr(mean_snr, mean_snr)
        if self.max_doppler_hz == 0:
            return self.decoder.given_mean(mean_snr)
        rho = torch.where(since > 0, self.correlation(since), 0.0)
        return self.decoder.given_outcome(mean_snr, above, rho)


@dataclass(frozen=True)
class DelayedCsi(StatisticalCsi):
    """The SNR of ``delay`` slots ago is known too; until it arrives, and beside newer outcomes, it is left out."""

    delay: int = 1

    @property
    def width(self) -> int:
        return 4 + self.delay

    def start(self, shape: tuple[int, ...], device: torch.device | str = "cpu") -> Tensor:
        memory = super().start(shape, device)
        memory[..., 4:] = _UNKNOWN
        return memory

    def step(self, memory: Tensor, mean_snr: Tensor, snr: Tensor, sent: Tensor, arrived: Tensor) -> tuple[Tensor, Link]:
        bad, decodable, above, since = memory[..., :4].unbind(-1)
        old, rho = memory[..., 4], self.correlation(self.delay)
        if self.delay == 1:
            # the measurement that came in with this slot is of the slot whose outcome came in with it
            decodable = torch.where(old < 0, decodable, self.decoder.given_snr(old, mean_snr))
        above, since = self._last_outcome(decodable, self._lost(bad), above, since, sent, arrived)
        bad = self._bad(bad, sent, arrived, decodable)
        decodable = self.decoder.given_old(mean_snr, old, rho)
        if self.delay > 1:
            newer = (since > 0) & (since < self.delay)
            decodable = torch.where(newer, self._decodable(mean_snr, above, since), decodable)
        link = self._link(posterior.expected_snr(mean_snr, old, rho), decodable, bad)
        known = torch.stack((bad, decodable, above, since), -1)
        return torch.cat((known, memory[..., 5:], snr.to(torch.float64).unsqueeze(-1)), -1), link


@dataclass(frozen=True)
class PredictedCsi(StatisticalCsi):
    """The complex gains are known up to ``delay`` slots ago, without noise, as pilots in every slot tell them.

    Whoever is scheduled by age and success is chosen by its past. So the probability has to rest on that past: given
    one old SNR alone, a device that waited for a better link is better than predicted. The last ``lags`` gains predict
    the fading linearly; with a single one this is :func:`tsjepa.radio.posterior.delayed_success`. Where the outcome of
    a newer slot leaves less uncertainty than the prediction, it is used instead.
    """

    delay: int = 1
    lags: int = 6

    @property
    def width(self) -> int:
        return 5 + 2 * (self.lags + self.delay - 1)

    def step(
        self,
        memory: Tensor,
        mean_snr: Tensor,
        snr: Tensor,
        sent: Tensor,
        arrived: Tensor,
        gain: Tensor | None = None,
    ) -> tuple[Tensor, Link]:
        """As above; ``gain`` [..., I, 2] is real and imaginary part, its square times ``mean_snr`` the SNR.

        Without it the phases are not known, and one old SNR is all that is used.
        """
        bad, decodable, above, since, measured = memory[..., :5].unbind(-1)
        past, mean = memory[..., 5:].unflatten(-1, (-1, 2)), mean_snr.to(torch.float64)
        if self.delay == 1:
            # the measurement that came in with this slot is of the slot whose outcome came in with it
            newest = past[..., -1, :].square().sum(-1) * mean
            decodable = torch.where(measured > 0, self.decoder.given_snr(newest, mean), decodable)
        above, since = self._last_outcome(decodable, self._lost(bad), above, since, sent, arrived)
        bad = self._bad(bad, sent, arrived, decodable)
        weights, left = (table.to(past.device) for table in self._predictor)
        known = (measured - self.delay + 1).clamp(0, self.lags if gain is not None else 1).to(torch.int64)
        useful = past.flip(-2)[..., self.delay - 1 :, :]
        power = (weights[known].unsqueeze(-1) * useful).sum(-2).square().sum(-1)
        left = left[known]
        decodable = self.decoder.given_prediction(mean, power, left)
        if self.delay > 1:
            newer = (since > 0) & (since < self.delay) & (1.0 - self.correlation(since) ** 2 < left)
            decodable = torch.where(newer, self._decodable(mean_snr, above, since), decodable)
        link = self._link(mean * (power + left), decodable, bad)
        if gain is None:
            root = torch.sqrt(snr.to(torch.float64) / mean)
            gain = torch.stack((root, torch.zeros_like(root)), -1)
        past = torch.cat((past[..., 1:, :], gain.to(torch.float64).unsqueeze(-2)), -2)
        state = torch.stack((bad, decodable, above, since, measured + 1), -1)
        return torch.cat((state, past.flatten(-2)), -1), link

    @property
    def _predictor(self) -> tuple[Tensor, Tensor]:
        return gain_predictor(self.lags, self.delay, self.max_doppler_hz, self.slot_s)


Belief = PerfectCsi | AckLearned
CSI = ("perfect", "delayed", "statistical", "acks")


def make_belief(
    csi: str,
    decoding: float | Decoding,
    delay: int = 1,
    loss: IidLoss | GilbertElliott | None = None,
    max_doppler_hz: float = 0.0,
    slot_s: float = 0.02,
    fading: str = "rayleigh",
) -> Belief:
    """The class of a kind of knowledge, "perfect", "delayed", "statistical" or "acks"; arguments as of the classes."""
    check_csi(csi, delay)
    if fading not in ("rayleigh", "none"):
        raise ValueError(f"unknown fading {fading!r}: choose 'rayleigh' or 'none'")
    if csi == "acks":
        return AckLearned(as_decoding(decoding).median)
    if csi == "delayed" and fading != "none" and max_doppler_hz > 0:
        return PredictedCsi(decoding, loss, max_doppler_hz, slot_s, fading, delay)
    if csi == "delayed" and fading != "none":
        return DelayedCsi(decoding, loss, max_doppler_hz, slot_s, fading, delay)
    # without fading the mean is the SNR, however old
    kind = PerfectCsi if csi == "perfect" else StatisticalCsi
    return kind(decoding, loss, max_doppler_hz, slot_s, fading)


def check_csi(csi: str, csi_delay: int) -> None:
    """``ValueError`` unless the channel knowledge is one that is modelled."""
    if csi not in CSI:
        raise ValueError(f"unknown csi {csi!r}: choose one of {', '.join(CSI)}")
    if csi_delay < 1:
        raise ValueError(f"csi_delay {csi_delay} must be at least 1 slot; without delay use csi='perfect'")
