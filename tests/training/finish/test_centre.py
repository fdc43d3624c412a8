from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from tsjepa.models import Encoder
from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.centre import CentreEmbedding, centre_embedding


def split() -> TensorDict:
    generator = torch.Generator().manual_seed(0)
    pixels = torch.randint(0, 256, (3, 12, 64, 128, 3), dtype=torch.uint8, generator=generator)
    zeros = torch.zeros(3, 12, 1)
    return TensorDict(
        {"pixels": pixels, "state": zeros.expand(-1, -1, 4), "action": zeros, "expert_action": zeros},
        batch_size=[3, 12],
    )


def projections(encoder: Encoder) -> torch.Tensor:
    """The encoder's outputs before normalisation, over the whole split."""
    outputs = []
    hook = encoder.project.register_forward_hook(lambda module, inputs, output: outputs.append(output))
    embed_split(encoder, split(), 1)
    hook.remove()
    return torch.cat(outputs)


def test_only_the_mean_is_taken_out():
    torch.manual_seed(0)
    encoder = Encoder(widths=(4, 8, 8), embedding_dim=16)
    encoder.project.bias.data.fill_(5.0)
    before = projections(encoder)
    centre_embedding(encoder, split(), 1)
    after = projections(encoder)
    torch.testing.assert_close(after, before - before.mean(0), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("last", [{}, {"project": torch.nn.Linear(2, 2, bias=False)}])
def test_an_encoder_without_such_a_layer_is_left_alone_and_named(last, capsys):
    encoder = torch.nn.ModuleDict({"layers": torch.nn.Linear(2, 2), **last})
    before = {name: value.clone() for name, value in encoder.state_dict().items()}
    trainer, module = SimpleNamespace(datamodule=None), SimpleNamespace(encoder=encoder)
    CentreEmbedding().finish(trainer, module)
    assert all(torch.equal(value, before[name]) for name, value in encoder.state_dict().items())
    assert "ModuleDict has no last layer named project that has a bias" in capsys.readouterr().out
