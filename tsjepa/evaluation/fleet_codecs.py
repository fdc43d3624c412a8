"""The codec of a fleet's updates, with its ranges, and the bits that a scheduler reserves for one."""

from __future__ import annotations

from dataclasses import replace

import torch
from tensordict import TensorDictBase
from torch import Tensor

from tsjepa.envs.expert import Expert
from tsjepa.evaluation.closed_loop import run
from tsjepa.evaluation.codec import UnitNorm, embedding_codec
from tsjepa.evaluation.fleet_settings import Plants, Radio
from tsjepa.models import SemanticController
from tsjepa.network.codecs import make_codec, payload_bits

FRAME_CODECS = ("raw", "png", "jpeg", "webp")
STATE_RANGE = (1.8, 0.8, 4.0, 4.0)  # m, rad, m/s, rad/s: what an integer codec of the true state covers
CALIBRATION_SEED = 10_000  # starts that no evaluation uses


def fitted_codec(name: str, plants: Plants, model: SemanticController | None) -> torch.nn.Module:
    """The codec of the update: of the true state, of the model's embedding, or of frames.

    Integer codecs get their ranges from the state space, from the model, or, where it came without, from embeddings
    along loops that the expert closes.
    """
    if name in FRAME_CODECS:
        if model is None:
            raise ValueError(f"The codec {name!r} sends frames, which need the encoder of a model as controller.")
        return make_codec(name, frame_stack=model.architecture.frame_stack)
    if model is None:
        codec = make_codec(name, dimension=4)
        return codec.fit(torch.tensor(STATE_RANGE) * torch.tensor([[-1.0], [1.0]])) if name[:3] == "int" else codec
    if name[:3] == "int" and bool(model.code_low.isnan().any()):
        codec = make_codec(name, dimension=model.architecture.embedding_dim)
        return UnitNorm(codec.fit(calibration_embeddings(plants, model)))
    return embedding_codec(name, model)


@torch.no_grad()
def calibration_embeddings(plants: Plants, model: SemanticController, count: int = 20) -> Tensor:
    """Embeddings [N, d] of every fifth slot of expert loops from starts that no evaluation uses."""
    from tsjepa.envs import Renderer
    from tsjepa.evaluation.closed_loop import SemanticPolicy

    watcher, expert = SemanticPolicy(model, Renderer().render, 1), Expert(plants.sampling_interval)
    embeddings = []

    def watched(slot: int, observation: TensorDictBase) -> Tensor:
        if slot % 5 == 0:
            embeddings.append(model.encode(watcher.frames(observation)))
        return expert(observation["state"])

    run(replace(plants, frame_history=model.frame_history).starts(CALIBRATION_SEED, count), watched)
    return torch.cat(embeddings)


def update_bits(radio: Radio, codec: torch.nn.Module, model: SemanticController | None) -> int | None:
    """Bits the scheduler reserves for an update; None where every device takes one block."""
    if radio.resource_blocks is not None:
        return None
    if radio.payload_bits is not None:
        return radio.payload_bits
    if radio.codec in ("png", "jpeg", "webp"):
        raise ValueError(
            f"Packets of the codec {radio.codec!r} vary in length: give radio.payload_bits, the bits to reserve for "
            "one, or radio.resource_blocks."
        )
    if radio.codec == "raw":
        return payload_bits(codec.encode(torch.zeros((1, *codec.shape), dtype=torch.uint8)))[0].item()
    dimension = 4 if model is None else model.architecture.embedding_dim
    return payload_bits(codec.encode(torch.ones(1, dimension)))[0].item()
