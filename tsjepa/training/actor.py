"""The semantic actor, imitating on frozen embeddings, received and predicted (paper eq. eq_opt_problem_2)."""

from __future__ import annotations

from collections.abc import Sequence

import lightning
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from tsjepa.envs.make import check_fit
from tsjepa.models import SemanticController, entries
from tsjepa.plants import Plant, build_plant, describe_plant
from tsjepa.support.parallel import rank_and_world_size
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.controllers import new_controller, train_only
from tsjepa.training.embeddings import commands_to_imitate
from tsjepa.training.schedule import adamw, warmup_cosine_schedule
from tsjepa.training.statistics import command_nmae, squared_command_error


@torch.no_grad()
def imitation_pairs(model: SemanticController, data: TensorDictBase, horizons: Sequence[int]) -> TensorDict:
    """Embeddings with true state and expert's command, received (horizon 0) and predicted that many slots ahead.

    An actor that is not trained on predicted ones meets them first in the loop.

    Args:
        model: source of the predictor.
        data: [episodes, slots] with ``embedding``, ``action``, and what there is of ``expert_action``, ``state``,
            ``reference``.
        horizons: in slots; one listed twice counts twice.

    Returns:
        [pairs] with ``embedding`` and the truth at its slot.

    Raises:
        ValueError: a horizon is as long as the trajectories, or above 0 where the model has no predictor.
    """
    slots = data.batch_size[1]
    if max(horizons) and model.predictor is None:
        raise ValueError(
            f"A horizon of {max(horizons)} slots needs a predictor, which the model has not: take horizons of 0 alone."
        )
    if max(horizons) >= slots:
        raise ValueError(
            f"A horizon of {max(horizons)} slots does not fit into trajectories of {slots}; take a shorter one."
        )
    parts, predicted = [], data["embedding"]
    for ahead in range(max(horizons) + 1):
        if ahead:
            predicted = model.predictor(predicted[:, : slots - ahead], data["action"][:, ahead - 1 : slots - 1])
        truth = data.exclude("embedding")[:, ahead:]
        pairs = TensorDict({"embedding": predicted, **truth}, batch_size=truth.batch_size).flatten(0, 1)
        parts += [pairs] * list(horizons).count(ahead)
    return torch.cat(parts)


class SemanticActor(lightning.LightningModule):
    """Fits the actor to the expert's command, or to the recorded one; encoder and predictor stay frozen.

    Args:
        pretrained: zoo entry (name or folder) whose encoder and predictor are used; its other parts are replaced.
        hidden_dims: widths of the actor's hidden layers.
        dropout: of the actor.
        learning_rate: peak; warm-up and cosine decay as in TS-JEPA.
        weight_decay: of AdamW.
        set_points: give the actor the plant's set-points beside the embedding. Every step draws new ones for the
            recorded states, and the plant's expert says what to do.
        plant: what the controller is for, whose first expert is imitated, where that is not the plant of
            ``pretrained``; the data set has to be of the same expert.

    Raises:
        ValueError: the plant has other frames, slots or commands than ``pretrained``.
    """

    def __init__(
        self,
        pretrained: str,
        hidden_dims: tuple[int, int] = (1024, 256),
        dropout: float = 0.2,
        learning_rate: float = 6e-3,
        weight_decay: float = 1e-4,
        set_points: bool = False,
        plant: Plant | None = None,
    ) -> None:
        super().__init__()
        self.learning_rate, self.weight_decay = learning_rate, weight_decay
        frozen = entries.load(pretrained)
        metadata = {"spec": frozen.spec.to_dict(), "plant": frozen.plant}
        self.model = new_controller(
            frozen.encoder,
            getattr(frozen, "predictor", None),
            metadata,
            frozen.frame_spacing,
            hidden_dims,
            dropout,
            set_points,
        )
        self.model.observer = getattr(frozen, "observer", None)
        train_only(self.model, self.model.actor)
        if plant is not None:
            check_fit(self.model, plant)
            self.model.plant = describe_plant(plant)
        self.set_points = set_points

    def setup(self, stage: str) -> None:
        if self.set_points:
            self.plant = build_plant(self.model.plant)
            self.expert = (next(iter(self.plant.experts().values())),)  # a tuple: no part of the checkpoint

    def train(self, mode: bool = True) -> SemanticActor:
        super().train(mode)
        self.model.encoder.eval()
        return self

    def controller(self) -> SemanticController:
        """The complete controller."""
        return self.model

    def training_step(self, batch: TensorDictBase, batch_index: int) -> Tensor:
        reference, wanted = self.task(batch)
        on_gpu = self.device.type == "cuda"
        # torch's dropout knows only the global stream; seeded by step, a resumed run repeats the interrupted one. Only
        # the stream of this device: torch.manual_seed seeds all, and without a GPU it formats a stack trace for later.
        # Commands are wanted finer than bfloat16 has them, and the actor is small: float32 whatever the trainer does.
        with torch.random.fork_rng([self.device] if on_gpu else []), torch.autocast(self.device.type, enabled=False):
            stream = torch.cuda.default_generators[self.device.index] if on_gpu else torch.default_generator
            stream.manual_seed(self.stream("dropout"))
            command = self.model.actor.unclipped(batch["embedding"], reference)
        imitation = squared_command_error(command, wanted, self.model.spec)
        self.log_terms(imitation)
        return imitation

    def log_terms(self, imitation: Tensor) -> None:
        """Logs the steps that the logger takes and an epoch's last: Lightning's accounts of all cost a tenth of it."""
        every = self.trainer.log_every_n_steps
        if self.trainer.is_last_batch or (every and (self.global_step + 1) % every == 0):
            self.log("imitation_loss", imitation, prog_bar=True)

    def stream(self, purpose: str) -> int:
        """Seed of a stream of this step and process."""
        return derive(run_seed(), purpose, self.global_step, rank_and_world_size()[0])

    def task(self, batch: TensorDictBase) -> tuple[Tensor | None, Tensor]:
        """Set-points [N, r], drawn anew, and the expert's commands [N, m] for them; else the recorded commands."""
        if not self.set_points:
            return None, commands_to_imitate(batch)
        generator = torch.Generator().manual_seed(self.stream("set-points"))
        reference = self.plant.goals(len(batch), 1, generator)[:, 0].to(batch["state"])
        return reference, self.expert[0].to(self.device)(batch["state"], reference)

    def validation_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log_errors("val", batch)

    def test_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log_errors("test", batch)

    def log_errors(self, stage: str, batch: TensorDictBase) -> None:
        """Logs the mean command error over the actuator's range on rows of embeddings, at the data's own set-points."""
        command = self.model.act(batch["embedding"], batch.get("reference", None))
        error = command_nmae(command, commands_to_imitate(batch), self.model.spec)
        self.log(f"{stage}/command_nmae", error, prog_bar=True)

    def predict_step(self, batch: TensorDictBase, batch_index: int) -> TensorDict:
        """The actor's ``command`` beside the rows it was made from."""
        command = self.model.act(batch["embedding"], batch.get("reference", None))
        return batch.clone(recurse=False).set("command", command)

    def configure_optimizers(self):
        optimizer = adamw(self.model.actor.parameters(), self.learning_rate, self.weight_decay)
        total = self.trainer.estimated_stepping_batches
        schedule = warmup_cosine_schedule(optimizer, total)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
