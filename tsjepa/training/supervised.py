"""The supervised baseline: frames to commands, end to end, from the expert's labels (paper, baseline 2)."""

from __future__ import annotations

from dataclasses import replace

import lightning
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from tsjepa.data.augmentation import Augmentation
from tsjepa.models import Actor, Architecture, Encoder, SemanticController
from tsjepa.models.actor import COMMAND_LIMIT
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.embeddings import embed_split
from tsjepa.training.pretrained import start_from
from tsjepa.training.schedule import warmup_cosine_schedule


class Supervised(lightning.LightningModule):
    """The encoder and the actor of TS-JEPA trained together on the expert's commands; it has no predictor.

    Args:
        encoder: with kappa of 2 or 4.
        actor: on the encoder's embedding.
        augmentation: as for TS-JEPA.
        learning_rate: peak of AdamW; warm-up and cosine decay as in TS-JEPA.
        weight_decay: of AdamW.
        pretrained: zoo entry (name or folder) whose encoder to start from, as far as sizes agree.
    """

    def __init__(
        self,
        encoder: Encoder,
        actor: Actor,
        augmentation: Augmentation,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-2,
        pretrained: str | None = None,
    ) -> None:
        super().__init__()
        if pretrained is not None:
            start_from(pretrained, encoder=encoder)
        self.model = SemanticController(
            Architecture(
                frame_stack=encoder.frame_shape[0],
                widths=encoder.widths,
                embedding_dim=encoder.embedding_dim,
                actor_hidden_dims=actor.hidden_dims,
                has_predictor=False,
            )
        )
        self.model.encoder, self.model.actor, self.augmentation = encoder, actor, augmentation
        self.learning_rate, self.weight_decay = learning_rate, weight_decay

    def setup(self, stage: str) -> None:
        data = self.trainer.datamodule
        self.model.architecture = replace(
            self.model.architecture,
            frame_spacing=data.frame_spacing,
            sampling_interval=data.metadata["sampling_interval"],
        )

    def training_step(self, batch: TensorDictBase, batch_index: int) -> Tensor:
        generator = torch.Generator().manual_seed(derive(run_seed(), "augmentation", self.global_step))
        embedding = self.model.encoder.embed(self.augmentation(batch["patches"].flatten(0, 1), generator))
        error = self.model.actor.unclipped(embedding) - batch["expert_action"].flatten(0, 1)
        loss = (error / COMMAND_LIMIT).square().mean()
        self.log("loss", loss, prog_bar=True)
        return loss

    def nmae(self, split: TensorDictBase) -> Tensor:
        """Mean command error over 40 N on a split [episodes, T + 1]."""
        embedded = embed_split(self.model.encoder, split, self.trainer.datamodule.frame_spacing)
        return (self.model.act(embedded["embedding"]) - embedded["expert_action"]).abs().mean() / (2 * COMMAND_LIMIT)

    def validation_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log("val/command_nmae", self.nmae(batch), prog_bar=True, batch_size=1)

    def test_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log("test/command_nmae", self.nmae(batch), batch_size=1)

    def predict_step(self, batch: TensorDictBase, batch_index: int) -> TensorDict:
        """The ``command`` for every stack of a split, beside embedding, state and the expert's command."""
        embedded = embed_split(self.model.encoder, batch, self.trainer.datamodule.frame_spacing)
        return embedded.set("command", self.model.act(embedded["embedding"]))

    def controller(self) -> SemanticController:
        """Encoder and actor as a controller without a predictor; it holds its last command between updates."""
        return self.model

    def configure_optimizers(self):
        parameters = [*self.model.encoder.parameters(), *self.model.actor.parameters()]
        optimizer = torch.optim.AdamW(parameters, self.learning_rate, weight_decay=self.weight_decay)
        total = self.trainer.estimated_stepping_batches
        schedule = warmup_cosine_schedule(optimizer, total)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
