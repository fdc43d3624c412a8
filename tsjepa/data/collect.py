"""Collects a data set: trajectories of a plant under its expert, their frames rendered afterwards in one sweep."""

from __future__ import annotations

import functools
import json
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
from tsjepa.data.frames import release
from tsjepa.data.storage import JOURNAL, METADATA, check_space, publish, start_split, write_picture
from tsjepa.envs import FleetEnv
from tsjepa.plants import Plant, build_plant, describe_plant
from tsjepa.plants.plant import check_plant, expert_of
from tsjepa.support.checks import at_least, within
from tsjepa.support.files import exclusive, refuse_to_replace
from tsjepa.support.journal import Journal
from tsjepa.support.seeds import derive
from tsjepa.support.workers import RAY, Workers, run_items

BINS = 40  # of the histogram of commands


@dataclass
class Split:
    """One split of the data set.

    Args:
        episodes: number of trajectories.
        coverage: changing set-points and exploration noise; False gives the plain expert, as the paper has it.
        slots: T of its trajectories, if not that of the data set.
        views: how often each trajectory is drawn, in an appearance of its own each time. The views are episodes of
            their own, one after the other; only the plant's appearance differs between them.
        late_slots: slots after the warm-up until the expert is heard, at rest: a draw from 0 to this many for each
            trajectory. What waits for its first command on a radio is then in the data.
    """

    episodes: int
    coverage: bool = True
    slots: int | None = None
    views: int = 1
    late_slots: int = 0

    @property
    def drawn(self) -> int:
        """Episodes on disk."""
        return self.episodes * self.views


@dataclass
class Coverage:
    """How the expert is made to visit the state space, which decides what an encoder can learn more than its loss does.

    Args:
        noise_memory: a of the command noise n[k+1] = a n[k] + b N(0, 1).
        noise_std: b, in half ranges of the actuator.
    """

    noise_memory: float = 0.8
    noise_std: float = 0.075

    def __post_init__(self) -> None:
        at_least(0, noise_std=self.noise_std)
        within(-1, 1, noise_memory=self.noise_memory)

    def noise(self, plant: Plant, episodes: int, slots: int, generator: torch.Generator) -> Tensor:
        """Command noise [episodes, slots, m], in the command's units."""
        half_range = torch.tensor(plant.spec.action_range) / 2
        noise = self.noise_std * half_range * torch.randn(episodes, slots, len(half_range), generator=generator)
        for slot in range(1, slots):
            noise[:, slot] += self.noise_memory * noise[:, slot - 1]
        return noise


DEFAULT_COVERAGE = Coverage()


def simulate(
    plant: Plant, split: Split, coverage: Coverage, slots: int, warmup_slots: int, fleet: FleetEnv, seed: int
) -> TensorDict:
    """Runs ``split.episodes`` plants for ``slots`` slots; returns all but the pixels, [split.drawn, slots + 1]."""
    spec, expert = plant.spec, expert_of(plant)
    low, high = torch.tensor(spec.action_low), torch.tensor(spec.action_high)
    generator = torch.Generator().manual_seed(seed)
    noise = goals = None
    if split.coverage:
        goals = plant.goals(split.episodes, slots, generator)
        noise = coverage.noise(plant, split.episodes, slots, generator)
    waits = np.random.default_rng(derive(seed, "late")).integers(0, split.late_slots + 1, split.episodes)
    heard_from = torch.from_numpy(warmup_slots + waits).unsqueeze(-1)
    observation = fleet.reset()
    devices = np.arange(split.episodes)
    rest = torch.tensor(spec.rest)

    def seen() -> Tensor:
        """Scenes [episodes, views, s]; a further view looks as a further episode of the same device would."""
        views = [observation["scene"][:, -1]]
        for view in range(1, split.views):
            physics = observation["physics_state"].numpy()
            views.append(torch.from_numpy(plant.scene(physics, seed, devices, np.full_like(devices, view))))
        return torch.stack(views, dim=1)

    states, actions, scenes, references = [observation["state"]], [], [seen()], []
    for slot in range(slots):
        own = observation.get("reference", None)
        references.append(own)
        action = expert(observation["state"], own if goals is None else goals[:, slot])
        if noise is not None:
            action = torch.clamp(action + noise[:, slot], low, high)
        action = torch.where(slot < heard_from, rest.to(action), action)
        observation = fleet.step(observation.set("action", action))["next"]
        states.append(observation["state"])
        scenes.append(seen())
        actions.append(action)
    references.append(observation.get("reference", None))
    state = torch.stack(states, dim=1)
    reference = None if references[0] is None else torch.stack(references, dim=1)
    recorded = {
        "state": state,
        "action": torch.stack([*actions, torch.zeros_like(action)], dim=1),
        "expert_action": expert(state, reference),
    }
    if reference is not None:
        recorded["reference"] = reference
    recorded = {key: value.repeat_interleave(split.views, 0) for key, value in recorded.items()}
    recorded["scene"] = torch.stack(scenes, dim=2).flatten(0, 1)
    return TensorDict(recorded, batch_size=[split.drawn, slots + 1])


