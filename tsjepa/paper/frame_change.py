"""Mean absolute percentage error between consecutive frames (paper fig_data_Aug, eq. eq5_MAPE)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tsjepa.data.augmentation import Augmentation
from tsjepa.data.collect import Coverage, Split, simulate
from tsjepa.envs import FleetEnv
from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge, setbacks
from tsjepa.paper.store import flat
from tsjepa.plants import CartPole
from tsjepa.plants.mujoco_plant import changing_goals
from tsjepa.support.seeds import derive

TITLE = "MAPE between consecutive frames"
CAPTION = (
    "Cumulative distribution of the mean absolute percentage change of a pixel (0..255, all colours) between "
    "consecutive frames of the training distribution, 2 s a trajectory at every sampling interval. Pixels whose "
    "previous value is 0 as the camera sees it are left out (the share is recorded), with and without augmentation. "
    "Augmented: every frame with its own draw of the paper's colour jitter and colour dropping; our training draws "
    "once a window of frames instead. Shaded: 95 % interval over seeds."
)
MEASURES = ("median", "mean")
QUANTILES = tuple(range(0, 101, 2))  # of the distribution, in percent
SHOWN = "independent"
ABOUT_FIVE = 8.0  # times
MEANINGFUL = 5.0  # percent of change; the paper's brightness jitter alone is as much
DURATION, HELD = 2.0, 0.5  # s, of a trajectory and of a set-point, as in the training data
TRAINING_INTERVAL = 0.02  # s, for which the training data's exploration noise is given


def points(intervals_ms: Sequence[float], augmentations: Sequence[str], seeds: int, episodes: int, pairs: int):
    """The sweep: every interval with every augmentation, "none" or "independent".

    Args:
        intervals_ms: sampling intervals.
        augmentations: see above.
        seeds: sets of trajectories.
        episodes: in each.
        pairs: of frames, spread over the 2 s of each trajectory.
    """
    sizes = {"seeds": seeds, "episodes": episodes, "pairs": pairs}
    return [
        {"interval_ms": interval, "augmentation": augmentation} | sizes
        for augmentation in augmentations
        for interval in intervals_ms
    ]


def evaluate(point: dict) -> list[dict]:
    """Quantiles, mean and masked share, one row a seed."""
    rows = []
    for seed in range(point["seeds"]):
        frames = consecutive_frames(point["interval_ms"] / 1000, seed, point["episodes"], point["pairs"])
        known = frames[:, 0] != 0
        if point["augmentation"] == "independent":
            generator = torch.Generator().manual_seed(derive(seed, "frame change", "augmentation"))
            frames = augmented(frames.flatten(0, 1), generator).unflatten(0, frames.shape[:2])
        error = mape(frames[:, 1].float(), frames[:, 0].float(), known)
        rows.append(
            {
                "seed": seed,
                "median": float(error.median()),
                "mean": float(error.mean()),
                "percentile_90": float(error.quantile(0.9)),
                "masked_share": float((~known).double().mean()),
                "quantiles": np.percentile(error.numpy(), QUANTILES).tolist(),
            }
        )
    return rows


def mape(frames: Tensor, previous: Tensor, known: Tensor) -> Tensor:
    """Mean absolute percentage change per frame [N].

    Args:
        frames, previous: [N, H, W, 3] in 0..255.
        known: which values count, [N, H, W, 3]; where one of them was 0 before, 1 stands in its place.
    """
    change = torch.where(known, (frames - previous).abs() / previous.clamp_min(1), 0.0)
    return 100 * change.sum((1, 2, 3)) / known.sum((1, 2, 3))


class OnItsOwnTime(CartPole):
    """The cart-pole whose set-points are held for as many seconds at every sampling interval."""

    def goals(self, episodes: int, slots: int, generator: torch.Generator) -> Tensor:
        """Wanted positions [episodes, slots, 1] in metres."""
        low, high, hold = self.spec.reference_low, self.spec.reference_high, max(1, round(HELD / self.spec.slot))
        return changing_goals(low, high, episodes, slots, generator, hold)


def consecutive_frames(sampling_interval: float, seed: int, episodes: int, pairs: int) -> Tensor:
    """uint8 [episodes * pairs, 2, H, W, 3]: neighbouring frames, evenly spread over trajectories of 2 s."""
    plant, slots = OnItsOwnTime(sampling_interval), round(DURATION / sampling_interval)
    # the training data's exploration noise, as long remembered and as strong at every interval
    noise, share = Coverage(), sampling_interval / TRAINING_INTERVAL
    coverage = Coverage(noise.noise_memory**share, noise.noise_std * share**0.5)
    stream = derive(seed, "frame change", "trajectories")
    fleet = FleetEnv(plant, episodes, slots, seed=stream, terminate_on_failure=False)
    scene = simulate(plant, Split(episodes), coverage, slots, 0, fleet, stream)["scene"]
    first = torch.linspace(0, slots - 1, pairs).long()
    neighbours = torch.stack((scene[:, first], scene[:, first + 1]), dim=2)
    return torch.from_numpy(plant.render(neighbours.flatten(0, 2).numpy())).unflatten(0, (episodes * pairs, 2))


def augmented(frames: Tensor, generator: torch.Generator) -> Tensor:
    """uint8 [N, H, W, 3] with the paper's colour augmentation, one draw a frame, clipped to whole 0..255."""
    augmentation = Augmentation()
    maps = augmentation.draw(len(frames), generator)
    # undo the normalisation, which the draw ends with
    scale, shift = 255 * augmentation.std[:, None], 255 * augmentation.mean
    linear, offset = maps[:, :, :3] * scale, maps[:, :, 3] * scale[:, 0] + shift
    mapped = torch.einsum("nij,nhwj->nhwi", linear, frames.float()) + offset[:, None, None]
    return mapped.round().clamp(0, 255)


