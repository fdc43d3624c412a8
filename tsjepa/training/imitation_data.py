"""LightningDataModule of the actor: the frozen encoder's embeddings of the data set, received and rolled out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from tensordict import TensorDict
from torch.utils.data import DataLoader, Sampler

from tsjepa.data.module import Trajectories, as_is
from tsjepa.support.checks import at_least
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.actor import imitation_pairs
from tsjepa.training.embeddings import embed_split


class RowSampler(Sampler):
    """Batches of shuffled row numbers, drawn from (seed, epoch) so that a resumed run repeats them.

    Args:
        rows: how many there are.
        batch: rows a step, over all processes; rows that do not fill the last batch wait for another epoch.
        seed: of the run; the rows have a stream of their own in it.
        rank, world_size: this process among all, each of which takes its share of every batch.

    Raises:
        ValueError: the rows of a batch do not divide among the processes, or there are fewer rows than a batch has.
    """

    def __init__(self, rows: int, batch: int, seed: int, rank: int = 0, world_size: int = 1) -> None:
        if batch % world_size:
            raise ValueError(f"batch_size = {batch} does not divide among {world_size} processes.")
        if rows < batch:
            raise ValueError(
                f"The splits give {rows} rows, and batch_size = {batch} takes more: make data.init_args.batch_size "
                f"{rows} or smaller, or collect more episodes."
            )
        self.rows, self.batch, self.seed, self.epoch = rows, batch, seed, 0
        self.rank, self.world_size = rank, world_size

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning at the start of every epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.rows // self.batch

    def __iter__(self) -> Iterator[torch.Tensor]:
        generator = torch.Generator().manual_seed(derive(self.seed, "actor rows", self.epoch))
        order = torch.randperm(self.rows, generator=generator)
        # not before the first batch is asked for: a resumed fit makes its iterator before it sets the epoch
        for batch in order[: len(self) * self.batch].split(self.batch):
            yield batch[self.rank :: self.world_size]


class TensorRows:
    """Rows of a TensorDict by a tensor of row numbers."""

    def __init__(self, rows: TensorDict) -> None:
        self.rows = rows

    def __getitem__(self, index: torch.Tensor) -> TensorDict:
        return self.rows[index]


class ImitationPairs(Trajectories):
    """Pairs of embedding and expert's command, made once with the model that is being trained.

    Args:
        path, collect, episodes: see :class:`Trajectories`.
        batch_size: pairs per step (200 in the paper).
        horizons: slots ahead at which embeddings are predicted; 0 is received, and one listed twice counts twice.
        splits: of the data set that the actor learns from.
        validation, test: splits on which its command error is measured.
    """

    def __init__(
        self,
        path: str,
        collect: str | Sequence[str] | None = None,
        batch_size: int = 200,
        horizons: Sequence[int] = (0,),
        splits: Sequence[str] = ("actor_train",),
        validation: str = "validation",
        test: str = "actor_test",
        episodes: int | None = None,
    ) -> None:
        super().__init__(path, collect, episodes=episodes, splits=splits)
        if not horizons:
            raise ValueError("horizons is empty; give at least one, such as [0].")
        at_least(0, **{f"horizons[{index}]": horizon for index, horizon in enumerate(horizons)})
        self.validation, self.test = validation, test
        self.batch_size, self.horizons = batch_size, tuple(horizons)

    def setup(self, stage: str | None = None) -> None:
        super().setup(stage)
        # Lightning moves the module after this
        model = self.trainer.lightning_module.model.to(self.trainer.strategy.root_device)
        # kept for what is fitted on the same embeddings when the fit ends
        self.embedded = {
            name: embed_split(model.encoder, self.split(name), model.frame_spacing)
            for name in dict.fromkeys((*self.splits, self.validation, self.test))
        }
        self.pairs = imitation_pairs(model, torch.cat([self.embedded[name] for name in self.splits]), self.horizons)
        self.held_out = {name: self.embedded[name].flatten(0, 1) for name in {self.validation, self.test}}

    def train_dataloader(self) -> DataLoader:
        rank, world_size = self.trainer.global_rank, self.trainer.world_size
        sampler = RowSampler(len(self.pairs), self.batch_size, run_seed(), rank, world_size)
        return DataLoader(TensorRows(self.pairs), sampler=sampler, batch_size=None, collate_fn=as_is)

    def val_dataloader(self) -> DataLoader:
        return DataLoader([self.held_out[self.validation]], batch_size=None, collate_fn=as_is)

    def test_dataloader(self) -> DataLoader:
        return DataLoader([self.held_out[self.test]], batch_size=None, collate_fn=as_is)

    predict_dataloader = test_dataloader
