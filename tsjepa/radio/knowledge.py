"""What a scheduler may know in a slot, and what may be believed of its links, as one value each."""

from typing import NamedTuple

from torch import Tensor


class Known(NamedTuple):
    """What the base station knows when it decides about a slot; I devices on the last dimension, any batch before it.

    A field that nobody can know is None. Fields are read, never written into: they may be views.

    Attributes:
        age: [..., I] slots since the last delivery, counted before this slot (1 = delivered in the slot before).
        snr: [..., I] linear SNR that is expected, given what is known.
        success: [..., I] probability that a transmission arrives, given what is known.
        above_threshold: [..., I] bool, whether the SNR may reach the threshold, given what is known: with perfect
            knowledge the gate gamma >= gamma_th; a link that is not known for sure is not ruled out.
        candidate: [..., I] bool, devices that may be scheduled at all.
        budget: resource units in the slot, int or [...] int64.
        memory: [..., I] float64, what the scheduler returned in the slot before, zeros at first; it outlives episodes.
        demand: [..., I] int64 resource units that each device needs, or None: one each.
        urgency: [..., I] what each device says of its own need, >= 0, or None where devices say nothing.
        expected_gain: [..., I] what hearing of a device now is expected to save, from the controller's own record of
            its errors, see :mod:`tsjepa.radio.expected_error`; None where it keeps none.
        true_error: [..., I] how far each device's command would change if it were heard now, as a part of the
            actuator's range. Nobody knows it: it is there for bounds. None where nobody computes it.
        age_cost: [..., I] float64 the plant's own cost of a state that is known ``age`` slots late, or None.
        weight: [..., I] priority, > 0, by which the schedulers that compute a device's gain multiply it, or None: all
            alike.
        slot: int64 slots since the device's episode began, broadcast against [..., I], or None where no plant counts.
        signalling_bits: bits that were spent in this slot to know it, int or [..., I] int64.
    """

    age: Tensor
    snr: Tensor
    success: Tensor
    above_threshold: Tensor
    candidate: Tensor
    budget: int | Tensor
    memory: Tensor
    demand: Tensor | None = None
    urgency: Tensor | None = None
    weight: Tensor | None = None
    slot: Tensor | None = None
    signalling_bits: int | Tensor = 0
    expected_gain: Tensor | None = None
    true_error: Tensor | None = None
    age_cost: Tensor | None = None


class Link(NamedTuple):
    """What is believed of each link in a slot, [..., I].

    Attributes:
        snr: expected linear SNR.
        success: probability that a transmission arrives.
        above_threshold: bool, whether it can arrive at all: the SNR may reach the threshold.
    """

    snr: Tensor
    success: Tensor
    above_threshold: Tensor
