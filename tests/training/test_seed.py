"""One seed moves everything that is drawn in a fit, and the same one repeats it."""

from contextlib import nullcontext
from types import SimpleNamespace

import lightning
import pytest
import tiny_controller
import tiny_data
import torch
from tensordict import TensorDict
from torch.nn import functional as F

from tsjepa.data.augmentation import Augmentation
from tsjepa.data.module import Trajectories
from tsjepa.models import Encoder, Predictor, entries
from tsjepa.training.actor import SemanticActor
from tsjepa.training.autoencoder import FitEstimator
from tsjepa.training.finish.decoder import FitDecoder
from tsjepa.training.finish.probe import FitProbe
from tsjepa.training.finish.refine import RefinePredictor
from tsjepa.training.imitation_data import ImitationPairs
from tsjepa.training.jepa import TSJEPA
from tsjepa.training.supervised import Supervised

WIDTHS, D = (4, 8, 8), 8


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tiny_data.write(tmp_path_factory.mktemp("seed") / "data", slots=12)


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    return str(entries.save(tiny_controller.tiny(), tmp_path_factory.mktemp("seed") / "entry"))


def windows(path, entry):
    data = Trajectories(path, frames_per_batch=16, stacks=4, steps=[1, 2])
    return torch.cat([window.episode for window in data.train_dataloader().sampler])


def rows(path, entry):
    data, module = ImitationPairs(path, batch_size=16), SemanticActor(entry, (16, 8))
    strategy = SimpleNamespace(root_device=torch.device("cpu"))
    data.trainer = SimpleNamespace(lightning_module=module, strategy=strategy, global_rank=0, world_size=1)
    data.setup()
    return torch.cat(list(data.train_dataloader().sampler))


def loss_of(module, batch, monkeypatch):
    """Loss of the first step, with the weights that every seed starts from."""
    for name in ("log", "log_terms"):
        monkeypatch.setattr(type(module), name, lambda *arguments, **options: None, raising=False)
    return module.train().training_step(batch, 0)


def patches(*shape: int):
    return torch.randint(0, 256, (*shape, 16, 32, 96), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))


def jepa_augmentation(path, entry, monkeypatch):
    torch.manual_seed(0)
    module = TSJEPA(Encoder(2, WIDTHS, D), Predictor(D, 16), Augmentation())
    return loss_of(module, {"patches": patches(2, 3), "commands": torch.ones(2, 2, 1)}, monkeypatch)


def supervised_augmentation(path, entry, monkeypatch):
    torch.manual_seed(0)
    module = Supervised(Encoder(2, WIDTHS, D), Augmentation())
    module.model = tiny_controller.tiny_supervised()
    return loss_of(module, {"patches": patches(4, 1), "expert_action": torch.ones(4, 1, 1)}, monkeypatch)


def dropout(path, entry, monkeypatch):
    torch.manual_seed(0)
    module = SemanticActor(entry, (64, 64), dropout=0.5)
    embedding = F.normalize(torch.randn(8, D, generator=torch.Generator().manual_seed(0)), dim=-1)
    return loss_of(module, TensorDict({"embedding": embedding, "action": torch.ones(8, 1)}, [8]), monkeypatch)


def finished(callback, model, path, part):
    """The weights of ``part`` after the callback."""
    data = Trajectories(path)
    data.setup()
    precision = SimpleNamespace(forward_context=nullcontext)
    trainer = SimpleNamespace(datamodule=data, precision_plugin=precision)
    predictor = getattr(model, "predictor", None)
    module = SimpleNamespace(encoder=model.encoder, predictor=predictor, controller=lambda: model)
    callback.finish(trainer, module)
    return torch.cat([weight.detach().flatten() for weight in part(model).parameters()])


def refine(path, entry):
    return finished(RefinePredictor(2, 3, 4), tiny_controller.tiny(), path, lambda model: model.predictor)


def probe(path, entry):
    return finished(FitProbe(2), tiny_controller.tiny(), path, lambda model: model.probe)


def decoder(path, entry):
    return finished(FitDecoder(2, 4), tiny_controller.tiny(), path, lambda model: model.decoder)


def estimator(path, entry):
    return finished(FitEstimator(2, 4), tiny_controller.tiny_autoencoder(), path, lambda model: model.estimator)


@pytest.mark.parametrize("drawn", [windows, rows, refine, probe, decoder, estimator])
def test_the_seed_of_the_run_moves(path, entry, drawn):
    first, again, other = [drawn(path, entry) for _ in map(lightning.seed_everything, (0, 0, 1))]
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("drawn", [jepa_augmentation, supervised_augmentation, dropout])
def test_the_seed_of_the_run_moves_each_step(path, entry, monkeypatch, drawn):
    first, again, other = [drawn(path, entry, monkeypatch) for _ in map(lightning.seed_everything, (0, 0, 1))]
    assert first == again != other


def test_a_step_of_the_actor_leaves_the_global_stream_alone(path, entry, monkeypatch):
    module = SemanticActor(entry, (16, 8), dropout=0.5)
    before = torch.get_rng_state()
    batch = TensorDict({"embedding": torch.ones(8, D), "action": torch.ones(8, 1)}, [8])
    loss_of(module, batch, monkeypatch)
    assert torch.equal(torch.get_rng_state(), before)
