"""t-SNE of twenty trajectories, with pairs of frames that show one state in two colours (paper fig_t_SNE)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge
from tsjepa.paper.rows import expert_embeddings, load
from tsjepa.paper.store import flat
from tsjepa.plants import CartPole
from tsjepa.support.seeds import derive

TITLE = "t-SNE of the embeddings"
CAPTION = (
    "t-SNE of the embeddings of twenty trajectories that the expert drives, coloured by the cart's position and by the "
    "pole's angle; lines join pairs of frames that show one state in two random colours of cart and pole. Colour "
    "distance: the distance between such a pair's embeddings over the median distance between different states, 500 "
    "pairs a seed. Neighbour error: how far the true state (position and angle, over their standard deviations) of the "
    "ten nearest embeddings from other trajectories lies, over that of ten drawn at random."
)
MEASURES = ("colour_distance", "neighbour_error")
OURS, AUTOENCODER = "TS-JEPA", "autoencoder"
NEIGHBOURS = 10
CLEARER = 0.8  # of the autoencoder's neighbour error
CLOSE, CLOSER = 0.3, 0.5  # colour distance, and of the autoencoder's


def points(models: dict, seeds: int, trajectories: int, slots: int, every: int, pairs: int, marked: int) -> list[dict]:
    """One point a model.

    Args:
        models: entry of the zoo, or its folder, by label; the claims compare "TS-JEPA" and "autoencoder".
        seeds: sets of colour pairs and trajectories.
        trajectories, slots, every: how many, how long, and every which slot is embedded.
        pairs: of one state in two colours, a seed.
        marked: of these, shown in the plot.
    """
    sizes = {"seeds": seeds, "trajectories": trajectories, "slots": slots, "every": every, "pairs": pairs}
    return [{"label": label, "model": model} | sizes | {"marked": marked} for label, model in models.items()]


def evaluate(point: dict) -> list[dict]:
    """The two numbers, one row a seed, and whether the model was trained on drawn colours.

    The first row carries the map: ``x``, ``y``, ``position``, ``angle``.
    """
    from sklearn.manifold import TSNE

    model = load(point["model"])
    rows = []
    for seed in range(point["seeds"]):
        embedding, state, trajectory = trajectories(point, seed)
        first, second = two_colours(model, point["pairs"], seed)
        rows.append(
            {
                "seed": seed,
                "colour_distance": colour_distance(first, second),
                "neighbour_error": neighbour_error(embedding, state, trajectory),
                "drawn_colours": draws_colours(model.plant),
            }
        )
        if seed == 0:
            # the marked pairs lie behind the trajectories, first colour and second colour in turn
            marked = torch.stack((first[: point["marked"]], second[: point["marked"]]), 1).flatten(0, 1)
            together = torch.cat((embedding, marked)).numpy()
            flat_map = TSNE(init="pca", random_state=0).fit_transform(together).round(2)
            rows[0] |= {
                "x": flat_map[:, 0].tolist(),
                "y": flat_map[:, 1].tolist(),
                "position": state[:, 0].tolist(),
                "angle": state[:, 1].tolist(),
            }
    return rows


def trajectories(point: dict, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Embeddings [N, d], states [N, n] and trajectory numbers [N] along loops that the expert closes."""
    loops = {
        "model": point["model"],
        "starts": point["trajectories"],
        "slots": point["slots"],
        "process_noise_std": 0.0,
    }
    embedding, state = expert_embeddings(loops, derive(seed, "t-SNE", "trajectories"), point["every"])
    return embedding, state, torch.arange(point["trajectories"]).repeat(len(state) // point["trajectories"])


@torch.no_grad()
def two_colours(model, pairs: int, seed: int) -> tuple[Tensor, Tensor]:
    """Embeddings [pairs, d] of the same random states in two random colours each; the cart-poles stand still."""
    plant, stream = CartPole(model.spec.slot, random_colors=True), derive(seed, "t-SNE", "colours")
    device, embedded = np.arange(pairs), []
    physics = plant.start(stream, device, np.zeros_like(device))
    for episode in range(2):
        scene = plant.scene(physics, stream, device, np.full_like(device, episode))
        frames = torch.from_numpy(plant.render(scene))
        embedded.append(model.encode(frames[:, None].expand(-1, model.frame_stack, -1, -1, -1).contiguous()))
    return embedded[0], embedded[1]


def draws_colours(plant: dict | None) -> bool:
    """Whether the described plant, the one that a model was trained on, draws its colours."""
    arguments = (plant or {}).get("init_args") or {}
    appearance = arguments.get("appearance") or {"init_args": {}}
    return bool(arguments.get("random_colors") or appearance["init_args"].get("colors"))


def colour_distance(first: Tensor, second: Tensor) -> float:
    """Median distance of the pairs over the median distance between different states, in one colour or two."""
    different = torch.cdist(first, second)
    apart = ~torch.eye(len(first), dtype=torch.bool)
    return float((first - second).norm(dim=-1).median() / different[apart].median())


def neighbour_error(embedding: Tensor, state: Tensor, trajectory: Tensor) -> float:
    """Distance in position and angle of the nearest embeddings of other trajectories, over that of random ones."""
    shown = state[:, :2] / state[:, :2].std(0)
    apart = trajectory[:, None] != trajectory
    distance = torch.cdist(embedding, embedding).masked_fill(~apart, torch.inf)
    nearest = distance.topk(NEIGHBOURS, largest=False).indices
    between = torch.cdist(shown, shown)
    return float(between.gather(1, nearest).mean() / between[apart].mean())


def draw(records: list[dict], path: str | Path) -> None:
    """A column a model, coloured by position above and by angle below."""
    figure, axes = plots.canvas(columns=len(records), rows=2, width=4.8)
    for column, record in enumerate(records):
        shown, point = record["rows"][0], record["point"]
        count = len(shown["position"])
        for row, (value, unit) in enumerate((("position", "m"), ("angle", "rad"))):
            axis = axes[row * len(records) + column]
            scatter = axis.scatter(shown["x"][:count], shown["y"][:count], c=shown[value], s=3, cmap="coolwarm")
            figure.colorbar(scatter, ax=axis, label=f"{value} ({unit})")
            for pair in range(point["marked"]):
                ends = slice(count + 2 * pair, count + 2 * pair + 2)
                axis.plot(shown["x"][ends], shown["y"][ends], "k.-", linewidth=0.8, markersize=4)
            axis.set_xticks([])
            axis.set_yticks([])
            axis.set_title(f"{point['label']}, coloured by {value}", fontsize=10)
        axes[column].set_title(
            f"{point['label']}: colour distance {plots.text(record['rows'], 'colour_distance', 2)}", fontsize=10
        )
    plots.save(figure, path, "Do neighbours in the embedding see the same scene?")


def which(row: dict) -> str:
    """The model of a row, and where the row says so what it was trained on."""
    trained = {None: "", True: ", trained on drawn colours", False: ", trained on one colour of each part"}
    return f"`{row['model']}`{trained[row.get('drawn_colours')]}"


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """The two numbers, ours against the autoencoder's, and which models they are."""
    rows = flat(records)
    ours, theirs = plots.select(rows, label=OURS), plots.select(rows, label=AUTOENCODER)
    if not ours or not theirs:
        return {}

    def both(measure: str) -> str:
        figures = f"TS-JEPA {plots.text(ours, measure)}, autoencoder {plots.text(theirs, measure)}"
        return f"{figures}; TS-JEPA is {which(ours[0])}, the autoencoder {which(theirs[0])}"

    colour = plots.mean(ours, "colour_distance"), plots.mean(theirs, "colour_distance")
    neighbours = plots.mean(ours, "neighbour_error"), plots.mean(theirs, "neighbour_error")
    return {
        "clusters": judge(
            neighbours[0] < CLEARER * neighbours[1],
            f"neighbour error (0 is perfect, 1 is random): {both('neighbour_error')}",
            f"{neighbours[0] / neighbours[1]:.2f} times the autoencoder's",
            partly=neighbours[0] < neighbours[1],
        ),
        "colour": judge(
            colour[0] < CLOSE and colour[0] < CLOSER * colour[1],
            f"colour distance (0 is invariant, 1 is as far as another state): {both('colour_distance')}",
            f"{colour[0] / colour[1]:.2f} times the autoencoder's",
            partly=colour[0] < colour[1],
        ),
    }
