import pytest
import tiny_controller
import torch
from tensordict import TensorDict

from tsjepa.models import Encoder, Predictor, entries
from tsjepa.training.actor import SemanticActor, imitation_pairs
from tsjepa.training.pretrained import start_from


@pytest.fixture(scope="module")
def entry(tmp_path_factory) -> str:
    return str(entries.save(tiny_controller.tiny(), tmp_path_factory.mktemp("zoo") / "entry"))


def test_all_weights_come_from_the_entry_where_sizes_agree(entry):
    encoder, predictor = Encoder(widths=(4, 8, 8), embedding_dim=8), Predictor(8, 16)
    start_from(entry, encoder=encoder, predictor=predictor)
    given = entries.load(entry)
    for part, module in (("encoder", encoder), ("predictor", predictor)):
        for name, value in getattr(given, part).state_dict().items():
            assert torch.equal(module.state_dict()[name], value)


def test_another_embedding_dimension_keeps_the_convolutions_and_draws_its_own_projection(entry):
    encoder = Encoder(widths=(4, 8, 8), embedding_dim=6)
    drawn = encoder.project.weight.clone()
    start_from(entry, encoder=encoder, predictor=Predictor(6))
    assert torch.equal(encoder.stem[0].weight, entries.load(entry).encoder.stem[0].weight)
    assert torch.equal(encoder.project.weight, drawn)


def test_an_encoder_that_would_start_from_nothing_is_refused(entry):
    with pytest.raises(ValueError, match="give it the widths and the frame_stack"):
        start_from(entry, encoder=Encoder(widths=(6, 6, 6), embedding_dim=8))


def test_a_part_that_the_entry_lacks_keeps_its_draw_and_an_actor_cannot_learn_on_predictions(tmp_path):
    folder = str(entries.save(tiny_controller.tiny_autoencoder(), tmp_path / "entry"))
    given = entries.load(folder)
    encoder, predictor = Encoder(widths=given.encoder.widths, embedding_dim=given.embedding_dim), Predictor(8, 16)
    drawn = {name: value.clone() for name, value in predictor.state_dict().items()}
    start_from(folder, encoder=encoder, predictor=predictor)
    assert torch.equal(encoder.stem[0].weight, given.encoder.stem[0].weight)
    assert all(torch.equal(predictor.state_dict()[name], value) for name, value in drawn.items())
    model = SemanticActor(folder).controller()
    assert model.predictor is None
    data = TensorDict({"embedding": torch.randn(2, 6, given.embedding_dim)}, batch_size=[2, 6])
    assert len(imitation_pairs(model, data, [0])) == 12
    with pytest.raises(ValueError, match="A horizon of 3 slots needs a predictor"):
        imitation_pairs(model, data, [0, 3])
