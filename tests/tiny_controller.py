"""Controllers small enough for a test of the zoo, with no two tensors alike."""

import torch

from tsjepa.models import Architecture, AutoencoderArchitecture, AutoencoderController, SemanticController


def tiny(seed: int = 0, sampling_interval: float = 0.01) -> SemanticController:
    """Random weights and statistics; the decoder is taken for trained."""
    architecture = Architecture(
        frame_spacing=1,
        widths=(4, 8, 8),
        embedding_dim=8,
        predictor_hidden_dim=16,
        predictor_residual=False,
        actor_hidden_dims=(16, 8),
        sampling_interval=sampling_interval,
    )
    return drawn(SemanticController(architecture), seed)


def tiny_supervised(seed: int = 0) -> SemanticController:
    """The same without a predictor."""
    architecture = Architecture(widths=(4, 8, 8), embedding_dim=8, actor_hidden_dims=(16, 8), has_predictor=False)
    return drawn(SemanticController(architecture), seed)


def tiny_autoencoder(seed: int = 0) -> AutoencoderController:
    """The same of the generative baseline."""
    architecture = AutoencoderArchitecture(
        widths=(4, 8, 8), embedding_dim=8, decoder_channels=(8, 4, 4, 4), estimator_channels=(4, 8, 8)
    )
    return drawn(AutoencoderController(architecture), seed)


def drawn(model, seed: int):
    """The model with every tensor drawn anew, so that signals neither die nor blow up, and its decoder trained."""
    torch.manual_seed(seed)
    with torch.no_grad():
        for tensor in model.state_dict().values():
            if tensor.is_floating_point() and tensor.ndim > 1:
                tensor.uniform_(-1, 1).div_(tensor[0].numel() ** 0.5)
            elif tensor.is_floating_point():
                tensor.uniform_(-0.5, 1.5).abs_()
        model.decoder.fitted.fill_(True)
    return model


def frames(seed: int = 0, count: int = 3) -> torch.Tensor:
    """Noise of the encoder's shape, uint8 [count, 2, 64, 128, 3]."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (count, 2, 64, 128, 3), dtype=torch.uint8, generator=generator)
