"""The semantic actor, imitating on frozen embeddings, received and predicted (paper eq. eq_opt_problem_2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import lightning
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from tsjepa.models import SemanticController, entries
from tsjepa.models.actor import COMMAND_LIMIT
from tsjepa.support.parallel import rank_and_world_size
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.schedule import warmup_cosine_schedule


@torch.no_grad()
def imitation_pairs(model: SemanticController, data: TensorDictBase, horizons: Sequence[int]) -> TensorDict:
    """Embeddings with true state and expert's command, received (horizon 0) and predicted that many slots ahead.

    An actor that is not trained on predicted ones meets them first in the loop.

    Args:
        model: source of the predictor.
        data: [episodes, slots] with ``embedding``, ``action``, ``expert_action``, ``state``.
        horizons: in slots; one listed twice counts twice.

    Returns:
        [pairs] with ``embedding``, ``expert_action``, ``state``.

    Raises:
        ValueError: a horizon is as long as the trajectories.
    """
    slots = data.batch_size[1]
    if max(horizons) >= slots:
        raise ValueError(
            f"A horizon of {max(horizons)} slots does not fit into trajectories of {slots}; take a shorter one."
        )
    parts, predicted = [], data["embedding"]
    for ahead in range(max(horizons) + 1):
        if ahead:
            predicted = model.predictor(predicted[:, : slots - ahead], data["action"][:, ahead - 1 : slots - 1])
        truth = data.select("expert_action", "state")[:, ahead:]
        pairs = TensorDict({"embedding": predicted, **truth}, batch_size=truth.batch_size).flatten(0, 1)
        parts += [pairs] * list(horizons).count(ahead)
    return torch.cat(parts)


class SemanticActor(lightning.LightningModule):
    """Fits the actor to the expert's command; encoder and predictor stay frozen.

    Args:
        pretrained: zoo entry (name or folder) whose encoder and predictor are used; its actor and probe are replaced.
        hidden_dims: widths of the actor's hidden layers.
        dropout: of the actor.
        learning_rate: peak; warm-up and cosine decay as in TS-JEPA.
        weight_decay: of AdamW.
    """

    def __init__(
        self,
        pretrained: str,
        hidden_dims: tuple[int, int] = (1024, 256),
        dropout: float = 0.2,
        learning_rate: float = 6e-3,
        weight_decay: float = 1e-4,
    ) -> None:
        super().__init__()
        self.learning_rate, self.weight_decay = learning_rate, weight_decay
        frozen = entries.load(pretrained)
        self.model = SemanticController(replace(frozen.architecture, actor_hidden_dims=tuple(hidden_dims)), dropout)
        self.model.encoder.load_state_dict(frozen.encoder.state_dict())
        self.model.predictor.load_state_dict(frozen.predictor.state_dict())
        self.model.encoder.requires_grad_(False)
        self.model.predictor.requires_grad_(False)

    def train(self, mode: bool = True) -> SemanticActor:
        super().train(mode)
        self.model.encoder.eval()
        return self

    def controller(self) -> SemanticController:
        """The complete controller."""
        return self.model

    def training_step(self, batch: TensorDictBase, batch_index: int) -> Tensor:
        devices = [self.device] if self.device.type == "cuda" else []
        # torch's dropout knows only the global stream; seeded by step, a resumed run repeats the interrupted one.
        # Commands are wanted finer than bfloat16 has them, and the actor is small: float32 whatever the trainer does.
        with torch.random.fork_rng(devices), torch.autocast(self.device.type, enabled=False):
            torch.manual_seed(derive(run_seed(), "dropout", self.global_step, rank_and_world_size()[0]))
            command = self.model.actor.unclipped(batch["embedding"])
        imitation = ((command - batch["expert_action"]) / COMMAND_LIMIT).square().mean()
        self.log("imitation_loss", imitation, prog_bar=True)
        return imitation

    def validation_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log_errors("val", batch)

    def test_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log_errors("test", batch)

    def log_errors(self, stage: str, batch: TensorDictBase) -> None:
        """Logs the mean command error over 40 N on rows of embeddings."""
        error = (self.model.act(batch["embedding"]) - batch["expert_action"]).abs().mean()
        self.log(f"{stage}/command_nmae", error / (2 * COMMAND_LIMIT), prog_bar=True)

    def predict_step(self, batch: TensorDictBase, batch_index: int) -> TensorDict:
        """The actor's ``command`` beside the rows it was made from."""
        return batch.clone(recurse=False).set("command", self.model.act(batch["embedding"]))

    def configure_optimizers(self):
        optimizer = torch.optim.AdamW(self.model.actor.parameters(), self.learning_rate, weight_decay=self.weight_decay)
        total = self.trainer.estimated_stepping_batches
        schedule = warmup_cosine_schedule(optimizer, total)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
