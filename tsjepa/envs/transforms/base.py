"""What the network's transforms have in common: one slot of work, done after a step and after a reset alike."""

from abc import abstractmethod
from collections.abc import Iterator

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

Values = dict[str, Tensor]


class SlotTransform(Transform):
    """A transform that writes its keys in every slot, the first slot of an episode included.

    Subclasses say what they write (:meth:`_specs`), which of it the next slot needs (``carried``), what a device starts
    an episode with (:meth:`_begin`), and how one slot is computed (:meth:`_slot`). Carried keys are observations and
    state at once, as in TorchRL's ``StepCounter``, so they travel in the tensordict.

    TorchRL strips the state from the tensordict of an automatic reset. So that a device's episode count and the
    scheduler's memory outlive it, each transform also keeps a reference to the carried values it wrote last; they are
    consulted at resets only, and only where the tensordict has none.
    """

    carried: tuple[str, ...] = ()
    previous_keys: tuple[str, ...] = ()
    """Keys of the slot before that belong to other transforms or to the policy; None in the first slot."""

    def __init__(self, in_keys: list[str], out_keys: list[str]):
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self._last: Values = {}

    @abstractmethod
    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        """Specs of the keys this transform writes, given the observation spec it is applied to."""

    @abstractmethod
    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        """Values of one slot.

        Args:
            previous: carried keys and ``previous_keys`` of the slot before.
            current: what plant and earlier transforms wrote in this slot.
            fresh: [*B] bool, rows that start an episode in this slot; None after a step. The values that are returned
                for other rows are not used.
        """

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        """Carried values as they stand before an episode's first slot. ``before`` is empty at the very first reset."""
        return {}

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        previous = {key: tensordict.get(key) for key in self.carried}
        previous |= {key: tensordict.get(key, None) for key in self.previous_keys}
        return self._write(next_tensordict, self._slot(previous, next_tensordict, None))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        before = {key: tensordict.get(key, self._last.get(key)) for key in self.carried}
        before = {key: value for key, value in before.items() if value is not None}
        mask = tensordict.get("_reset", None)
        if mask is None or len(before) < len(self.carried) or bool(mask.all()):
            fresh = torch.ones(tensordict_reset.batch_size, dtype=torch.bool, device=tensordict_reset.device)
            values = self._slot(self._first(before, tensordict_reset), tensordict_reset, fresh)
            return self._write(tensordict_reset, values)
        fresh = mask.reshape(tensordict_reset.batch_size)
        first = self._first(before, tensordict_reset)
        previous = first | {key: select(fresh, first[key], before[key]) for key in self.carried}
        values = self._slot(previous, tensordict_reset, fresh)
        values |= {key: select(fresh, values[key], before[key]) for key in self.carried}
        return self._write(tensordict_reset, values)

    def alone(self, num_devices: int, slots: int) -> Iterator[TensorDictBase]:
        """What a transform that reads nothing writes in the slots of one episode, without an environment."""
        empty = TensorDict(batch_size=[num_devices])
        now = self._reset(empty, empty.clone())
        for slot in range(slots):
            now = self._step(now, empty.clone()) if slot else now
            yield now

    def _first(self, before: Values, current: TensorDictBase) -> Values:
        return self._begin(before, current) | dict.fromkeys(self.previous_keys)

    def _write(self, tensordict: TensorDictBase, values: Values) -> TensorDictBase:
        self._last = {key: values[key] for key in self.carried}
        for key, value in values.items():
            tensordict.set(key, value)
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key, spec in self._specs(observation_spec).items():
            observation_spec[key] = spec
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        if self.carried:
            specs = self._specs(self.parent.observation_spec)
            for key in self.carried:
                state_spec[key] = specs[key]
        return state_spec


def select(rows: Tensor, chosen: Tensor, other: Tensor) -> Tensor:
    """``chosen`` in the rows [*B] that are set, ``other`` elsewhere; values of shape [*B, ...]."""
    return torch.where(rows.reshape(rows.shape + (1,) * (chosen.ndim - rows.ndim)), chosen, other)


def active_rows(current: TensorDictBase, mask_key: str, fresh: Tensor | None) -> Tensor:
    """Rows that have work in this slot: those the mask sets (all, if nobody wrote it), at a reset only fresh ones."""
    rows = current.get(mask_key, None)
    if rows is None:
        rows = torch.ones(current.batch_size, dtype=torch.bool, device=current.device)
    return rows if fresh is None else rows & fresh


def scatter_rows(rows: Tensor, values: Tensor) -> Tensor:
    """Values [N, ...] of the N set rows, spread over [*B, ...] with zeros in the others."""
    if bool(rows.all()):
        return values.reshape(rows.shape + values.shape[1:])
    spread = torch.zeros(rows.shape + values.shape[1:], dtype=values.dtype, device=values.device)
    spread[rows] = values
    return spread


def flag_spec(incoming: Composite) -> TensorSpec:
    """One bool per row."""
    return Categorical(2, shape=incoming.shape, dtype=torch.bool, device=incoming.device)


def number_spec(incoming: Composite, *shape: int, dtype: torch.dtype = torch.float32) -> TensorSpec:
    """Numbers of the given shape per row."""
    return Unbounded(shape=(*incoming.shape, *shape), dtype=dtype, device=incoming.device)


def require_key(container: Composite | TensorDictBase, key: str, transform: str, writer: str) -> TensorSpec | Tensor:
    """The entry ``key`` of a spec or a tensordict, or a ``KeyError`` that says which transform to put in front."""
    entry = container.get(key, None)
    if entry is None:
        raise KeyError(f"{transform} reads {key!r}, which nothing in front of it writes: put {writer} before it")
    return entry
