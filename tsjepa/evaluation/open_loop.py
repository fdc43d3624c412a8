"""What an embedding is worth on recorded test trajectories: command error, probed state, prediction against copying."""

from __future__ import annotations

import math
from typing import Any

import torch
from scipy import stats
from tensordict import TensorDictBase
from torch import Tensor

from tsjepa.data.storage import open_split, read_metadata, spec_of
from tsjepa.models import Controller
from tsjepa.models.predictor import rollout
from tsjepa.training.embeddings import embed_split
from tsjepa.training.monitor import SKILL_HORIZONS, action_sensitivity, effective_rank, prediction_errors

LONGEST_HORIZON = 50


def fitting_metadata(model: Controller, data: str, split: str = "test") -> dict:
    """Metadata of the data set in ``data``, before anything takes minutes.

    Raises:
        FileNotFoundError, ValueError: there is no data set, it is damaged, or its frames, commands or states are not
            those of the machine that ``model`` was trained on.
        KeyError: no such split.
    """
    metadata = read_metadata(data)
    open_split(data, split)
    given, wanted = spec_of(metadata), model.spec
    sizes = {"frames": (given.frame, wanted.frame), "commands": ((given.action_dim,), (wanted.action_dim,))}
    if given.state_dim and model.probe is not None:
        sizes["states"] = (given.state_dim,), (wanted.state_dim,)
    for what, (here, there) in sizes.items():
        if here != there:
            raise ValueError(
                f"The data set in {data} has {what} of shape {list(here)}, and the model was trained with "
                f"{list(there)}: give data of a machine like the one that it was trained on."
            )
    return metadata


@torch.no_grad()
def open_loop_metrics(model: Controller, data: str, split: str = "test") -> dict:
    """All figures of one split of the data set in ``data``; RMSE in the units of the state.

    What is said about predictions or commands is left out of a controller that makes none, and what is said about
    states where nobody recorded or probes them. The command error is that to the expert, or to the recorded commands
    where no expert was asked.
    """
    embedded = embed_split(model.encoder, open_split(data, split), model.frame_spacing)
    rows = embedded.flatten(0, 1)
    figures: dict[str, Any] = command_error(model, rows) if model.acts else {}
    if model.probe is not None and "state" in rows:
        figures["probe_rmse"] = (probed(model, rows["embedding"]) - rows["state"]).square().mean(0).sqrt().tolist()
    figures["effective_rank"] = float(effective_rank(rows["embedding"]))
    if not model.has_predictor:
        return figures
    figures["action_sensitivity"] = float(action_sensitivity(model.predictor, rows["embedding"], model.spec))
    figures |= skill_over_copying(model, embedded)
    if "probe_rmse" in figures:
        longest = min(LONGEST_HORIZON, embedded.shape[1] - 1)
        predicted, copied = probed_prediction_error(model, embedded, longest)
        figures["horizons_closer_than_copy"] = int((predicted < copied).sum())
        figures["probed_error_predicted"], figures["probed_error_copied"] = predicted.tolist(), copied.tolist()
    return figures


def skill_over_copying(model: Controller, embedded: TensorDictBase) -> dict:
    """By horizon, how much nearer the prediction is than the copied embedding (1: perfect, 0: not at all), and the
    half-width of its 95 % interval over trajectories (jackknife, Student's t).

    None where there is none: no interval of one trajectory, nor a skill where all embeddings are alike.
    """
    horizons = [horizon for horizon in SKILL_HORIZONS if horizon < embedded.shape[1]]
    pair = prediction_errors(model.predictor, embedded["embedding"], embedded["action"], max(horizons))
    error, copied = (part[:, [horizon - 1 for horizon in horizons]] for part in pair)
    count = len(error)
    skill = 1 - error.sum(0) / copied.sum(0)
    without = 1 - (error.sum(0) - error) / (copied.sum(0) - copied)  # one of the trajectories
    spread = ((count - 1) / count * (without - without.mean(0)).square().sum(0)).sqrt()
    half = stats.t.ppf(0.975, count - 1) * spread

    def by_horizon(values: Tensor) -> dict[str, float | None]:
        pairs = zip(horizons, values.tolist(), strict=True)
        return {str(horizon): value if math.isfinite(value) else None for horizon, value in pairs}

    return {"skill_over_copying": by_horizon(skill), "skill_interval_95": by_horizon(half)}


def command_error(model: Controller, rows: TensorDictBase) -> dict:
    """Mean distance of the commands over the actuator's range, and what it is a distance to.

    Numbers of a command that never change in these rows are left out: to hold them still is no skill.
    """
    wanted = "expert_action" if "expert_action" in rows else "action"
    reference = rows.get("reference", None)
    if reference is None:
        # the set-points of trajectories that have none are the goal itself
        reference = rows["embedding"].new_zeros(len(rows), model.spec.reference_dim)
    # in parts: an autoencoder draws the frames of every row
    pairs = zip(rows["embedding"].split(500), reference.split(500), strict=True)
    command = torch.cat([model.act(*pair) for pair in pairs])
    span = torch.tensor(model.spec.action_range, device=command.device)
    moves = rows[wanted].amax(0) > rows[wanted].amin(0)
    moves = moves if moves.any() else ~moves
    error = ((command - rows[wanted]).abs() / span)[:, moves].mean()
    return {"command_nmae": float(error), "command_nmae_to": wanted}


def probed(model: Controller, embedding: Tensor) -> Tensor:
    """The states [N, n] that the probe reads from embeddings [N, d]."""
    return torch.cat([model.probe(part) for part in embedding.split(500)])


@torch.no_grad()
def probed_prediction_error(model: Controller, embedded: TensorDictBase, longest: int) -> tuple[Tensor, Tensor]:
    """Distance of the probed state to the truth, for prediction and copied embedding, at horizons 1..longest.

    Every component of the state is divided by its standard deviation over the data before the root mean square;
    components that never change in the data are left out.

    Args:
        embedded: [episodes, slots] with ``embedding``, ``action``, ``state``.
        longest: in slots.

    Returns:
        Two tensors [longest].
    """
    starts = range(0, embedded.batch_size[1] - longest, 5)
    origin = torch.stack([embedded["embedding"][:, start] for start in starts])
    commands = torch.stack([embedded["action"][:, start : start + longest] for start in starts])
    truth = torch.stack([embedded["state"][:, start + 1 : start + longest + 1] for start in starts])
    state = embedded["state"].flatten(0, 1)
    moves, scale = state.amax(0) > state.amin(0), state.std(0)
    if not moves.any():
        moves, scale = ~moves, torch.ones_like(scale)

    def error(states: Tensor) -> Tensor:
        return ((states - truth) / scale)[..., moves].square().mean((0, 1, 3)).sqrt()

    return error(model.probe(rollout(model.predictor, origin, commands))), error(model.probe(origin)[..., None, :])
