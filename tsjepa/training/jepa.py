"""TS-JEPA: context encoder, EMA target encoder and predictor trained together (paper, algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence

import lightning
import torch
from lightning.pytorch.cli import LRSchedulerCallable, OptimizerCallable
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from tsjepa.data.augmentation import Augmentation
from tsjepa.models import HierarchicalPredictor, Predictor, SemanticController
from tsjepa.models.checks import check_encoder
from tsjepa.support.checks import within
from tsjepa.support.parallel import gather
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.controllers import new_controller
from tsjepa.training.embeddings import embed_patches, embed_split
from tsjepa.training.losses import InverseDynamics, LossTerm, cosine_loss, covariance_loss, variance_loss
from tsjepa.training.pretrained import start_from
from tsjepa.training.schedule import warmup_cosine_schedule
from tsjepa.training.statistics import mean_and_std


class TSJEPA(lightning.LightningModule):
    """Predicts the target encoder's embeddings of later frames from one embedding and the commands in between.

    Each frame of a window is encoded once by the context encoder and once by the target encoder, and serves as context
    for every later frame and as target for every earlier one.

    Args:
        encoder: the context encoder, any module from frames uint8 [N, frame_stack, H, W, 3] to embeddings [N, d] with
            ``frame_shape`` (frame_stack, H, W, 3) and ``embedding_dim``.
        predictor: one step of embedding dynamics; of one with several strides the smallest, which is one slot.
        augmentation: applied to every window with its own draw.
        optimizer: from parameters to optimizer.
        scheduler: from optimizer to a schedule that steps once an epoch; None for linear warm-up over the first 5 % of
            all steps and cosine decay to zero.
        ema_decay: eta of the paper's eq. eq_weights_update.
        variance_weight: weight of the variance term (0 in the paper).
        covariance_weight: weight of the covariance term (0 in the paper).
        inverse_weight: weight of the inverse-dynamics term (0 in the paper).
        view_weight: weight of the distance between a stack's embedding and its target, where the target is the same
            stack in another appearance. The prediction alone does not ask for it: a predictor may leave out what an
            embedding holds of appearance.
        pretrained: zoo entry (name or folder) to start from, as far as sizes agree.
        terms: of one's own, added to the loss.

    Raises:
        ValueError: the encoder is none, see :func:`tsjepa.models.checks.check_encoder`, or does not fit the predictor.
    """

    def __init__(
        self,
        encoder: nn.Module,
        predictor: Predictor | HierarchicalPredictor,
        augmentation: Augmentation,
        optimizer: OptimizerCallable = torch.optim.AdamW,
        scheduler: LRSchedulerCallable | None = None,
        ema_decay: float = 0.99,
        variance_weight: float = 0.1,
        covariance_weight: float = 0.01,
        inverse_weight: float = 1.0,
        view_weight: float = 1.0,
        pretrained: str | None = None,
        terms: Sequence[LossTerm] = (),
    ) -> None:
        super().__init__()
        within(0, 1, ema_decay=ema_decay)
        check_encoder(encoder)
        if predictor.embedding_dim != encoder.embedding_dim:
            raise ValueError(
                f"The encoder's embedding_dim is {encoder.embedding_dim}, the predictor's is "
                f"{predictor.embedding_dim}: make them equal."
            )
        if pretrained is not None:
            start_from(pretrained, encoder=encoder, predictor=predictor)
        if isinstance(predictor, HierarchicalPredictor):
            # larger strides learn on frozen embeddings, and data parallelism waits for every gradient that there may be
            predictor.levels[1:].requires_grad_(False)
        self.encoder, self.predictor, self.augmentation = encoder, predictor, augmentation
        self.target_encoder = AveragedModel(encoder, multi_avg_fn=get_ema_multi_avg_fn(ema_decay), use_buffers=True)
        self.target_encoder.requires_grad_(False)
        # only where the loss has it: data parallelism waits for the gradient of every parameter
        self.inverse_dynamics = InverseDynamics(encoder.embedding_dim, predictor.action_dim) if inverse_weight else None
        self.optimizer, self.scheduler = optimizer, scheduler
        self.variance_weight, self.covariance_weight = variance_weight, covariance_weight
        self.inverse_weight, self.view_weight, self.terms = inverse_weight, view_weight, tuple(terms)

    def train(self, mode: bool = True) -> TSJEPA:
        super().train(mode)
        self.target_encoder.eval()
        return self

    def setup(self, stage: str) -> None:
        data = self.trainer.datamodule
        controller = new_controller(self.encoder, self.predictor, data.metadata, data.frame_spacing)
        controller.actor = None  # one that nothing has trained would be taken for one that has learned
        # in a tuple, so that its other parts are no parameters of this module: neither optimized nor in checkpoints
        self.untrained = (controller,)

    def on_fit_start(self) -> None:
        data = self.trainer.datamodule
        if data.stacks < 2 or data.frame_stack != self.encoder.frame_shape[0]:
            raise ValueError(
                f"The data's windows have {data.stacks} stacks of {data.frame_stack} frames; TS-JEPA needs at least 2 "
                f"stacks, and its encoder takes {self.encoder.frame_shape[0]} frames."
            )
        mean, std = mean_and_std(data.split(data.splits[0])["action"][:, :-1].flatten(0, 1))
        self.predictor.command_mean.copy_(mean)
        self.predictor.command_std.copy_(std)

    def training_step(self, batch: TensorDictBase, batch_index: int) -> Tensor:
        commands = batch["commands"]
        windows, stacks = batch["patches"].shape[:2]
        generator = torch.Generator().manual_seed(derive(run_seed(), "augmentation", self.global_step))
        mix = getattr(self.encoder, "color_mix", None)
        patches = self.augmentation(batch["patches"].flatten(0, 1), generator, stacks, mix)
        other = batch.get("target_patches", None)
        seen = patches if other is None else self.augmentation(other.flatten(0, 1), generator, stacks, mix)
        embedding = embed_patches(self.encoder, patches).unflatten(0, (windows, stacks))
        with torch.no_grad():
            target = embed_patches(self.target_encoder.module, seen).unflatten(0, (windows, stacks))
        gap = commands.shape[1] // (stacks - 1)
        terms = {"prediction_loss": self.prediction_loss(embedding, target, commands, gap)}
        loss = terms["prediction_loss"]
        if other is not None:
            terms["view_loss"] = cosine_loss(embedding, target)
            loss = loss + self.view_weight * terms["view_loss"]
        flat = gather(embedding.flatten(0, 1))
        if self.variance_weight:
            terms["variance_loss"] = variance_loss(flat)
            loss = loss + self.variance_weight * terms["variance_loss"]
        if self.covariance_weight:
            terms["covariance_loss"] = covariance_loss(flat)
            loss = loss + self.covariance_weight * terms["covariance_loss"]
        if self.inverse_weight:
            terms["inverse_loss"] = self.inverse_loss(embedding, commands, gap)
            loss = loss + self.inverse_weight * terms["inverse_loss"]
        for term in self.terms:
            value = term(embedding, target, commands.unflatten(1, (stacks - 1, gap)))
            terms[getattr(term.function, "__name__", "own_term")] = value
            loss = loss + term.weight * value
        self.log_terms(terms, loss)
        return loss

    def log_terms(self, terms: dict[str, Tensor], loss: Tensor) -> None:
        """Logs the steps that the logger takes and an epoch's last: Lightning's accounts of all cost 1 % of a step."""
        every = self.trainer.log_every_n_steps
        if self.trainer.is_last_batch or (every and (self.global_step + 1) % every == 0):
            self.log_dict(terms)
            self.log("loss", loss, prog_bar=True)

    def prediction_loss(self, embedding: Tensor, target: Tensor, commands: Tensor, gap: int) -> Tensor:
        """Cosine loss of every roll-out from every stack of a window to every later one.

        Args:
            embedding, target: [B, W, d].
            commands: [B, gap * (W - 1), m].
            gap: slots between neighbouring stacks.
        """
        stacks = embedding.shape[1]
        commands = commands.unflatten(1, (stacks - 1, gap))
        losses, predicted = [], embedding
        for ahead in range(1, stacks):
            predicted = predicted[:, : stacks - ahead]
            for slot in range(gap):
                predicted = self.predictor(predicted, commands[:, ahead - 1 :, slot])
            losses.append(cosine_loss(predicted, target[:, ahead:]))
        return torch.stack(losses).mean()

    def inverse_loss(self, embedding: Tensor, commands: Tensor, gap: int) -> Tensor:
        """Squared error of the z-scored mean command between neighbouring stacks."""
        commands = (commands - self.predictor.command_mean) / self.predictor.command_std
        mean = commands.unflatten(1, (embedding.shape[1] - 1, gap)).mean(2)
        return (self.inverse_dynamics(embedding[:, :-1], embedding[:, 1:], gap) - mean).square().mean()

    def on_train_batch_end(self, outputs, batch: TensorDictBase, batch_index: int) -> None:
        self.target_encoder.update_parameters(self.encoder)

    def controller(self) -> SemanticController:
        """Encoder and predictor as a controller without an actor; probe and decoder are yet to be trained."""
        return self.untrained[0]

    def validation_step(self, batch: TensorDictBase, batch_index: int) -> None:
        """Nothing: metrics are the callback's (:class:`tsjepa.training.monitor.RepresentationMonitor`)."""

    test_step = validation_step

    def predict_step(self, batch: TensorDictBase, batch_index: int) -> TensorDict:
        """Embeddings of a split, with the state and the commands beside them."""
        return embed_split(self.encoder, batch, self.trainer.datamodule.frame_spacing)

    def configure_optimizers(self):
        parameters = [parameter for parameter in self.parameters() if parameter.requires_grad]
        optimizer = self.optimizer(parameters)
        if self.scheduler is not None:
            return {
                "optimizer": optimizer,
                "lr_scheduler": {"scheduler": self.scheduler(optimizer), "interval": "epoch"},
            }
        schedule = warmup_cosine_schedule(optimizer, self.trainer.estimated_stepping_batches)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
