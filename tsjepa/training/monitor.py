"""What the representation is worth while it is being trained, and the alarm that stops a collapsed run."""

from __future__ import annotations

import lightning
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.predictor import rollout
from tsjepa.support.spec import PlantSpec
from tsjepa.training.embeddings import embed_split

SKILL_HORIZONS = (1, 5, 10, 25, 50)


class CollapseError(RuntimeError):
    """The representation has collapsed; the message says by which measure."""


def effective_rank(embedding: Tensor) -> Tensor:
    """Exponential of the entropy of the normalised singular values of the centred ``embedding`` [N, d] (RankMe)."""
    values = torch.linalg.svdvals((embedding - embedding.mean(0)).float())
    share = values / values.sum().clamp_min(1e-12)
    return torch.exp(-(share * share.clamp_min(1e-12).log()).sum())


def action_sensitivity(predictor: nn.Module, embedding: Tensor, spec: PlantSpec) -> Tensor:
    """Mean cosine between the predictions under the lowest and the highest commands; 1 means commands are ignored."""
    low, high = (
        predictor(embedding, embedding.new_tensor(command).expand(*embedding.shape[:-1], -1))
        for command in (spec.action_low, spec.action_high)
    )
    return F.cosine_similarity(low, high, dim=-1).mean()


def prediction_errors(predictor: nn.Module, embedding: Tensor, action: Tensor, longest: int) -> tuple[Tensor, Tensor]:
    """Mean cosine distance of the predicted and of the copied embedding to the true one, each [episodes, longest].

    Args:
        embedding: [episodes, slots, d].
        action: [episodes, slots, m].
        longest: horizon in slots, less than the slots.
    """
    starts = range(0, embedding.shape[1] - longest, 10)
    origin = torch.stack([embedding[:, start] for start in starts])
    commands = torch.stack([action[:, start : start + longest] for start in starts])
    truth = torch.stack([embedding[:, start + 1 : start + longest + 1] for start in starts])
    predicted = rollout(predictor, origin, commands)
    return (
        1 - F.cosine_similarity(predicted, truth, dim=-1).mean(0),
        1 - F.cosine_similarity(origin[..., None, :], truth, dim=-1).mean(0),
    )


def prediction_skill(
    predictor: nn.Module, embedding: Tensor, action: Tensor, horizons: tuple[int, ...]
) -> dict[int, Tensor]:
    """1 - (1 - cos(predicted, true)) / (1 - cos(copied, true)) by horizon: 1 is perfect, 0 no better than copying.

    Args:
        embedding: [episodes, slots, d].
        action: [episodes, slots, m].
        horizons: in slots; those longer than the trajectories are left out.
    """
    horizons = tuple(horizon for horizon in horizons if horizon < embedding.shape[1])
    error, copied = (part.mean(0) for part in prediction_errors(predictor, embedding, action, max(horizons)))
    return {horizon: 1 - error[horizon - 1] / copied[horizon - 1] for horizon in horizons}


def linear_probe_rmse(embedding: Tensor, state: Tensor, ridge: float = 1e-3) -> Tensor:
    """RMSE [n] of ridge regression from embedding to state, fitted on even trajectories and measured on odd ones.

    A single trajectory is cut in the middle: fitted on its first half, measured on its second.
    """
    if len(embedding) == 1:
        half = embedding.shape[1] // 2
        embedding, state = (torch.stack((part[0, :half], part[0, -half:])) for part in (embedding, state))

    def features(part: Tensor) -> Tensor:
        flat = part.flatten(0, 1) * part.shape[-1] ** 0.5
        return torch.cat((flat, torch.ones_like(flat[:, :1])), dim=1).double()

    train, test = features(embedding[::2]), features(embedding[1::2])
    target = state[::2].flatten(0, 1).double()
    gram = train.T @ train + ridge * len(train) * torch.eye(train.shape[1], device=train.device)
    weight = torch.linalg.solve(gram, train.T @ target)
    return (test @ weight - state[1::2].flatten(0, 1)).square().mean(0).sqrt()


@torch.no_grad()
def representation_metrics(
    encoder: nn.Module, predictor: nn.Module, split: TensorDictBase, frame_spacing: int, spec: PlantSpec
) -> dict[str, float]:
    """All measures of one split [episodes, T + 1], by the name under which they are logged.

    What needs states is left out of data without them.
    """
    data = embed_split(encoder, split, frame_spacing)
    embedding = data["embedding"]
    flat = embedding.flatten(0, 1)
    std = flat.std(0) * flat.shape[1] ** 0.5
    metrics = {
        "effective_rank": effective_rank(flat),
        "std_mean": std.mean(),
        "std_min": std.min(),
        "action_sensitivity": action_sensitivity(predictor, flat, spec),
    }
    for horizon, skill in prediction_skill(predictor, embedding, data["action"], SKILL_HORIZONS).items():
        metrics[f"skill_{horizon}"] = skill
    if spec.state_dim:
        for name, rmse in zip(spec.state_names, linear_probe_rmse(embedding, data["state"]), strict=True):
            metrics[f"probe_{name}"] = rmse
    return {name: float(value) for name, value in metrics.items()}


class RepresentationMonitor(lightning.Callback):
    """Logs :func:`representation_metrics` after every validation and test and stops a fit that has collapsed.

    Args:
        patience_epochs: collapse is not judged before this many epochs.
        min_effective_rank: below it the embedding has lost its dimensions.
        max_action_sensitivity: above it the predictor ignores the command.
    """

    def __init__(
        self, patience_epochs: int = 5, min_effective_rank: float = 2.0, max_action_sensitivity: float = 0.9999
    ) -> None:
        self.patience_epochs = patience_epochs
        self.min_effective_rank, self.max_action_sensitivity = min_effective_rank, max_action_sensitivity

    def on_test_batch_end(self, trainer, module, outputs, batch, batch_idx, dataloader_idx=0) -> None:
        self.log_metrics("test", trainer, module, batch)

    def on_validation_batch_end(self, trainer, module, outputs, batch, batch_idx, dataloader_idx=0) -> None:
        metrics = self.log_metrics("val", trainer, module, batch)
        module.log("rank", metrics["effective_rank"], prog_bar=True, logger=False, batch_size=1)
        if trainer.state.fn == "fit" and not trainer.sanity_checking and trainer.current_epoch >= self.patience_epochs:
            self.check(metrics)

    def log_metrics(self, stage: str, trainer, module, split: TensorDictBase) -> dict[str, float]:
        """Logs all measures of a split, and their ``skill``, the mean over horizons."""
        data = trainer.datamodule
        metrics = representation_metrics(module.encoder, module.predictor, split, data.frame_spacing, data.spec)
        skills = [value for name, value in metrics.items() if name.startswith("skill_")]
        metrics["skill"] = sum(skills) / len(skills)
        module.log_dict({f"{stage}/{name}": value for name, value in metrics.items()}, batch_size=1, sync_dist=True)
        return metrics

    def check(self, metrics: dict[str, float]) -> None:
        """Raises :class:`CollapseError` if the embedding has lost its dimensions or the predictor ignores commands."""
        if metrics["effective_rank"] < self.min_effective_rank:
            raise CollapseError(
                f"The representation collapsed: effective rank {metrics['effective_rank']:.2f} is below "
                f"{self.min_effective_rank}; raise variance_weight or lower the learning rate."
            )
        if metrics["action_sensitivity"] > self.max_action_sensitivity:
            raise CollapseError(
                f"The predictor collapsed to copying: the cosine between its predictions under the extreme commands is "
                f"{metrics['action_sensitivity']:.5f}; raise inverse_weight or the sampling interval."
            )
