"""Only what a fit optimizes has gradients: data parallelism waits for every parameter that may have one."""

from types import SimpleNamespace

import pytest
import tiny_controller
import tiny_data

from tsjepa.data.augmentation import Augmentation
from tsjepa.data.module import Trajectories
from tsjepa.models import Decoder, Encoder, entries
from tsjepa.plants import CartPole, describe_plant
from tsjepa.training.actor import SemanticActor
from tsjepa.training.autoencoder import Autoencoder
from tsjepa.training.supervised import Supervised


def actor(folder):
    return SemanticActor(str(entries.save(tiny_controller.tiny(), folder / "entry")))


def supervised(folder):
    return Supervised(Encoder(2, (4, 8, 8), 8), Augmentation())


def autoencoder(folder):
    return Autoencoder(Encoder(2, (4, 8, 8), 8), Decoder(8, 2, channels=(8, 4, 4, 4)), estimator_channels=(4, 8, 8))


@pytest.mark.parametrize("make", [actor, supervised, autoencoder])
def test_what_has_a_gradient_is_what_is_optimized(tmp_path, monkeypatch, make):
    module, data = make(tmp_path), Trajectories(tiny_data.write(tmp_path / "data", slots=6))
    data.setup()
    monkeypatch.setattr(type(module), "trainer", SimpleNamespace(datamodule=data, estimated_stepping_batches=10))
    module.setup("fit")
    optimized = module.configure_optimizers()["optimizer"].param_groups[0]["params"]
    with_gradient = [parameter for parameter in module.parameters() if parameter.requires_grad]
    assert {id(parameter) for parameter in with_gradient} == {id(parameter) for parameter in optimized}


def test_an_actor_is_for_the_plant_that_its_recipe_names(tmp_path):
    entry = str(entries.save(tiny_controller.tiny(), tmp_path / "entry"))
    plant = CartPole(expert="fleet law")
    assert SemanticActor(entry, plant=plant).controller().plant == describe_plant(plant)
    assert SemanticActor(entry).controller().plant == entries.load(entry).plant
    with pytest.raises(ValueError, match=r"slot in seconds of 0\.02, and the plant has 0\.01"):
        SemanticActor(entry, plant=CartPole(0.01))
