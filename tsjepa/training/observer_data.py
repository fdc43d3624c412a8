"""LightningDataModule of the observer: rows of slots on the frozen encoder's embeddings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from tensordict import TensorDict
from torch.utils.data import DataLoader, Sampler

from tsjepa.data.module import Trajectories, as_is
from tsjepa.support.checks import at_least, within
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.controllers import check_sizes
from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.refine import check_horizon, draw

Batch = TensorDict | dict[str, TensorDict]


class EpochSteps(Sampler):
    """(epoch, step) of every step of an epoch."""

    def __init__(self, steps: int) -> None:
        self.steps, self.epoch = steps, 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning at the start of every epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.steps

    def __iter__(self) -> Iterator[tuple[int, int]]:
        # not before a step is asked for: a resumed fit makes its iterator before it sets the epoch
        for step in range(self.steps):
            yield self.epoch, step


class Watches:
    """Batches {"watched", "starts"} by (epoch, step), of which each is drawn anew and alike in a resumed run.

    Args:
        watched, starts: [episodes, slots] with ``embedding`` and ``action``.
        slots: the longest watch; each batch draws its own from 1 on.
        horizon: slots predicted after it.
        counts: rows of each in a batch, of this process.
        seed: of the run.
        rank: this process among all.
    """

    def __init__(
        self,
        watched: TensorDict,
        starts: TensorDict,
        slots: int,
        horizon: int,
        counts: tuple[int, int],
        seed: int,
        rank: int = 0,
    ) -> None:
        self.watched, self.starts, self.counts = watched, starts, counts
        self.slots, self.horizon, self.seed, self.rank = slots, horizon, seed, rank

    def __getitem__(self, place: tuple[int, int]) -> dict[str, TensorDict]:
        # the length is alike in all processes: they have to unroll the same number of slots
        lengths = torch.Generator().manual_seed(derive(self.seed, "observer length", *place))
        rows = torch.Generator().manual_seed(derive(self.seed, "observer rows", *place, self.rank))
        watch = int(torch.randint(1, self.slots + 1, (), generator=lengths))
        return {
            "watched": self.drawn(self.watched, self.counts[0], watch + self.horizon, rows),
            "starts": self.drawn(self.starts, self.counts[1], self.horizon, rows),
        }

    @staticmethod
    def drawn(part: TensorDict, count: int, ahead: int, generator: torch.Generator) -> TensorDict:
        """``count`` rows of ``ahead`` commands, with the embeddings around them."""
        embedding, action = draw(part, count, ahead, generator)
        return TensorDict({"embedding": embedding, "action": action}, batch_size=[count])


class WatchedTrajectories(Trajectories):
    """Rows of slots from anywhere in the trajectories, and roll-outs from short ones, embedded once by the model.

    Args:
        path, collect, episodes: see :class:`Trajectories`.
        splits: of the data set, from which devices are watched.
        starts: split of many short trajectories, of which roll-outs begin at plain embeddings.
        batch_size: rows a step, over all processes.
        start_share: share of the rows that are roll-outs of ``starts``.
        slots: the longest that a device is watched before it is predicted; each step draws its own from 1 on.
        horizon: slots predicted after it.
        steps_per_epoch: of training.
        validation: split on whose trajectories predictions from beliefs are compared with those from embeddings.

    Raises:
        ValueError: rows that do not fit into the trajectories, or do not divide among the processes.
    """

    def __init__(
        self,
        path: str,
        collect: str | Sequence[str] | None = None,
        splits: Sequence[str] = ("train",),
        starts: str = "starts",
        batch_size: int = 320,
        start_share: float = 0.25,
        slots: int = 10,
        horizon: int = 10,
        steps_per_epoch: int = 250,
        episodes: int | None = None,
        validation: str = "validation",
    ) -> None:
        super().__init__(path, collect, splits=splits, episodes=episodes)
        within(0, 1, start_share=start_share)
        at_least(1, batch_size=batch_size, slots=slots, horizon=horizon, steps_per_epoch=steps_per_epoch)
        self.starts, self.batch_size, self.starting = starts, batch_size, round(start_share * batch_size)
        self.slots, self.horizon, self.steps_per_epoch = slots, horizon, steps_per_epoch
        self.validation = validation

    def setup(self, stage: str | None = None) -> None:
        super().setup(stage)
        model = self.trainer.lightning_module.model.to(self.trainer.strategy.root_device)
        check_sizes(model.encoder, model.predictor, self.spec)
        names = dict.fromkeys((*self.splits, self.starts, self.validation))
        for name in names:
            ahead = self.slots + self.horizon if name in self.splits else self.horizon
            check_horizon(ahead, self.split(name).shape[1] - model.frame_history + 1)
        self.embedded = {name: embed_split(model.encoder, self.split(name), model.frame_spacing) for name in names}

    def train_dataloader(self) -> DataLoader:
        rank, world_size = self.trainer.global_rank, self.trainer.world_size
        counts = (self.batch_size - self.starting, self.starting)
        if counts[0] % world_size or counts[1] % world_size:
            raise ValueError(f"{counts[0]} and {counts[1]} rows a step do not divide among {world_size} processes.")
        each = (counts[0] // world_size, counts[1] // world_size)
        watched = torch.cat([self.embedded[name] for name in self.splits])
        data = Watches(watched, self.embedded[self.starts], self.slots, self.horizon, each, run_seed(), rank)
        return DataLoader(data, sampler=EpochSteps(self.steps_per_epoch), batch_size=None, collate_fn=as_is)

    def val_dataloader(self) -> DataLoader:
        return DataLoader([self.embedded[self.validation]], batch_size=None, collate_fn=as_is)

    def transfer_batch_to_device(self, batch: Batch, device: torch.device, dataloader_idx: int) -> Batch:
        return {name: part.to(device) for name, part in batch.items()} if isinstance(batch, dict) else batch.to(device)
