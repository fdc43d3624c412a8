import copy
from types import SimpleNamespace

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from tsjepa.data.augmentation import Augmentation
from tsjepa.models import DifferenceEncoder, Encoder, Predictor, rollout
from tsjepa.models.checks import check_encoder
from tsjepa.models.encoder import unpatchify
from tsjepa.support.spec import PlantSpec
from tsjepa.training.jepa import TSJEPA
from tsjepa.training.schedule import warmup_cosine

D = 16


@pytest.fixture
def module():
    torch.manual_seed(0)
    encoder, predictor = Encoder(2, (4, 8, 8), D), Predictor(D, 32)
    return TSJEPA(encoder, predictor, Augmentation(), ema_decay=0.9).train()


def unit(*shape: int) -> torch.Tensor:
    return F.normalize(torch.randn(*shape, generator=torch.Generator().manual_seed(1)), dim=-1)


@pytest.mark.parametrize("gap", [1, 3])
def test_prediction_loss_is_the_mean_over_every_pair_of_stacks(module, gap):
    windows, stacks = 3, 4
    embedding, target = unit(windows, stacks, D), unit(windows, stacks, D).flip(0)
    commands = 5 * torch.randn(windows, gap * (stacks - 1), 1, generator=torch.Generator().manual_seed(2))
    by_horizon = {ahead: [] for ahead in range(1, stacks)}
    for window in range(windows):
        for origin in range(stacks):
            for later in range(origin + 1, stacks):
                between = commands[window, gap * origin : gap * later]
                predicted = rollout(module.predictor, embedding[window, origin], between)[-1]
                by_horizon[later - origin].append(1 - predicted @ target[window, later])
    # every horizon weighs the same, though the longer ones have fewer pairs
    expected = torch.stack([torch.stack(values).mean() for values in by_horizon.values()]).mean()
    torch.testing.assert_close(module.prediction_loss(embedding, target, commands, gap), expected)


def test_inverse_loss_is_the_squared_error_of_the_mean_z_scored_command(module):
    module.predictor.command_mean.fill_(1.0)
    module.predictor.command_std.fill_(4.0)
    embedding = unit(2, 3, D)
    commands = torch.arange(8.0).view(2, 4, 1)
    expected = []
    for window in range(2):
        for stack in range(2):
            mean = (commands[window, 2 * stack : 2 * stack + 2].mean() - 1) / 4
            guess = module.inverse_dynamics(embedding[window, stack], embedding[window, stack + 1], 2)
            expected.append((guess - mean).square())
    torch.testing.assert_close(module.inverse_loss(embedding, commands, 2), torch.stack(expected).mean())


def test_the_target_is_the_exponential_moving_average_of_weights_and_buffers(module):
    target = module.target_encoder
    module.on_train_batch_end(None, None, 0)  # the average begins with the weights after the first step
    for step in range(3):
        expected = copy.deepcopy(target.module.state_dict())
        with torch.no_grad():
            for number, tensor in enumerate(module.encoder.state_dict().values()):
                if tensor.is_floating_point():
                    tensor.add_(0.1 * (step + 1) + 0.01 * number)
        module.on_train_batch_end(None, None, step)
        for name, value in module.encoder.state_dict().items():
            if value.is_floating_point():
                torch.testing.assert_close(target.module.state_dict()[name], 0.9 * expected[name] + 0.1 * value)
    assert any("running_var" in name for name in expected)


