"""Collects the data set: trajectories of the plant under the expert, their frames rendered afterwards in one sweep."""

from __future__ import annotations

import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor
from tqdm import tqdm

from tsjepa.data.contact_sheet import contact_sheet
from tsjepa.data.storage import publish


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


def simulate(split: Split, coverage: Coverage, slots: int, fleet, expert, generator: torch.Generator) -> TensorDict:
    """Runs ``split.episodes`` plants for ``slots`` slots; returns all but the pixels, [episodes, slots + 1]."""
    if split.coverage:
        set_points, noise = coverage.draw(split.episodes, slots, generator)
    else:
        set_points, noise = torch.zeros(split.episodes, slots), torch.zeros(split.episodes, slots, 1)
    observation = fleet.reset()
    states, actions, colors = [observation["state"]], [], observation["colors"]
    for slot in range(slots):
        action = (expert(observation["state"], set_points[:, slot]) + noise[:, slot]).clamp(-20, 20)
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
    random_colors: bool = False,
    seed: int = 0,
    overwrite: bool = False,
) -> Path:
    """Writes a memory-mapped data set; it appears under ``path`` whole, or not at all.

    Args:
        path: folder of the data set. Work in progress lies beside it with the suffix ``.partial`` and is started anew.
        splits: name to size and behaviour; every split has its own random streams.
        sampling_interval: slot length in seconds.
        slots: T; a trajectory has T commands and T + 1 frames.
        coverage: behaviour of the splits that ask for it.
        random_colors: draw cart and pole colours per episode.
        seed: seed of every stream.
        overwrite: replace a data set that is there already.

    Returns:
        The folder.

    Raises:
        FileExistsError: there is a data set and ``overwrite`` is not set.
    """
    from tsjepa.envs import FleetEnv, Renderer, StartDistribution
    from tsjepa.envs.expert import Expert

    folder = Path(path)
    if folder.exists() and not overwrite:
        raise FileExistsError(f"{folder} exists; pass --overwrite true to collect it anew, or choose another path.")
    partial = folder.with_name(folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    renderer, expert = Renderer(), Expert(sampling_interval)
    frames = sum(split.episodes for split in splits.values()) * (slots + 1)
    histogram = torch.zeros(40, dtype=torch.float64)
    with tqdm(total=frames, unit="frame", desc=f"collect {folder.name}") as progress:
        for index, (name, split) in enumerate(splits.items()):
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
            trajectories = simulate(split, coverage, slots, fleet, expert, generator)
            shape = (split.episodes, slots + 1, renderer.height, renderer.width, 3)
            stored = trajectories.memmap(partial / name)
            pixels = stored.make_memmap("pixels", shape=torch.Size(shape), dtype=torch.uint8)
            for episode in range(split.episodes):
                qpos = trajectories["state"][episode, :, :2].double().numpy()
                colors = trajectories["colors"][episode].numpy() if random_colors else None
                pixels[episode] = torch.from_numpy(renderer.render(qpos, colors))
                progress.update(slots + 1)
            histogram += torch.histc(trajectories["action"][:, :-1].double(), 40, -20, 20)
    cv2_write(partial / "contact_sheet.png", contact_sheet({n: TensorDict.load_memmap(partial / n) for n in splits}))
    metadata = {
        "splits": {name: asdict(split) for name, split in splits.items()},
        "sampling_interval": sampling_interval,
        "slots": slots,
        "coverage": asdict(coverage),
        "random_colors": random_colors,
        "seed": seed,
        "camera": renderer.metadata(),
        "command_histogram": {"from": -20, "to": 20, "counts": histogram.long().tolist()},
    }
    if folder.exists():
        shutil.rmtree(folder)
    publish(partial, folder, metadata)
    return folder


def cv2_write(path: Path, image: np.ndarray) -> None:
    """Writes an RGB picture."""
    import cv2

    cv2.imwrite(str(path), image[..., ::-1])
