"""The probability that a packet is decoded, for all that may be known of its link.

A packet is decoded when its SNR reaches a threshold. A block error curve is a threshold that is drawn: the packet is
decoded at an SNR g with the probability P[threshold <= g]. A repetition adds its SNR to the first one's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from tsjepa.radio.harq import residual_outage
from tsjepa.radio.posterior import delayed_success, statistical_success, success_after
from tsjepa.radio.prediction import predicted_success

_CELLS = 12  # of the first attempt's SNR below the threshold, over which the second one's chance is summed


@dataclass(frozen=True)
class Decoding:
    """When a packet is decoded.

    Args:
        thresholds: linear SNRs at which it is, each as likely; a single one for a sharp threshold.
        repetition: correlation of the fading at the first attempt and at its repetition; None for a single attempt.
    """

    thresholds: tuple[float, ...]
    repetition: float | None = None

    @property
    def median(self) -> float:
        """The threshold in the middle."""
        return self.thresholds[len(self.thresholds) // 2]

    def given_snr(self, snr: Tensor, mean_snr: Tensor) -> Tensor:
        """The SNR of the first attempt is known; float64, the shape of both."""
        snr = snr.to(torch.float64)

        def one(threshold: float) -> Tensor:
            above = (snr >= threshold).to(torch.float64)
            if self.repetition is None:
                return above
            return torch.where(above > 0, above, self._again(threshold, mean_snr, snr))

        return self._mean(one)

    def given_mean(self, mean_snr: Tensor) -> Tensor:
        """The mean SNR is known. Two correlated attempts have the sum of two independent ones of other means."""
        mean = mean_snr.to(torch.float64)
        if self.repetition is None:
            return self._mean(lambda threshold: statistical_success(threshold, mean))
        high, low = mean * (1 + abs(self.repetition)), mean * max(1 - abs(self.repetition), 1e-9)
        return self._mean(lambda threshold: 1.0 - residual_outage(threshold, high, low))

    def given_old(self, mean_snr: Tensor, old_snr: Tensor, correlation: Tensor | float) -> Tensor:
        """An older SNR is known, see :func:`tsjepa.radio.posterior.delayed_success`."""
        return self._both(mean_snr, lambda threshold: delayed_success(threshold, mean_snr, old_snr, correlation))

    def given_prediction(self, mean_snr: Tensor, power: Tensor, left: Tensor) -> Tensor:
        """The gain was predicted, see :func:`tsjepa.radio.prediction.predicted_success`."""
        return self._both(mean_snr, lambda threshold: predicted_success(threshold, mean_snr, power, left))

    def given_outcome(self, mean_snr: Tensor, above_then: Tensor, correlation: Tensor | float) -> Tensor:
        """It is known how probably a packet was decoded some slots ago; with a repetition that is left out."""
        if self.repetition is not None:
            return self.given_mean(mean_snr)
        return self._mean(lambda threshold: success_after(threshold, mean_snr, above_then, correlation))

    def _mean(self, one: Callable[[float], Tensor]) -> Tensor:
        if len(self.thresholds) == 1:
            return one(self.thresholds[0])
        return torch.stack([one(threshold) for threshold in self.thresholds]).mean(0)

    def _both(self, mean_snr: Tensor, reaches: Callable[[float], Tensor]) -> Tensor:
        """P[decoded], from P[the first attempt reaches a threshold]."""
        if self.repetition is None:
            return self._mean(reaches)

        def one(threshold: float) -> Tensor:
            edges = [threshold * k / _CELLS for k in range(_CELLS + 1)]
            chance = [torch.ones_like(mean_snr, dtype=torch.float64), *(reaches(edge) for edge in edges[1:])]
            total = chance[-1]
            for k in range(_CELLS):
                middle = torch.full_like(total, (edges[k] + edges[k + 1]) / 2)
                total = total + (chance[k] - chance[k + 1]) * self._again(threshold, mean_snr, middle)
            return total

        return self._mean(one)

    def _again(self, threshold: float, mean_snr: Tensor, first: Tensor) -> Tensor:
        """P[decoded by the repetition], the first attempt's SNR being known."""
        return delayed_success((threshold - first).clamp(min=0.0), mean_snr, first, self.repetition)


def as_decoding(given: float | Decoding) -> Decoding:
    """A sharp threshold, given as a number, as :class:`Decoding`; anything else as it is."""
    return Decoding((float(given),)) if isinstance(given, (int, float)) else given
