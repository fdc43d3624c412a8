"""LightningDataModule of the actor: the frozen encoder's embeddings of the data set, received and rolled out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from tensordict import TensorDict
from torch.utils.data import DataLoader, Sampler

from tsjepa.data.module import Trajectories, as_is
from tsjepa.training.actor import imitation_pairs
from tsjepa.training.embeddings import embed_split


class RowSampler(Sampler):
    """Batches of shuffled row numbers, drawn from (seed, epoch) so that a resumed run repeats them."""

    def __init__(self, rows: int, batch: int, seed: int) -> None:
        self.rows, self.batch, self.seed, self.epoch = rows, batch, seed, 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning at the start of every epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.rows // self.batch

    def __iter__(self) -> Iterator[torch.Tensor]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        order = torch.randperm(self.rows, generator=generator)
        # not before the first batch is asked for: a resumed fit makes its iterator before it sets the epoch
        yield from order[: len(self) * self.batch].split(self.batch)


class TensorRows:
    """Rows of a TensorDict by a tensor of row numbers."""

    def __init__(self, rows: TensorDict) -> None:
        self.rows = rows

    def __getitem__(self, index: torch.Tensor) -> TensorDict:
        return self.rows[index]


class ImitationPairs(Trajectories):
    """Pairs of embedding and expert's command, made once with the model that is being trained.

    Args:
        path, collect, seed: see :class:`Trajectories`.
        batch_size: pairs per step (200 in the paper).
        horizons: slots ahead at which embeddings are predicted; 0 is received, and one listed twice counts twice.
        splits: of the data set that the actor learns from.
    """

    def __init__(
        self,
        path: str = "data/cartpole-20ms",
        collect: str = "recipes/data.yaml",
        batch_size: int = 200,
        horizons: Sequence[int] = (0,),
        splits: Sequence[str] = ("actor_train",),
        seed: int = 0,
    ) -> None:
        super().__init__(path, collect, seed=seed)
        self.batch_size, self.horizons, self.splits = batch_size, tuple(horizons), tuple(splits)

    def setup(self, stage: str | None = None) -> None:
        super().setup(stage)
        model = self.trainer.lightning_module.model
        spacing = model.frame_spacing
        train = torch.cat([embed_split(model.encoder, self.split(name), spacing) for name in self.splits])
        self.pairs = imitation_pairs(model, train, self.horizons)
        state = train["state"].flatten(0, 1)
        model.probe.state_mean.copy_(state.mean(0))
        model.probe.state_std.copy_(state.std(0))
        self.held_out = {
            name: embed_split(model.encoder, self.split(name), spacing).flatten(0, 1)
            for name in ("validation", "actor_test")
        }

    def train_dataloader(self) -> DataLoader:
        sampler = RowSampler(len(self.pairs), self.batch_size, self.seed)
        return DataLoader(TensorRows(self.pairs), sampler=sampler, batch_size=None, collate_fn=as_is)

    def val_dataloader(self) -> DataLoader:
        return DataLoader([self.held_out["validation"]], batch_size=None, collate_fn=as_is)

    def test_dataloader(self) -> DataLoader:
        return DataLoader([self.held_out["actor_test"]], batch_size=None, collate_fn=as_is)

    predict_dataloader = test_dataloader