def collect(
    path: str,
    plant: Plant,
    splits: dict[str, Split],
    slots: int = 100,
    coverage: Coverage = DEFAULT_COVERAGE,
    warmup_slots: int = 0,
    seed: int = 0,
    overwrite: bool = False,
    workers: Workers = 1,
) -> Path:
    """Writes a memory-mapped data set; it appears under ``path`` whole, or not at all.

    Work in progress lies beside it with the suffix ``.partial``. The same command goes on from there after a kill; the
    bytes are the same, however often it was killed and however many workers there were.

    Args:
        path: folder of the data set.
        plant: the kind of machine.
        splits: name to size and behaviour; every split has its own random streams.
        slots: T; a trajectory has T commands and T + 1 frames.
        coverage: behaviour of the splits that ask for it.
        warmup_slots: slots at rest at the start of a trajectory. The evaluation has kappa - 1 of them, and an
            encoder that never saw them takes the expert's command for granted: its first velocities are then wrong.
        seed: seed of every stream.
        overwrite: replace the data set that is there.
        workers: processes that render, or "ray" for a Ray cluster.
    """
    if workers != RAY:
        at_least(1, workers=workers)
    for name, split in splits.items():
        at_least(1, **{f"splits.{name}.episodes": split.episodes, f"splits.{name}.views": split.views})
        at_least(0, **{f"splits.{name}.late_slots": split.late_slots})
        if split.slots is not None:
            at_least(1, **{f"splits.{name}.slots": split.slots})
    at_least(1, slots=slots)
    if not splits or not all(name.isidentifier() for name in splits):
        raise ValueError(f"splits is {splits}; a data set needs at least one, and their names become folders.")
    check_plant(plant)
    folder = Path(path)
    with exclusive(folder):
        if folder.exists() and not overwrite:
            raise FileExistsError(f"{folder} exists; pass --overwrite true to collect it anew, or choose another path.")
        refuse_to_replace(folder, "data set", METADATA)
        partial = folder.with_name(folder.name + ".partial")
        partial.mkdir(parents=True, exist_ok=True)
        metadata = {
            "splits": {name: asdict(split) | {"slots": split.slots or slots} for name, split in splits.items()},
            "plant": describe_plant(plant),
            "spec": plant.spec.to_dict(),
            "slots": slots,
            "coverage": asdict(coverage),
            "warmup_slots": warmup_slots,
            "seed": seed,
            "camera": plant.camera(),
        }
        frames = sum(split.drawn * ((split.slots or slots) + 1) for split in splits.values())
        check_space(partial, frames * 3 * int(np.prod(plant.spec.frame)))
        journal = Journal(partial / JOURNAL, metadata)
        if not journal.done:
            for stale in partial.iterdir():
                if stale.is_dir():
                    shutil.rmtree(stale)
        stored = {}
        for name, split in splits.items():
            if f"{name} simulated" not in journal.done:
                length = split.slots or slots
                stream = derive(seed, "collect", name)
                fleet = FleetEnv(plant, split.episodes, length, seed=stream, terminate_on_failure=False)
                trajectories = simulate(plant, split, coverage, length, warmup_slots, fleet, stream)
                shutil.rmtree(partial / name, ignore_errors=True)
                start_split(partial / name, trajectories, plant.spec.frame)
                journal.add(f"{name} simulated")
            stored[name] = TensorDict.load_memmap(partial / name, allow_pickle=False)
        render_missing(stored, journal, workers, metadata["plant"], folder.name)
        metadata["command_histogram"] = command_histogram(stored, plant)
        write_picture(partial / "contact_sheet.png", contact_sheet(stored))
        publish(partial, folder, metadata)
    return folder


def command_histogram(stored: dict[str, TensorDict], plant: Plant) -> list[dict]:
    """How often each command was applied, for every number of the command."""
    histograms = []
    for index, (low, high) in enumerate(zip(plant.spec.action_low, plant.spec.action_high, strict=True)):
        counts = torch.zeros(BINS, dtype=torch.float64)
        for split in stored.values():
            counts += torch.histc(split["action"][:, :-1, index].double(), BINS, low, high)
        histograms.append({"from": low, "to": high, "counts": counts.long().tolist()})
    return histograms


def render_missing(stored: dict[str, TensorDict], journal: Journal, workers: Workers, plant: dict, name: str) -> None:
    """Renders the episodes that the journal does not have, each one an item of work."""
    episodes = [(split, episode) for split, data in stored.items() for episode in range(len(data))]
    missing = [item for item in episodes if f"{item[0]} {item[1]}" not in journal.done]
    described = json.dumps(plant)

    def scenes() -> Iterator[tuple[str, np.ndarray]]:
        for split, episode in missing:
            yield described, stored[split][episode]["scene"].numpy()

    total = sum(stored[split].shape[1] for split, _ in missing)
    with tqdm(total=total, unit="frame", desc=f"collect {name}") as progress:
        for index, pixels in run_items(render_episode, scenes(), workers):
            split, episode = missing[index]
            if pixels.shape != stored[split]["pixels"][episode].shape:
                raise ValueError(
                    f"The plant draws pictures of shape {list(pixels.shape[1:])}; its spec says "
                    f"{list(stored[split]['pixels'].shape[2:])}."
                )
            stored[split]["pixels"][episode] = torch.from_numpy(pixels)
            release(stored[split]["pixels"])
            journal.add(f"{split} {episode}")
            progress.update(len(pixels))


@functools.cache
def plant_of(described: str) -> Plant:
    """The plant of this process, with its camera."""
    return build_plant(json.loads(described), trusted=True)  # a worker draws what the caller has built and stepped


def render_episode(item: tuple[str, np.ndarray]) -> np.ndarray:
    """Frames [T + 1, H, W, 3] of one episode from the plant's description and its scenes [T + 1, s]."""
    described, scenes = item
    return plant_of(described).render(scenes)
