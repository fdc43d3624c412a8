"""Controllers small enough for a test, with no two tensors alike."""

import torch

from tsjepa.models import (
    Actor,
    AutoencoderController,
    Controller,
    Decoder,
    Encoder,
    Predictor,
    SemanticController,
    StateEstimator,
    StateProbe,
)
from tsjepa.plants import CartPole
from tsjepa.plants.lqr import ClippedLQR

DIM, WIDTHS, FRAME = 8, (4, 8, 8), (64, 128)


def tiny(
    seed: int = 0, sampling_interval: float = 0.02, frame_stack: int = 2, frame_spacing: int = 1, set_points: int = 0
) -> SemanticController:
    """Random weights and statistics; the decoder is taken for trained.

    Args:
        seed: of the weights.
        sampling_interval: seconds.
        frame_stack: kappa.
        frame_spacing: slots between frames.
        set_points: r, what its actor takes beside the embedding.
    """
    spec = CartPole(sampling_interval).spec
    encoder = Encoder(frame_stack, WIDTHS, DIM, *FRAME)
    reference = {"reference_low": spec.reference_low[:set_points], "reference_high": spec.reference_high[:set_points]}
    actor = Actor(spec.action_low, spec.action_high, DIM, hidden_dims=(16, 8), dropout=0.0, **reference)
    parts = {
        "predictor": Predictor(DIM, hidden_dim=16, residual=False),
        "probe": StateProbe(spec.state_dim, DIM, hidden_dim=16),
        "decoder": Decoder(DIM, 1, (8, 4, 4, 4), *FRAME),
    }
    return drawn(SemanticController(encoder, actor, frame_spacing, spec, **parts), seed)


def tiny_supervised(seed: int = 0, frame_stack: int = 2) -> SemanticController:
    """The same without a predictor."""
    model = tiny(seed, frame_stack=frame_stack)
    model.predictor = None
    return model


def tiny_autoencoder(seed: int = 0) -> AutoencoderController:
    """The same of the generative baseline."""
    spec = CartPole(0.02).spec
    decoder, estimator = Decoder(DIM, 2, (8, 4, 4, 4), *FRAME), StateEstimator(spec.state_dim, 2, WIDTHS, *FRAME)
    law = ClippedLQR(torch.ones(1, spec.state_dim), 0.5, spec.action_low, spec.action_high)
    return drawn(AutoencoderController(Encoder(2, WIDTHS, DIM, *FRAME), decoder, estimator, law, 1, spec), seed)


def drawn(model: Controller, seed: int) -> Controller:
    """The model with every tensor drawn anew, so that signals neither die nor blow up, and its decoder trained."""
    torch.manual_seed(seed)
    with torch.no_grad():
        for tensor in model.state_dict().values():
            if tensor.is_floating_point() and tensor.ndim > 1:
                tensor.uniform_(-1, 1).div_(tensor[0].numel() ** 0.5)
            elif tensor.is_floating_point():
                tensor.uniform_(-0.5, 1.5).abs_()
        model.decoder.fitted.fill_(True)
        # ranges in which a coordinate of a unit vector lies
        model.code_high.copy_(model.code_high.abs() + 0.5)
        model.code_low.copy_(-model.code_high)
    model.plant = {"class_path": "tsjepa.plants.CartPole", "init_args": {"sampling_interval": model.spec.slot}}
    return model.eval()


def frames(seed: int = 0, count: int = 3) -> torch.Tensor:
    """Noise of the encoder's shape, uint8 [count, 2, 64, 128, 3]."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (count, 2, *FRAME, 3), dtype=torch.uint8, generator=generator)
