"""The codec between a model's encoder and its controller, with the ranges that travel with the model."""

from __future__ import annotations

from torch import Tensor, nn

from tsjepa.radio.codecs import make_codec


class UnitNorm(nn.Module):
    """A codec whose receiver brings what it decodes back to unit length, as the predictor and the actor expect."""

    def __init__(self, codec: nn.Module) -> None:
        super().__init__()
        self.codec = codec

    def encode(self, values: Tensor):
        return self.codec.encode(values)

    def decode(self, packets) -> Tensor:
        return nn.functional.normalize(self.codec.decode(packets), dim=-1)


def embedding_codec(name: str, model: nn.Module) -> nn.Module:
    """The codec that sends the embeddings [N, d] of ``model``: "fp32", "fp16", "int8" or "int4".

    Raises:
        ValueError: an integer codec for a model that came without ranges.
    """
    codec = make_codec(name, dimension=model.architecture.embedding_dim)
    if name in ("int8", "int4"):
        if bool(model.code_low.isnan().any()):
            raise ValueError(
                f"The codec {name} needs ranges, which this model lacks: fit its actor again with the callback "
                "tsjepa.training.finish.codec.FitCodec, or send fp16."
            )
        codec.low.copy_(model.code_low)
        codec.high.copy_(model.code_high)
    return UnitNorm(codec)
