"""New controllers around what is being trained, sized by the data set's spec."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from tsjepa.data.storage import spec_of
from tsjepa.models import Actor, Decoder, SemanticController, StateProbe
from tsjepa.support.seeds import derive, run_seed


def new_controller(
    encoder: nn.Module,
    predictor: nn.Module | None,
    metadata: dict,
    frame_spacing: int,
    hidden_dims: Sequence[int] = (1024, 256),
    dropout: float = 0.0,
    set_points: bool = False,
) -> SemanticController:
    """A controller whose actor, probe and decoder are drawn anew, alike for the same seed.

    Args:
        encoder, predictor: its trained parts.
        metadata: of the data set.
        frame_spacing: slots between the frames of a stack.
        hidden_dims, dropout: of the actor.
        set_points: whether the actor is given the plant's set-points beside the embedding.

    Raises:
        ValueError: encoder or predictor have other sizes than the data, or the plant has no set-points.
    """
    spec = spec_of(metadata)
    check_sizes(encoder, predictor, spec)
    if set_points and not spec.reference_dim:
        raise ValueError("set_points is true, but the plant of this data set has none: leave it out.")
    reference = (spec.reference_low, spec.reference_high) if set_points else ((), ())
    dim = encoder.embedding_dim
    with torch.random.fork_rng([]):
        torch.manual_seed(derive(run_seed(), "controller"))
        actor = Actor(spec.action_low, spec.action_high, dim, hidden_dims, dropout, *reference)
        probe = StateProbe(spec.state_dim, dim) if spec.state_dim else None
        decoder = Decoder(dim, height=spec.frame[0], width=spec.frame[1])
    model = SemanticController(encoder, actor, frame_spacing, spec, predictor, probe, decoder)
    model.plant = metadata.get("plant")
    return model


def train_only(module: nn.Module, *parts: nn.Module) -> None:
    """Leaves only the parameters of ``parts`` a gradient; data parallelism waits for that of every one that may."""
    module.requires_grad_(False)
    for part in parts:
        part.requires_grad_()


def check_sizes(encoder: nn.Module, predictor: nn.Module | None, spec) -> None:
    """Refuses parts that do not fit the data.

    Raises:
        ValueError: naming both sizes.
    """
    frame = tuple(encoder.frame_shape[1:3])
    if frame != tuple(spec.frame):
        raise ValueError(
            f"The encoder takes frames of {frame[0]} x {frame[1]} and the data set has {spec.frame[0]} x "
            f"{spec.frame[1]}: set the encoder's height and width."
        )
    if predictor is not None and predictor.action_dim != spec.action_dim:
        raise ValueError(
            f"The predictor takes commands of {predictor.action_dim} numbers and the data set has {spec.action_dim}: "
            f"set its action_dim."
        )
