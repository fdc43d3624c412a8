"""A fit computes on the trainer's device and a loop on its model's; a GPU is not needed to see that."""

from contextlib import nullcontext

import fake_accelerator
import lightning
import pytest
import tiny_controller
import tiny_data
import torch

from tsjepa.data import module as data_module
from tsjepa.data.augmentation import Augmentation
from tsjepa.data.module import Trajectories
from tsjepa.data.storage import open_split
from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.models import Decoder, Encoder, Predictor, entries
from tsjepa.plants import CartPole
from tsjepa.training.actor import SemanticActor
from tsjepa.training.autoencoder import Autoencoder, FitEstimator
from tsjepa.training.callbacks import ExportModel
from tsjepa.training.finish.centre import CentreEmbedding
from tsjepa.training.finish.codec import FitCodec
from tsjepa.training.finish.decoder import FitDecoder
from tsjepa.training.finish.probe import FitProbe
from tsjepa.training.finish.refine import RefinePredictor
from tsjepa.training.imitation_data import ImitationPairs
from tsjepa.training.jepa import TSJEPA
from tsjepa.training.monitor import RepresentationMonitor

WIDTHS, D = (4, 8, 8), 8


def jepa(data):
    torch.manual_seed(0)
    module = TSJEPA(Encoder(2, WIDTHS, D), Predictor(D, 16), Augmentation())
    finishes = [CentreEmbedding(), RefinePredictor(steps=2, horizon=3, batch_size=4)]
    return module, Trajectories(data, frames_per_batch=32, stacks=4, steps=[1, 2]), [RepresentationMonitor(), *finishes]


def actor(data):
    entry = entries.save(tiny_controller.tiny(), data.parent / "entry")
    finishes = [FitProbe(steps=2), FitDecoder(steps=2, batch_size=4)]
    return SemanticActor(str(entry), (16, 8)), ImitationPairs(data, batch_size=16, horizons=[0, 2]), finishes


def autoencoder(data):
    module = Autoencoder(Encoder(2, WIDTHS, D), Decoder(D, 2, channels=(8, 4, 4, 4)))
    return module, Trajectories(data, frames_per_batch=16, stacks=1, steps=[1]), [FitEstimator(steps=2, batch_size=4)]


@pytest.mark.slow
@pytest.mark.parametrize("make", [jepa, actor, autoencoder])
def test_a_fit_and_its_finishes_compute_on_the_trainers_device(tmp_path, monkeypatch, make):
    path = tiny_data.write(tmp_path / "data")
    # maps cannot be opened under a dispatch mode
    splits = {name: open_split(path, name).clone() for name in tiny_data.SPLITS}
    monkeypatch.setattr(data_module, "open_split", lambda folder, name: splits[name])
    # nor does the meta device know autocast
    monkeypatch.setattr(torch, "is_autocast_enabled", lambda *device: False)
    monkeypatch.setattr(torch, "autocast", lambda *arguments, **options: nullcontext())
    module, data, callbacks = make(path)
    trainer = lightning.Trainer(
        strategy=fake_accelerator.strategy(),
        callbacks=[*callbacks, FitCodec(), ExportModel()],
        default_root_dir=tmp_path,
        max_epochs=1,
        num_sanity_val_steps=0,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    with fake_accelerator.FakeAccelerator() as accelerator:
        trainer.fit(module, data)
    assert accelerator.products["meta"] > 50
    assert accelerator.products["cpu"] == 0
    # the result is on the CPU again, where it was saved from
    assert all(tensor.device.type == "cpu" for tensor in module.controller().state_dict().values())
    assert entries.load(tmp_path / "model").embedding_dim == D


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["fp32", "jpeg"])
def test_a_loop_computes_on_the_models_device_whoever_encodes(codec):
    """``--device`` of evaluate and simulate: frames and embeddings go to where the weights lie, and come back."""
    model = tiny_controller.tiny()
    loop = every(Loop(CartPole(), model, num_devices=2, slots=3, radio=Radio(codec=codec, lossless=True)), 1)
    model.to(fake_accelerator.META)
    with fake_accelerator.FakeAccelerator() as accelerator:
        outcome = run(loop, 0)
    assert accelerator.products["meta"] > 50
    assert accelerator.products["cpu"] == 0
    assert outcome.state.device.type == outcome.action.device.type == "cpu"
