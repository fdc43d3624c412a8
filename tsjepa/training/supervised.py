"""The supervised baseline: frames to commands, end to end, from the expert's labels (paper, baseline 2)."""

from __future__ import annotations

import lightning
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from tsjepa.data.augmentation import Augmentation
from tsjepa.models import SemanticController
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.controllers import new_controller, train_only
from tsjepa.training.embeddings import commands_to_imitate, embed_patches, embed_split
from tsjepa.training.pretrained import start_from
from tsjepa.training.schedule import warmup_cosine_schedule
from tsjepa.training.statistics import command_nmae, squared_command_error


class Supervised(lightning.LightningModule):
    """The encoder and the actor of TS-JEPA trained together on the expert's commands; it has no predictor.

    Args:
        encoder: with kappa of 2 or 4.
        augmentation: as for TS-JEPA.
        hidden_dims, dropout: of the actor.
        learning_rate: peak of AdamW; warm-up and cosine decay as in TS-JEPA.
        weight_decay: of AdamW.
        pretrained: zoo entry (name or folder) whose encoder to start from, as far as sizes agree.
    """

    def __init__(
        self,
        encoder: nn.Module,
        augmentation: Augmentation,
        hidden_dims: tuple[int, int] = (1024, 256),
        dropout: float = 0.0,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-2,
        pretrained: str | None = None,
    ) -> None:
        super().__init__()
        if pretrained is not None:
            start_from(pretrained, encoder=encoder)
        self.encoder, self.augmentation = encoder, augmentation
        self.hidden_dims, self.dropout = hidden_dims, dropout
        self.learning_rate, self.weight_decay = learning_rate, weight_decay
        self.model: SemanticController | None = None

    def setup(self, stage: str) -> None:
        data = self.trainer.datamodule
        if self.model is None:
            self.model = new_controller(
                self.encoder, None, data.metadata, data.frame_spacing, self.hidden_dims, self.dropout
            )
            train_only(self.model, self.encoder, self.model.actor)

    def training_step(self, batch: TensorDictBase, batch_index: int) -> Tensor:
        generator = torch.Generator().manual_seed(derive(run_seed(), "augmentation", self.global_step))
        mix = getattr(self.encoder, "color_mix", None)
        patches = self.augmentation(batch["patches"].flatten(0, 1), generator, mix=mix)
        embedding = embed_patches(self.encoder, patches)
        command = self.model.actor.unclipped(embedding)
        loss = squared_command_error(command, batch["expert_action"].flatten(0, 1), self.model.spec)
        self.log("loss", loss, prog_bar=True)
        return loss

    def nmae(self, split: TensorDictBase) -> Tensor:
        """Mean command error over the actuator's range on a split [episodes, T + 1]."""
        embedded = embed_split(self.encoder, split, self.trainer.datamodule.frame_spacing)
        return command_nmae(self.model.act(embedded["embedding"]), commands_to_imitate(embedded), self.model.spec)

    def validation_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log("val/command_nmae", self.nmae(batch), prog_bar=True, batch_size=1)

    def test_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log("test/command_nmae", self.nmae(batch), batch_size=1)

    def predict_step(self, batch: TensorDictBase, batch_index: int) -> TensorDict:
        """The ``command`` for every stack of a split, beside embedding, state and the expert's command."""
        embedded = embed_split(self.encoder, batch, self.trainer.datamodule.frame_spacing)
        return embedded.set("command", self.model.act(embedded["embedding"]))

    def controller(self) -> SemanticController:
        """Encoder and actor as a controller without a predictor; it holds its last command between updates."""
        return self.model

    def configure_optimizers(self):
        parameters = [*self.encoder.parameters(), *self.model.actor.parameters()]
        optimizer = torch.optim.AdamW(parameters, self.learning_rate, weight_decay=self.weight_decay)
        total = self.trainer.estimated_stepping_batches
        schedule = warmup_cosine_schedule(optimizer, total)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