def test_one_step_gives_the_target_no_gradient_and_leaves_it_as_it_was(module, monkeypatch):
    monkeypatch.setattr(module, "log_terms", lambda *args: None)
    monkeypatch.setattr(TSJEPA, "global_step", 3)
    patches = torch.randint(0, 256, (2, 3, 16, 32, 96), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    batch = {"patches": patches, "commands": torch.ones(2, 4, 1)}
    before = copy.deepcopy(module.target_encoder.state_dict())
    loss = module.training_step(batch, 0)
    loss.backward()
    assert all(parameter.grad is None for parameter in module.target_encoder.parameters())
    assert all(parameter.grad is not None for parameter in module.encoder.parameters())
    assert all(parameter.grad is not None for parameter in module.predictor.parameters())
    # batch normalisation of the target neither reads nor counts the batch
    assert all(torch.equal(value, before[name]) for name, value in module.target_encoder.state_dict().items())


@pytest.mark.parametrize("weight", ["variance_weight", "covariance_weight", "inverse_weight"])
def test_without_a_term_every_parameter_still_has_a_gradient(monkeypatch, weight):
    """Data parallelism waits for all of them."""
    monkeypatch.setattr(TSJEPA, "log_terms", lambda *args: None)
    module = TSJEPA(Encoder(2, (4, 8, 8), D), Predictor(D, 32), Augmentation(), **{weight: 0.0}).train()
    patches = torch.randint(0, 256, (2, 3, 16, 32, 96), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    module.training_step({"patches": patches, "commands": torch.ones(2, 4, 1)}, 0).backward()
    assert all(parameter.grad is not None for parameter in module.parameters() if parameter.requires_grad)


def set_up(module, monkeypatch, action=None):
    """The module with a trainer whose training split holds these commands [episodes, T + 1, 1]."""
    spec = PlantSpec((-20.0,), (20.0,), 0.02, (64, 128), state_names=("x", "v")).to_dict()
    data = SimpleNamespace(frame_stack=2, frame_spacing=1, stacks=4, metadata={"spec": spec}, splits=("train",))
    data.split = {"train": {"action": action}}.__getitem__
    monkeypatch.setattr(TSJEPA, "trainer", SimpleNamespace(datamodule=data))
    module.setup("fit")


def test_the_controller_is_one_and_holds_the_parts_that_are_trained(module, monkeypatch):
    names, weights = set(module.state_dict()), {id(parameter) for parameter in module.parameters()}
    set_up(module, monkeypatch)
    controller = module.controller()
    assert controller is module.controller()
    assert controller.encoder is module.encoder and controller.predictor is module.predictor
    # what is not trained here is neither optimized nor in a checkpoint
    assert set(module.state_dict()) == names
    assert {id(parameter) for parameter in module.parameters()} == weights


def test_a_command_that_never_changes_is_scaled_by_one(module, monkeypatch):
    set_up(module, monkeypatch, torch.full((3, 10, 1), 5.0))
    module.on_fit_start()
    assert module.predictor.command_mean == 5 and module.predictor.command_std == 1
    loss = module.inverse_loss(unit(2, 3, D), torch.full((2, 2, 1), 5.0), 1)
    assert loss.isfinite()


def test_what_the_logger_takes_is_logged_and_an_epochs_last_step(module, monkeypatch):
    logged = []
    monkeypatch.setattr(module, "log_dict", logged.append)
    monkeypatch.setattr(module, "log", lambda *args, **kwargs: None)
    trainer = SimpleNamespace(log_every_n_steps=4, is_last_batch=False)
    monkeypatch.setattr(TSJEPA, "trainer", trainer)
    for step in range(10):
        monkeypatch.setattr(TSJEPA, "global_step", step)
        trainer.is_last_batch = step == 9
        module.log_terms(step, None)
    assert logged == [3, 7, 9]
    trainer.log_every_n_steps = 0
    module.log_terms(10, None)
    trainer.is_last_batch = False
    module.log_terms(11, None)
    assert logged == [3, 7, 9, 10]


def test_the_target_stays_in_evaluation_mode(module):
    assert module.encoder.training
    assert not any(part.training for part in module.target_encoder.modules())
    module.eval()
    module.train()
    assert not any(part.training for part in module.target_encoder.modules())


def test_the_loss_of_a_step_depends_on_the_step_and_not_on_the_global_stream(module, monkeypatch):
    monkeypatch.setattr(module, "log_terms", lambda *args: None)
    patches = torch.randint(0, 256, (2, 3, 16, 32, 96), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    batch = {"patches": patches, "commands": torch.ones(2, 2, 1)}
    start = copy.deepcopy(module.state_dict())

    def loss(step: int, seed: int) -> float:
        module.load_state_dict(start)
        monkeypatch.setattr(TSJEPA, "global_step", step)
        torch.manual_seed(seed)
        return module.training_step(batch, 0).item()

    assert loss(3, seed=0) == loss(3, seed=1) != loss(4, seed=0)


def test_warm_up_then_cosine():
    assert warmup_cosine(0.0) < 0.05
    assert warmup_cosine(0.05) == pytest.approx(1.0)
    assert warmup_cosine(0.525) == pytest.approx(0.5)
    assert warmup_cosine(1.0) == pytest.approx(0.0) == warmup_cosine(1.1)


def test_targets_are_of_the_other_view_and_its_distance_is_a_term(monkeypatch):
    same = Augmentation(brightness=0, contrast=0, saturation=0, hue=0, grayscale=0)
    module = TSJEPA(Encoder(2, (4, 8, 8), D), Predictor(D, 32), same, view_weight=3.0).train()
    seen, logged = {}, {}
    monkeypatch.setattr(TSJEPA, "log_terms", lambda self, terms, loss: logged.update(terms, loss=loss))
    inner = module.prediction_loss

    def prediction_loss(embedding, target, commands, gap):
        seen.update(embedding=embedding, target=target)
        return inner(embedding, target, commands, gap)

    monkeypatch.setattr(module, "prediction_loss", prediction_loss)
    generator = torch.Generator().manual_seed(0)
    patches, other = torch.randint(0, 256, (2, 2, 3, 16, 32, 96), dtype=torch.uint8, generator=generator)
    batch = {"patches": patches, "target_patches": other, "commands": torch.ones(2, 4, 1)}
    module.training_step(batch, 0)
    target = module.target_encoder.module(unpatchify(other.flatten(0, 1))).view(2, 3, D)
    torch.testing.assert_close(seen["target"], target)
    own = module.target_encoder.module(unpatchify(patches.flatten(0, 1))).view(2, 3, D)
    assert not torch.allclose(seen["target"], own)
    distance = 1 - F.cosine_similarity(seen["embedding"], target, dim=-1).mean()
    torch.testing.assert_close(logged["view_loss"], distance)
    weights = {"prediction_loss": 1.0, "view_loss": 3.0, "variance_loss": 0.1, "covariance_loss": 0.01}
    expected = logged["inverse_loss"] + sum(weight * logged[name] for name, weight in weights.items())
    torch.testing.assert_close(logged["loss"], expected)


class Means(nn.Module):
    """The mean colours of the frames, turned: an encoder as the page on them says."""

    def __init__(self, embedding_dim=D, height=32):
        super().__init__()
        self.embedding_dim, self.height, self.frame_shape = embedding_dim, height, (2, height, 32, 3)
        self.project = nn.Linear(6, embedding_dim)

    def forward(self, frames):
        return F.normalize(self.project(frames.float().mean((2, 3)).flatten(1) / 255), dim=-1)


class NoFrameShape(nn.Module):
    embedding_dim = D


class NoDim(nn.Module):
    frame_shape = (2, 32, 32, 3)


class Long(Means):
    def forward(self, frames):
        return 5 * super().forward(frames)


class Wide(Means):
    def forward(self, frames):
        return super().forward(frames).repeat(1, 2)


class Nan(Means):
    def forward(self, frames):
        return super().forward(frames) * torch.nan


class Pair(Means):
    def forward(self, frames):
        return super().forward(frames), None


class Forgetful(Means):
    def __init__(self, colour="red"):
        super().__init__()


class WidePatches(Means):
    def embed(self, patches):
        return torch.zeros(len(patches), 3 * D)


class OtherPatches(Means):
    def embed(self, patches):
        return torch.nn.functional.one_hot(torch.zeros(len(patches), dtype=torch.int64), D).float()


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (
            WidePatches,
            r"embed of the encoder WidePatches gives \[2, 48\] for 2 stacks of patches, its forward \[2, 16\]",
        ),
        (OtherPatches, r"embed of the encoder OtherPatches gives embeddings that are \S+ from those of its forward"),
        (NoFrameShape, r"NoFrameShape has the frame_shape None; set self\.frame_shape ="),
        (NoDim, r"NoDim has the embedding_dim None; set self\.embedding_dim"),
        (Long, r"Long gives embeddings of lengths 5 and 5, .*normalize"),
        (Nan, r"Nan gives embeddings of lengths nan and nan, .*normalize"),
        (Wide, r"Wide gives \[2, 32\] for 2 stacks of frames; embeddings are \[2, 16\]"),
        (Pair, r"Pair gives a tuple for 2 stacks of frames"),
        (Forgetful, r"Forgetful cannot be stored.* set self\.colour"),
    ],
)
def test_an_encoder_that_is_none_is_refused_when_the_model_is_built(kind, said):
    with pytest.raises(ValueError, match=said):
        TSJEPA(kind(), Predictor(D, 32), Augmentation())


def test_looking_at_an_encoder_changes_nothing():
    encoder = Means().train()
    weights, drawn = copy.deepcopy(encoder.state_dict()), torch.random.get_rng_state()
    check_encoder(encoder)
    assert encoder.training and torch.equal(torch.random.get_rng_state(), drawn)
    assert all(torch.equal(value, weights[name]) for name, value in encoder.state_dict().items())
    statistics = DifferenceEncoder(2, D).train()
    check_encoder(statistics)
    assert statistics.norm.num_batches_tracked == 0