def draw(records: list[dict], path: str | Path) -> None:
    """Two panels, without and with augmentation; a line an interval."""
    rows = flat(records)
    figure, axes = plots.canvas(columns=2)
    for axis, augmentation in zip(axes, ("none", SHOWN), strict=True):
        shown = plots.select(rows, augmentation=augmentation)
        intervals = plots.distinct(shown, "interval_ms")
        for color, interval in zip(plots.shades(len(intervals)), intervals, strict=True):
            seeds = plots.select(shown, interval_ms=interval)
            quantiles = torch.tensor([row["quantiles"] for row in seeds], dtype=torch.float64)
            share = [quantile / 100 for quantile in QUANTILES]
            axis.plot(quantiles.mean(0), share, color=color, label=f"{interval:g} ms")
            if len(seeds) > 1:
                halves = [plots.interval(column.tolist())[1] for column in quantiles.T]
                middle = quantiles.mean(0).numpy()
                axis.fill_betweenx(share, middle - halves, middle + halves, color=color, alpha=0.2, linewidth=0)
        axis.set(xlabel="MAPE between consecutive frames (%)", ylabel="pairs of frames (cumulative share)", ylim=(0, 1))
        axis.set_xscale("symlog", linthresh=0.1)
        axis.set_xlim(left=0)
        axis.set_title("without augmentation" if augmentation == "none" else "every frame augmented by itself")
    plots.legend(figure, axes, "sampling interval", columns=6)
    plots.save(figure, path, "How much does a frame change in one interval?")


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """Whether the change grows with the interval, and what augmentation does to its range."""
    medians, reach = by_interval(records, "none", "median"), by_interval(records, "none", "percentile_90")
    reach_augmented = by_interval(records, SHOWN, "percentile_90")
    found = {}
    if len(medians) > 1:
        found["interval_changes_frames"] = judge(
            not setbacks(medians),
            "median MAPE " + ", ".join(f"{median:.2f} % at {interval:g} ms" for interval, median in medians.items()),
            setbacks(medians) + " ms",
            partly=medians[min(medians)] < medians[max(medians)],
        )
    if 1 in medians and len(medians) > 1:
        masked = by_interval(records, "none", "masked_share")[1]
        longest = max(medians)
        found["one_millisecond"] = judge(
            medians[1] > MEANINGFUL,
            f"median MAPE {medians[1]:.2f} % at 1 ms, {medians[longest]:.1f} % at {longest:g} ms, in the "
            f"{1 - masked:.0%} of the pixels that are not black",
            f"less than the {MEANINGFUL:g} % that the paper's brightness jitter alone makes",
        )
    ratios = {
        interval: reach_augmented[interval] / reach[interval] for interval in reach if interval in reach_augmented
    }
    if ratios:
        ours = "90th percentile of the MAPE grows " + ", ".join(f"{r:.1f}-fold at {i:g} ms" for i, r in ratios.items())
        found["augmentation_five_fold"] = judge(
            1 < max(ratios.values()) < ABOUT_FIVE,
            ours,
            f"up to {max(ratios.values()):.0f}-fold",
            partly=max(ratios.values()) > 1,
        )
    return found


def by_interval(records: list[dict], augmentation: str, measure: str) -> dict[float, float]:
    """Means of a measure, by interval in ascending order."""
    rows = plots.select(flat(records), augmentation=augmentation)
    intervals = sorted(plots.distinct(rows, "interval_ms"))
    return {interval: plots.mean(plots.select(rows, interval_ms=interval), measure) for interval in intervals}
