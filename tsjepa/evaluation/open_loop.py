"""What an embedding is worth on recorded test trajectories: command error, probed state, prediction against copying."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from tsjepa.data.storage import open_split
from tsjepa.evaluation.metrics import COMMAND_RANGE
from tsjepa.models.predictor import rollout
from tsjepa.training.embeddings import embed_split
from tsjepa.training.monitor import SKILL_HORIZONS, action_sensitivity, effective_rank, prediction_skill

LONGEST_HORIZON = 50


@torch.no_grad()
def open_loop_metrics(model: nn.Module, data: str, split: str = "test") -> dict:
    """All figures of one split of the data set in ``data``; RMSE in m, rad, m/s, rad/s.

    What is said about predictions is left out of a controller that makes none.
    """
    embedded = embed_split(model.encoder, open_split(data, split), model.frame_spacing)
    embedding, rows = embedded["embedding"], embedded.flatten(0, 1)
    # in parts: an autoencoder draws the frames of every row
    parts = rows["embedding"].split(500)
    command, state = torch.cat([model.act(part) for part in parts]), torch.cat([model.probe(part) for part in parts])
    figures = {
        "command_nmae": float((command - rows["expert_action"]).abs().mean() / COMMAND_RANGE),
        "probe_rmse": (state - rows["state"]).square().mean(0).sqrt().tolist(),
        "effective_rank": float(effective_rank(rows["embedding"])),
    }
    if not model.has_predictor:
        return figures
    skill = prediction_skill(model.predictor, embedding, embedded["action"], SKILL_HORIZONS)
    predicted, copied = probed_prediction_error(model, embedded, LONGEST_HORIZON)
    return {
        **figures,
        "action_sensitivity": float(action_sensitivity(model.predictor, rows["embedding"])),
        "skill_over_copying": {str(horizon): float(value) for horizon, value in skill.items()},
        "horizons_closer_than_copy": int((predicted < copied).sum()),
        "probed_error_predicted": predicted.tolist(),
        "probed_error_copied": copied.tolist(),
    }


@torch.no_grad()
def probed_prediction_error(model: nn.Module, embedded: TensorDictBase, longest: int) -> tuple[Tensor, Tensor]:
    """Distance of the probed state to the truth, for prediction and copied embedding, at horizons 1..longest.

    Every component of the state is divided by its standard deviation over the data before the root mean square.

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
    scale = embedded["state"].flatten(0, 1).std(0)

    def error(probed: Tensor) -> Tensor:
        return ((probed - truth) / scale).square().mean((0, 1, 3)).sqrt()

    return error(model.probe(rollout(model.predictor, origin, commands))), error(model.probe(origin)[..., None, :])
