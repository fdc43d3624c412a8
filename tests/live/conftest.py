"""Deployments that the tests of this folder share."""

import pytest
import tiny_controller

from tsjepa.models import entries
from tsjepa.plants import CartPole, describe_plant
from tsjepa.zoo.deploy import deploy


@pytest.fixture(scope="session")
def deployed(tmp_path_factory):
    """Folder with the graphs of a tiny model."""
    folder = tmp_path_factory.mktemp("deployed")
    model = tiny_controller.tiny()
    model.code_low.fill_(-1.0)
    model.code_high.fill_(1.0)
    model.plant = describe_plant(CartPole())
    deploy(str(entries.save(model, folder / "model")), str(folder / "graphs"))
    return folder / "graphs"


@pytest.fixture(scope="session")
def shipped(tmp_path_factory):
    """Folder with the graphs of the model that the README names."""
    folder = tmp_path_factory.mktemp("shipped") / "graphs"
    deploy("tsjepa-cartpole", str(folder))
    return folder
