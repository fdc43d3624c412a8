"""The generative baseline: encoder and decoder on reconstruction alone, then a state estimator on what they make."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext

import lightning
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from tsjepa.data.frames import Frames
from tsjepa.models import Encoder
from tsjepa.models.autoencoder import AutoencoderController, StateEstimator
from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import patchify
from tsjepa.plants import build_plant
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.controllers import train_only
from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.callback import Finish
from tsjepa.training.finish.decoder import fit_background, reconstruction_loss
from tsjepa.training.finish.minimize import ForwardContext, minimize
from tsjepa.training.schedule import warmup_cosine_schedule
from tsjepa.training.statistics import mean_and_std


class Autoencoder(lightning.LightningModule):
    """Trains encoder and decoder to give back every stack of frames, pixel by pixel and without augmentation.

    The estimator is trained when the fit ends, by :class:`FitEstimator`.

    Args:
        encoder: of the same class and size as TS-JEPA's.
        decoder: of as many frames as the encoder takes.
        learning_rate: peak of AdamW; warm-up and cosine decay as in TS-JEPA.
        weight_decay: of AdamW.
        contrast_floor: least unit of a pixel's error, of 255; see :func:`fit_background`.
        motion_weight: of the error in what moves between the frames (see :func:`reconstruction_loss`) at the end; it
            rises from 0 with the steps, because motion can only be drawn where it is known what stands there.
        estimator_channels: see :class:`StateEstimator`.

    Raises:
        ValueError: encoder and decoder do not fit together.
    """

    def __init__(
        self,
        encoder: Encoder,
        decoder: Decoder,
        learning_rate: float = 2e-3,
        weight_decay: float = 1e-4,
        contrast_floor: float = 10.0,
        motion_weight: float = 40.0,
        estimator_channels: tuple[int, int, int] = (32, 64, 64),
    ) -> None:
        super().__init__()
        sizes = (encoder.embedding_dim, encoder.frame_shape[0])
        if sizes != (decoder.embedding_dim, decoder.frame_stack):
            raise ValueError(
                f"The encoder has (embedding_dim, frame_stack) = {sizes}, the decoder "
                f"{(decoder.embedding_dim, decoder.frame_stack)}; give them the same."
            )
        self.learning_rate, self.weight_decay = learning_rate, weight_decay
        self.contrast_floor, self.motion_weight = contrast_floor, motion_weight
        self.encoder, self.decoder, self.estimator_channels = encoder, decoder, estimator_channels
        self.model: AutoencoderController | None = None

    def setup(self, stage: str) -> None:
        if self.model is not None:
            return
        data, stack = self.trainer.datamodule, self.encoder.frame_shape[0]
        if not data.metadata.get("plant"):
            raise ValueError(
                "An autoencoder's controller applies a plant's expert to the state that it estimates, and this data "
                "set is of no plant: train TS-JEPA or the supervised controller on recordings."
            )
        with torch.random.fork_rng([]):
            torch.manual_seed(derive(run_seed(), "controller"))
            estimator = StateEstimator(data.spec.state_dim, stack, self.estimator_channels, *data.spec.frame)
        law = next(iter(build_plant(data.metadata["plant"]).experts().values()))
        self.model = AutoencoderController(self.encoder, self.decoder, estimator, law, data.frame_spacing, data.spec)
        self.model.plant = data.metadata["plant"]
        train_only(self.model, self.encoder, self.decoder)

    def on_fit_start(self) -> None:
        fit_background(self.model.decoder, Frames([self.trainer.datamodule.split("train")]), self.contrast_floor)

    def reconstruction(self, patches: Tensor, motion_weight: float = 0.0) -> Tensor:
        """Loss on stacks as uint8 patches [N, H / 4, W / 4, 48 * frame_stack]."""
        encoder, decoder = self.model.encoder, self.model.decoder
        device = patches.device.type
        dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else torch.float32
        patches, scale, shift = patches.to(dtype), encoder.pixel_scale.to(dtype), encoder.pixel_shift.to(dtype)
        embedding = encoder.embed(torch.addcmul(shift, patches, scale))
        return reconstruction_loss(decoder, decoder.draw(embedding), patches, motion_weight)

    def training_step(self, batch: TensorDictBase, batch_index: int) -> Tensor:
        done = self.global_step / self.trainer.estimated_stepping_batches
        loss = self.reconstruction(batch["patches"].flatten(0, 1), done * self.motion_weight)
        self.log("loss", loss, prog_bar=True)
        return loss

    def validation_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log_reconstruction("val", batch)

    def test_step(self, batch: TensorDictBase, batch_index: int) -> None:
        self.log_reconstruction("test", batch)

    def log_reconstruction(self, stage: str, split: TensorDictBase) -> None:
        """Logs the error of the frames of a split [episodes, T + 1], every fifth slot of it."""
        data = self.trainer.datamodule
        pixels, (episodes, frames) = Frames([split]), split.batch_size
        offsets = data.frame_spacing * torch.arange(1 - data.frame_stack, 1)
        stacks = torch.arange(data.first_slot, frames, 5)[:, None] + offsets
        losses = [
            self.reconstruction(patchify(pixels[episode * frames + stacks].to(self.device)))
            for episode in range(episodes)
        ]
        self.log(f"{stage}/reconstruction", torch.stack(losses).float().mean(), prog_bar=True, batch_size=1)

    def predict_step(self, batch: TensorDictBase, batch_index: int) -> TensorDict:
        """Embeddings of a split, with the state and the commands beside them."""
        return embed_split(self.model.encoder, batch, self.trainer.datamodule.frame_spacing)

    def controller(self) -> AutoencoderController:
        """The complete controller, whose estimator callbacks train when the fit ends."""
        return self.model

    def configure_optimizers(self):
        parameters = [*self.model.encoder.parameters(), *self.model.decoder.parameters()]
        optimizer = torch.optim.AdamW(parameters, self.learning_rate, weight_decay=self.weight_decay)
        schedule = warmup_cosine_schedule(optimizer, self.trainer.estimated_stepping_batches)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def fit_estimator(
    model: AutoencoderController,
    embedding: Tensor,
    state: Tensor,
    steps: int,
    batch_size: int = 256,
    learning_rate: float = 3e-3,
    weight_decay: float = 1e-2,
    seed: int = 0,
    forward_context: ForwardContext = nullcontext,
) -> None:
    """Trains the state estimator in place, each component of the state over its standard deviation.

    It only ever sees what the frozen decoder draws, so that it learns to read reconstructions with all their faults.

    Args:
        model: of which only the estimator changes; left in evaluation mode.
        embedding: [N, d].
        state: [N, n].
        steps, batch_size, learning_rate, weight_decay: of AdamW with warm-up and cosine decay.
        seed: seed of the batches.
        forward_context: the precision of decoder and estimator.
    """
    estimator, device = model.estimator, embedding.device
    mean, std = mean_and_std(state)
    estimator.state_mean.copy_(mean)
    estimator.state_std.copy_(std)
    generator = torch.Generator().manual_seed(seed)

    def loss() -> Tensor:
        rows = torch.randint(len(embedding), (batch_size,), generator=generator).to(device)
        with forward_context():
            with torch.no_grad():
                drawn = model.decoder.draw(embedding[rows])
            estimated = estimator(drawn)
        return ((estimated - state[rows]) / estimator.state_std).square().mean()

    model.eval()
    estimator.train()
    minimize(loss, estimator.parameters(), steps, learning_rate, weight_decay, "fit estimator")
    estimator.eval()


class FitEstimator(Finish):
    """Runs :func:`fit_estimator` when the fit ends. List it before the export.

    Args:
        steps: optimizer steps.
        batch_size, learning_rate, weight_decay: see :func:`fit_estimator`.
        splits: of the data set. The autoencoder has not seen ``actor_train``, so that it errs there as it will in use.
    """

    def __init__(
        self,
        steps: int = 2000,
        batch_size: int = 256,
        learning_rate: float = 3e-3,
        weight_decay: float = 1e-2,
        splits: Sequence[str] = ("train", "actor_train"),
    ) -> None:
        self.steps, self.batch_size, self.splits = steps, batch_size, tuple(splits)
        self.learning_rate, self.weight_decay = learning_rate, weight_decay

    def finish(self, trainer: lightning.Trainer, module: Autoencoder) -> None:
        model, data = module.controller(), trainer.datamodule
        splits = [embed_split(model.encoder, data.split(name), data.frame_spacing) for name in self.splits]
        rows = torch.cat([split.flatten(0, 1) for split in splits])
        fit_estimator(
            model,
            rows["embedding"],
            rows["state"],
            self.steps,
            self.batch_size,
            self.learning_rate,
            self.weight_decay,
            derive(run_seed(), "estimator"),
            trainer.precision_plugin.forward_context,
        )
