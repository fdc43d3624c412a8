"""The training loop that lightly's examples teach, around our networks; peers.py times it."""

import copy

import lightning
import torch
from lightly.loss import NegativeCosineSimilarity
from lightly.models.utils import deactivate_requires_grad, update_momentum
from torch import Tensor
from torch.utils.data import DataLoader, Dataset
from torchvision.transforms import v2

from tsjepa.models.encoder import PIXEL_MEAN, PIXEL_STD, patchify


class Windows(Dataset):
    """Windows of consecutive frames, each through the recipe's augmentation as torchvision has it.

    Args:
        split: [episodes, T + 1] with ``pixels`` and ``action``.
        stacks: of a window; it holds one frame more, for stacks of two neighbours.
        augmentation: ours, for its strengths.
    """

    def __init__(self, split, stacks: int, augmentation) -> None:
        self.pixels, self.action = torch.from_numpy(split["pixels"].numpy()), split["action"].clone()
        self.stacks, self.starts = stacks, split.batch_size[1] - stacks
        strengths = (augmentation.brightness, augmentation.contrast, augmentation.saturation, augmentation.hue)
        self.transform = v2.Compose(
            [
                v2.ColorJitter(*strengths),
                v2.RandomGrayscale(augmentation.grayscale),
                v2.ToDtype(torch.float32, scale=True),
                v2.Normalize(PIXEL_MEAN, PIXEL_STD),
            ]
        )

    def __len__(self) -> int:
        return len(self.pixels) * self.starts

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        """Frames [stacks + 1, 3, H, W] and the commands [stacks - 1, 1] between the stacks."""
        episode, start = divmod(index, self.starts)
        frames = self.pixels[episode, start : start + self.stacks + 1].movedim(-1, 1)
        return self.transform(frames), self.action[episode, start + 1 : start + self.stacks]


def loader(data, augmentation) -> DataLoader:
    """Batches of as many stacks as ours. No worker processes: they would go on while the other contender is timed."""
    windows = Windows(data.split("train"), data.stacks, augmentation)
    return DataLoader(windows, batch_size=data.frames_per_batch // data.stacks, shuffle=True, drop_last=True)


class MomentumLoop(lightning.LightningModule):
    """Predicts the momentum encoder's embedding of the next stack from the encoder's and the command.

    Args:
        module: ours, whose encoder, predictor and optimizer are used.
        momentum: of the momentum encoder.
    """

    def __init__(self, module, momentum: float = 0.99) -> None:
        super().__init__()
        self.backbone, self.predictor, self.optimizer = module.encoder, module.predictor, module.optimizer
        self.backbone_momentum = copy.deepcopy(module.encoder)
        deactivate_requires_grad(self.backbone_momentum)
        self.criterion, self.momentum = NegativeCosineSimilarity(), momentum

    def training_step(self, batch: tuple[Tensor, Tensor], batch_index: int) -> Tensor:
        update_momentum(self.backbone, self.backbone_momentum, m=self.momentum)
        frames, commands = batch
        frames = frames.movedim(2, -1)
        stacks = torch.stack((frames[:, :-1], frames[:, 1:]), dim=2)
        patches = patchify(stacks.flatten(0, 1))
        embedding = self.backbone.embed(patches).unflatten(0, stacks.shape[:2])
        with torch.no_grad():
            target = self.backbone_momentum.embed(patches).unflatten(0, stacks.shape[:2])
        predicted = self.predictor(embedding[:, :-1], commands)
        loss = self.criterion(predicted.flatten(0, 1), target[:, 1:].flatten(0, 1))
        self.log("loss", loss)
        return loss

    def configure_optimizers(self):
        return self.optimizer([parameter for parameter in self.parameters() if parameter.requires_grad])
