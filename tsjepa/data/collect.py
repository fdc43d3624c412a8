"""Collects the data set: trajectories of the plant under the expert, their frames rendered afterwards in one sweep."""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor
from tqdm import tqdm

from tsjepa.data.contact_sheet import contact_sheet
from tsjepa.data.storage import JOURNAL, publish
from tsjepa.envs import FleetEnv, Renderer, StartDistribution
from tsjepa.plants.expert import Expert
from tsjepa.plants.renderer import HEIGHT, WIDTH
from tsjepa.support.checks import at_least, within
from tsjepa.support.files import exclusive
from tsjepa.support.journal import Journal
from tsjepa.support.workers import RAY, Workers, run_items

FRAME_BYTES = HEIGHT * WIDTH * 3


@dataclass
class Split:
    """One split of the data set.

    Args:
        episodes: number of trajectories.
        coverage: changing set points and exploration noise; False gives the plain expert, as the paper has it.
    """

    episodes: int
    coverage: bool = True


@dataclass
class Coverage:
    """How the expert is made to visit the state space (findings.md: this decides the quality, not the loss).

    Args:
        hold_slots: the set point may change every this many slots.
        change_probability: chance that it does.
        set_point_range: new set points are uniform in +- this, metres.
        noise_memory: a of the force noise n[k+1] = a n[k] + b N(0, 1).
        noise_std: b, newtons.
    """

    hold_slots: int = 25
    change_probability: float = 0.7
    set_point_range: float = 0.8
    noise_memory: float = 0.8
    noise_std: float = 1.5

    def __post_init__(self) -> None:
        at_least(1, hold_slots=self.hold_slots)
        at_least(0, set_point_range=self.set_point_range, noise_std=self.noise_std)
        within(0, 1, change_probability=self.change_probability)
        within(-1, 1, noise_memory=self.noise_memory)

    def draw(self, episodes: int, slots: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Set points [episodes, slots] in metres (starting at 0) and force noise [episodes, slots, 1] in newtons."""
        set_points = torch.zeros(episodes, slots)
        noise = torch.zeros(episodes, slots, 1)
        innovation = self.noise_std * torch.randn(episodes, slots, 1, generator=generator)
        for slot in range(slots):
            if slot:
                set_points[:, slot] = set_points[:, slot - 1]
                noise[:, slot] = self.noise_memory * noise[:, slot - 1]
            if slot % self.hold_slots == 0:
                change = torch.rand(episodes, generator=generator) < self.change_probability
                fresh = self.set_point_range * (2 * torch.rand(episodes, generator=generator) - 1)
                set_points[:, slot] = torch.where(change, fresh, set_points[:, slot])
            noise[:, slot] += innovation[:, slot]
        return set_points, noise


DEFAULT_COVERAGE = Coverage()


def simulate(
    split: Split, coverage: Coverage, slots: int, warmup_slots: int, fleet, expert, generator: torch.Generator
) -> TensorDict:
    """Runs ``split.episodes`` plants for ``slots`` slots; returns all but the pixels, [episodes, slots + 1]."""
    if split.coverage:
        set_points, noise = coverage.draw(split.episodes, slots, generator)
    else:
        set_points, noise = torch.zeros(split.episodes, slots), torch.zeros(split.episodes, slots, 1)
    observation = fleet.reset()
    states, actions, colors = [observation["state"]], [], observation["colors"]
    for slot in range(slots):
        action = (expert(observation["state"], set_points[:, slot]) + noise[:, slot]).clamp(-20, 20)
        action = action * (slot >= warmup_slots)
        observation = fleet.step(observation.set("action", action))["next"]
        states.append(observation["state"])
        actions.append(action)
    state = torch.stack(states, dim=1)
    action = torch.stack([*actions, torch.zeros_like(action)], dim=1)
    return TensorDict(
        {
            "state": state,
            "action": action,
            "expert_action": expert(state),
            "colors": colors[:, None].expand(-1, slots + 1, -1, -1).clone(),
        },
        batch_size=[split.episodes, slots + 1],
    )


def collect(
    path: str,
    splits: dict[str, Split],
    sampling_interval: float = 0.02,
    slots: int = 100,
    coverage: Coverage = DEFAULT_COVERAGE,
    warmup_slots: int = 0,
    random_colors: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    workers: Workers = 1,
) -> Path:
    """Writes a memory-mapped data set; it appears under ``path`` whole, or not at all.

    Work in progress lies beside it with the suffix ``.partial``. The same command goes on from there after a kill; the
    bytes are the same, however often it was killed and however many workers there were.

    Args:
        path: folder of the data set.
        splits: name to size and behaviour; every split has its own random streams.
        sampling_interval: slot length in seconds.
        slots: T; a trajectory has T commands and T + 1 frames.
        coverage: behaviour of the splits that ask for it.
        warmup_slots: slots without force at the start of a trajectory. The evaluation has kappa - 1 of them, and an
            encoder that never saw them takes the expert's force for granted: its first velocities are then wrong.
        random_colors: draw cart and pole colours per episode.
        seed: seed of every stream.
        overwrite: replace the data set that is there.
        workers: processes that render, or "ray" for a Ray cluster.
    """
    if workers != RAY:
        at_least(1, workers=workers)
    at_least(1, slots=slots, **{f"splits.{name}.episodes": split.episodes for name, split in splits.items()})
    if not splits or not all(name.isidentifier() for name in splits):
        raise ValueError(f"splits is {splits}; a data set needs at least one, and their names become folders.")
    folder = Path(path)
    with exclusive(folder):
        if folder.exists() and not overwrite:
            raise FileExistsError(f"{folder} exists; pass --overwrite true to collect it anew, or choose another path.")
        partial = folder.with_name(folder.name + ".partial")
        partial.mkdir(parents=True, exist_ok=True)
        metadata = {
            "splits": {name: asdict(split) for name, split in splits.items()},
            "sampling_interval": sampling_interval,
            "slots": slots,
            "coverage": asdict(coverage),
            "warmup_slots": warmup_slots,
            "random_colors": random_colors,
            "seed": seed,
            "camera": renderer().metadata(),
        }
        check_space(partial, sum(split.episodes for split in splits.values()) * (slots + 1) * FRAME_BYTES)
        journal = Journal(partial / JOURNAL, metadata)
        if not journal.done:
            for stale in partial.iterdir():
                if stale.is_dir():
                    shutil.rmtree(stale)
        stored = {}
        for index, (name, split) in enumerate(splits.items()):
            if f"{name} simulated" not in journal.done:
                stream = seed * 1000 + index
                fleet = FleetEnv(
                    split.episodes,
                    sampling_interval=sampling_interval,
                    episode_length=slots,
                    random_colors=random_colors,
                    start=StartDistribution(),
                    seed=stream,
                    terminate_on_failure=False,
                )
                generator = torch.Generator().manual_seed(stream)
                trajectories = simulate(
                    split, coverage, slots, warmup_slots, fleet, Expert(sampling_interval), generator
                )
                shutil.rmtree(partial / name, ignore_errors=True)
                start_split(partial / name, trajectories)
                journal.add(f"{name} simulated")
            stored[name] = TensorDict.load_memmap(partial / name, allow_pickle=False)
        render_missing(stored, journal, workers, random_colors, folder.name)
        counts = torch.zeros(40, dtype=torch.float64)
        for split in stored.values():
            counts += torch.histc(split["action"][:, :-1].double(), 40, -20, 20)
        metadata["command_histogram"] = {"from": -20, "to": 20, "counts": counts.long().tolist()}
        cv2_write(partial / "contact_sheet.png", contact_sheet(stored))
        publish(partial, folder, metadata)
    return folder


def check_space(folder: Path, needed: int) -> None:
    """Raises OSError where the disk cannot hold ``needed`` more bytes; a full one would kill whoever writes a map."""
    free = shutil.disk_usage(folder).free + sum(path.stat().st_blocks * 512 for path in folder.rglob("*"))
    if free < needed:
        raise OSError(f"The data set needs {needed / 1e6:.0f} MB, and {folder.parent} has {free / 1e6:.0f} MB free.")


def start_split(folder: Path, trajectories: TensorDict) -> None:
    """Writes all of one split but the frames, for which it makes room."""
    stored = trajectories.memmap(folder)
    shape = torch.Size((*trajectories.batch_size, HEIGHT, WIDTH, 3))
    stored.make_memmap("pixels", shape=shape, dtype=torch.uint8)
    if hasattr(os, "posix_fallocate"):
        # a map of a file without its blocks ends the process, without a word, on the frame that no longer fits
        with (folder / "pixels.memmap").open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, stored["pixels"].numel())


def render_missing(
    stored: dict[str, TensorDict], journal: Journal, workers: Workers, random_colors: bool, name: str
) -> None:
    """Renders the episodes that the journal does not have, each one an item of work."""
    episodes = [(split, episode) for split, data in stored.items() for episode in range(len(data))]
    missing = [item for item in episodes if f"{item[0]} {item[1]}" not in journal.done]
    frames = stored[missing[0][0]].shape[1] if missing else 0

    def views() -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
        for split, episode in missing:
            data = stored[split][episode]
            colors = data["colors"].numpy() if random_colors else None
            yield data["state"][:, :2].double().numpy(), colors

    with tqdm(total=len(missing) * frames, unit="frame", desc=f"collect {name}") as progress:
        for index, pixels in run_items(render_episode, views(), workers):
            split, episode = missing[index]
            stored[split]["pixels"][episode] = torch.from_numpy(pixels)
            journal.add(f"{split} {episode}")
            progress.update(frames)


@functools.cache
def renderer() -> Renderer:
    """The camera of this process."""
    return Renderer()


def render_episode(view: tuple[np.ndarray, np.ndarray | None]) -> np.ndarray:
    """Frames [T + 1, H, W, 3] of one episode from its qpos [T + 1, 2] and colours [T + 1, 2, 3] or None."""
    return renderer().render(*view)


def cv2_write(path: Path, image: np.ndarray) -> None:
    """Writes an RGB picture."""
    import cv2

    cv2.imwrite(str(path), image[..., ::-1])
