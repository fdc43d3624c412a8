"""LightningDataModules over the data set on disk; they collect it when it is absent."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lightning
from tensordict import TensorDictBase
from torch.utils.data import DataLoader

from tsjepa.data.checks import check_split
from tsjepa.data.storage import METADATA, open_split, read_metadata, spec_of
from tsjepa.data.windows import WindowDataset, WindowSampler
from tsjepa.models.encoder import PATCH
from tsjepa.support.checks import at_least
from tsjepa.support.recipes import find_recipe, parse_arguments
from tsjepa.support.seeds import run_seed


def as_is(batch):
    """Collate function for batches that the data set has already put together."""
    return batch


class Trajectories(lightning.LightningDataModule):
    """Windows of consecutive frames and commands for TS-JEPA.

    Args:
        path: folder of the data set.
        collect: recipe, or several of which later ones lie over the first, that collects the data set when ``path``
            does not exist; None for one that is imported.
        frame_stack: kappa.
        frame_spacing: slots between the frames of a stack; 2 or 3 multiply what a velocity moves in the picture.
        stacks: stacks per window.
        frames_per_batch: context frames a step, over all processes (256 in the paper).
        steps: slots between the stacks of a window, drawn per batch.
        episodes: use only the first so many trajectories of every split; None for all.
        splits: of the data set that are trained on.
        start_share: share of the windows that begin where a trajectory begins (see
            :func:`~tsjepa.training.finish.refine.refine_predictor` for why).
        paired: every trajectory of ``splits`` is there in two views; a window has the other one's frames too, from
            which TS-JEPA makes its targets.
    """

    def __init__(
        self,
        path: str,
        collect: str | Sequence[str] | None = None,
        frame_stack: int = 2,
        frame_spacing: int = 1,
        stacks: int = 8,
        frames_per_batch: int = 256,
        steps: Sequence[int] = (1, 1, 2, 4),
        episodes: int | None = None,
        splits: Sequence[str] = ("train",),
        start_share: float = 0.0,
        paired: bool = False,
    ) -> None:
        super().__init__()
        at_least(
            1, frame_stack=frame_stack, frame_spacing=frame_spacing, stacks=stacks, frames_per_batch=frames_per_batch
        )
        at_least(1, **{f"steps[{index}]": step for index, step in enumerate(steps)})
        if not splits:
            raise ValueError("splits is empty; give at least one, such as [train].")
        if not steps:
            raise ValueError("steps is empty; give at least one, such as [1].")
        if episodes is not None:
            at_least(1, episodes=episodes)
        if frames_per_batch % stacks:
            raise ValueError(f"frames_per_batch = {frames_per_batch} is not a multiple of stacks = {stacks}.")
        self.path = Path(path)
        self.recipes = [collect] if isinstance(collect, str) else list(collect or ())
        self.frame_stack, self.frame_spacing, self.stacks = frame_stack, frame_spacing, stacks
        self.frames_per_batch, self.steps, self.episodes = frames_per_batch, steps, episodes
        self.splits, self.start_share, self.paired = tuple(splits), start_share, paired
        self.other_data = False

    validation = "validation"  # the split that a fit is validated on

    @property
    def first_slot(self) -> int:
        """First slot with a whole stack behind it."""
        return (self.frame_stack - 1) * self.frame_spacing

    def prepare_data(self) -> None:
        if (self.path / METADATA).is_file():
            return
        if not self.recipes:
            raise FileNotFoundError(f"There is no data set in {self.path}: make it with `tsjepa import` or `collect`.")
        for recipe in self.recipes:
            if not Path(find_recipe(recipe)).is_file():
                raise FileNotFoundError(
                    f"There is no data set in {self.path} and no recipe {recipe} to collect it with."
                )
        from tsjepa.data.collect import collect  # needs a renderer, which training from a data set does not

        layers = [word for recipe in self.recipes for word in ("--config", recipe)]
        collect(**parse_arguments(collect, [*layers, "--path", str(self.path)], "tsjepa collect"))

    def setup(self, stage: str | None = None) -> None:
        self.metadata = read_metadata(self.path)
        self.spec = spec_of(self.metadata)
        if any(side % PATCH for side in self.spec.frame):
            height, width = self.spec.frame
            raise ValueError(
                f"The frames of {self.path} are {height} x {width}, and their sides have to be multiples of {PATCH}: "
                f"make it anew in another size, such as --size '[{height - height % PATCH}, {width - width % PATCH}]'."
            )
        if stage == "fit":
            validated = self.trainer is None or bool(self.trainer.limit_val_batches)
            if validated and self.validation not in self.metadata["splits"]:
                raise ValueError(
                    f"The data set in {self.path} has no split {self.validation!r} to validate on: make it anew of "
                    "more or shorter trajectories, or add --trainer.limit_val_batches 0."
                )
            slots = {name: self.split(name).shape[1] - 1 for name in self.splits}
            if len(set(slots.values())) > 1:
                told = ", ".join(f"{name} {count}" for name, count in slots.items())
                raise ValueError(
                    f"The splits of {self.path} have trajectories of different lengths, in slots {told}: train on "
                    "splits of one length."
                )
            for name in self.splits if self.paired else ():
                if self.views(name) != 2:
                    raise ValueError(
                        f"paired needs two views of every trajectory and the split {name} of {self.path} has "
                        f"{self.views(name)}; collect it with views: 2, or leave paired out."
                    )
            for name in self.metadata["splits"]:
                check_split(self.split(name), name)

    def state_dict(self) -> dict:
        """For checkpoints: which data set this is."""
        return {"path": str(self.path), "sha256": self.metadata["sha256"]}

    def load_state_dict(self, state: dict) -> None:
        """Refuses to go on from a checkpoint of another data set, unless ``other_data`` is set.

        Raises:
            ValueError: naming both.
        """
        other = state["sha256"] != self.metadata["sha256"]
        if self.trainer.state.fn == "fit" and other and not self.other_data:
            raise ValueError(
                f"The checkpoint is of a run on another data set, {state['path']} (SHA-256 {state['sha256'][:12]}...), "
                f"not {self.path} ({self.metadata['sha256'][:12]}...): give it that one, or add --other_data true."
            )

    def split(self, name: str) -> TensorDictBase:
        """The first ``episodes`` of one split, memory-mapped; [episodes, T + 1]. All that is fitted comes from here."""
        split = open_split(self.path, name)
        return split if self.episodes is None else split[: self.episodes * self.views(name)]

    def views(self, name: str) -> int:
        """How many episodes of a split show each of its trajectories."""
        return read_metadata(self.path)["splits"][name].get("views", 1)

    def sampler(self, episodes: int, frames: int) -> WindowSampler:
        """What draws the batches of an epoch from so many trajectories of so many frames."""
        rank, world_size = (self.trainer.global_rank, self.trainer.world_size) if self.trainer else (0, 1)
        return WindowSampler(
            episodes,
            frames,
            first=self.first_slot,
            stacks=self.stacks,
            windows_per_batch=self.frames_per_batch // self.stacks,
            steps=self.steps,
            seed=run_seed(),
            rank=rank,
            world_size=world_size,
            start_share=self.start_share,
        )

    def train_dataloader(self) -> DataLoader:
        splits = [self.split(name) for name in self.splits]
        sampler = self.sampler(sum(map(len, splits)), splits[0].shape[1])
        dataset = WindowDataset(splits, self.stacks, self.frame_stack, self.frame_spacing, self.paired)
        return DataLoader(dataset, sampler=sampler, batch_size=None, collate_fn=as_is)

    def val_dataloader(self) -> DataLoader:
        """One batch: the validation split, as it lies on disk."""
        return DataLoader([self.split(self.validation)], batch_size=None, collate_fn=as_is)

    def test_dataloader(self) -> DataLoader:
        return DataLoader([self.split("test")], batch_size=None, collate_fn=as_is)

    predict_dataloader = test_dataloader

    def transfer_batch_to_device(self, batch: TensorDictBase, device, dataloader_idx: int) -> TensorDictBase:
        """A whole split stays memory-mapped; :func:`tsjepa.training.embeddings.embed_split` moves what it reads."""
        return batch if "pixels" in batch.keys() else batch.to(device)  # noqa: SIM118 - a TensorDict refuses `in`
