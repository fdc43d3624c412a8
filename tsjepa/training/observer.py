"""An observer for a trained controller: from frozen embeddings, on what is seen later."""

from __future__ import annotations

import lightning
import torch
from tensordict import TensorDictBase
from torch import Tensor

from tsjepa.models import HierarchicalPredictor, Observer, SemanticController, entries, rollout
from tsjepa.training.controllers import train_only
from tsjepa.training.losses import cosine_loss
from tsjepa.training.schedule import adamw, warmup_cosine_schedule


def watched_loss(model: SemanticController, watched: TensorDictBase, starts: TensorDictBase) -> Tensor:
    """The cosine loss of roll-outs from beliefs and from plain embeddings, over as many slots.

    Args:
        model: whose observer and predictor are trained.
        watched: [N, W + K] with ``action`` and one more ``embedding`` than that: watched for W slots, then predicted.
        starts: [n, K] likewise, predicted from the first embedding.
    """
    horizon = starts["action"].shape[1]
    before = watched["action"].shape[1] - horizon
    seen, commands = watched["embedding"][:, : before + 1], watched["action"][:, :before]
    first = torch.cat((model.belief_after(seen, commands).float(), starts["embedding"][:, 0]))
    commands = torch.cat((watched["action"][:, before:], starts["action"]))
    later = torch.cat((watched["embedding"][:, before + 1 :], starts["embedding"][:, 1:]))
    return cosine_loss(rollout(model.predictor, first, commands), later)


class FitObserver(lightning.LightningModule):
    """Trains a new observer together with the controller's predictor; encoder, actor and probe stay.

    A device that has watched for some slots holds a belief. The loss is the cosine loss between what the predictor
    makes of that belief and the embeddings that are seen afterwards, so it needs no states: of two beliefs the better
    one tells more of what comes. Roll-outs from plain embeddings, of the starts, keep the predictor good for a device
    that is seen for the first time.

    Args:
        pretrained: zoo entry (name or folder) of a controller with a predictor. An observer that it has is replaced.
        learning_rate: peak; warm-up and cosine decay as in TS-JEPA.
        weight_decay: of AdamW, on the predictor's weights only: towards no correction the gain must not be drawn.
        hidden_dim, memory: of the :class:`tsjepa.models.Observer`.

    Raises:
        ValueError: a controller without a predictor or an actor, or with a predictor of several strides.
    """

    def __init__(
        self,
        pretrained: str,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-4,
        hidden_dim: int | None = None,
        memory: bool = True,
    ) -> None:
        super().__init__()
        self.learning_rate, self.weight_decay = learning_rate, weight_decay
        model = entries.load(pretrained)
        predictor = getattr(model, "predictor", None)
        if not isinstance(model, SemanticController) or predictor is None:
            raise ValueError(f"{pretrained!r} has no predictor, which an observer corrects: take a TS-JEPA.")
        if isinstance(predictor, HierarchicalPredictor):
            raise ValueError(f"The predictor of {pretrained!r} has several strides: take one of single slots.")
        model.check_acts()
        model.observer = Observer(
            model.embedding_dim, hidden_dim=hidden_dim, memory=memory, action_dim=model.spec.action_dim
        )
        if hidden_dim is not None:
            model.observer.command_mean.copy_(predictor.command_mean)
            model.observer.command_std.copy_(predictor.command_std)
        model.metrics, model.card = None, ""
        self.model = model
        train_only(model, model.observer, predictor)

    def train(self, mode: bool = True) -> FitObserver:
        super().train(mode)
        self.model.encoder.eval()
        return self

    def controller(self) -> SemanticController:
        """The complete controller."""
        return self.model

    def training_step(self, batch: dict[str, TensorDictBase], batch_index: int) -> Tensor:
        loss = watched_loss(self.model, batch["watched"], batch["starts"])
        if (self.global_step + 1) % (self.trainer.log_every_n_steps or 1) == 0:
            self.log("prediction_loss", loss, prog_bar=True)
        return loss

    def validation_step(self, batch: TensorDictBase, batch_index: int) -> None:
        """Logs how far predictions are off, from beliefs and from embeddings, after a third of the trajectory."""
        slots = batch.shape[1] // 3
        ahead = min(20, batch.shape[1] - 1 - slots)
        seen, later = batch["embedding"][:, : slots + ahead + 1].split((slots + 1, ahead), 1)
        commands = batch["action"][:, slots : slots + ahead]
        belief = self.model.belief_after(seen, batch["action"][:, :slots]).float()
        for name, start in (("belief", belief), ("embedding", seen[:, -1])):
            loss = cosine_loss(rollout(self.model.predictor, start, commands), later)
            self.log(f"val/prediction_loss_from_{name}", loss, prog_bar=True)

    def configure_optimizers(self):
        optimizer = adamw(self.model.predictor.parameters(), self.learning_rate, self.weight_decay)
        optimizer.add_param_group({"params": list(self.model.observer.parameters()), "weight_decay": 0.0})
        schedule = warmup_cosine_schedule(optimizer, self.trainer.estimated_stepping_batches)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
