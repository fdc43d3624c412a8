"""An observer learns Kalman's gain where that is known; batches repeat; what it cannot be fitted to is named."""

import math
from types import SimpleNamespace

import pytest
import tiny_controller
import tiny_data
import torch
from tensordict import TensorDict

from tsjepa.models import HierarchicalPredictor, Observer, entries
from tsjepa.training.observer import FitObserver, watched_loss
from tsjepa.training.observer_data import EpochSteps, WatchedTrajectories, Watches


class Turn(torch.nn.Module):
    """A point on the circle turns by the command, in radians."""

    def forward(self, embedding, command):
        cosine, sine = torch.cos(command), torch.sin(command)
        x, y = embedding[..., :1], embedding[..., 1:]
        return torch.cat((cosine * x - sine * y, sine * x + cosine * y), -1)


def circle(angle: torch.Tensor) -> torch.Tensor:
    return torch.stack((angle.cos(), angle.sin()), -1)


def watched(rows: int, slots: int, process_std: float, seen_std: float, generator) -> TensorDict:
    """A point that turns by commands and by noise, seen with noise."""
    command = 0.3 * torch.randn(rows, slots, generator=generator)
    step = command + process_std * torch.randn(rows, slots, generator=generator)
    first = 2 * math.pi * torch.rand(rows, 1, generator=generator)
    angle = torch.cat((first, first + step.cumsum(1)), 1)
    seen = circle(angle + seen_std * torch.randn(rows, slots + 1, generator=generator))
    return TensorDict({"embedding": seen, "action": command.unsqueeze(-1)}, batch_size=[rows])


@pytest.mark.parametrize(("process_std", "seen_std"), [(0.02, 0.04), (0.03, 0.02)])
def test_the_gain_becomes_kalmans(process_std, seen_std):
    """For a random walk of variance q a slot, seen with variance r: K = p / (p + r), where p^2 - q p - q r = 0."""
    q, r = process_std**2, seen_std**2
    p = (q + math.sqrt(q * q + 4 * q * r)) / 2
    generator, model = torch.Generator().manual_seed(0), tiny_controller.tiny()
    model.observer, model.predictor = Observer(2, gain=0.9), Turn()
    optimizer = torch.optim.Adam(model.observer.parameters(), 0.01)
    starts = watched(1, 2, process_std, seen_std, generator)
    for step in range(400):
        for group in optimizer.param_groups:
            group["lr"] = 0.01 * (1 - step / 400)
        optimizer.zero_grad()
        watched_loss(model, watched(512, 16, process_std, seen_std, generator), starts).backward()
        optimizer.step()
    gain = model.observer.correction.weight.diagonal().mean().item()
    assert gain == pytest.approx(p / (p + r), abs=0.04)


def test_one_that_knows_the_last_command_learns_what_that_has_done_to_what_is_seen():
    """A point that is seen half a command behind where it is, as two frames show a rate half a slot late."""
    torch.manual_seed(0)
    generator, model = torch.Generator().manual_seed(0), tiny_controller.tiny()
    model.observer, model.predictor = Observer(2, gain=1.0, hidden_dim=32, memory=False), Turn()

    def behind(rows: int, slots: int) -> tuple[TensorDict, torch.Tensor]:
        command = 0.3 * torch.randn(rows, slots, generator=generator)
        angle = 2 * math.pi * torch.rand(rows, 1, generator=generator) + command.cumsum(1)
        start = angle[:, :1] - command[:, :1]
        seen = circle(torch.cat((start, angle - 0.5 * command), 1))
        data = {"embedding": seen, "action": command.unsqueeze(-1)}
        return TensorDict(data, batch_size=[rows]), circle(angle)

    optimizer = torch.optim.Adam(model.observer.parameters(), 0.01)
    starts = behind(1, 4)[0]
    for step in range(300):
        for group in optimizer.param_groups:
            group["lr"] = 0.01 * (1 - step / 300)
        optimizer.zero_grad()
        watched_loss(model, behind(512, 6)[0], starts).backward()
        optimizer.step()
    data, true = behind(1000, 1)
    belief = model.belief_after(data["embedding"], data["action"])
    seen_off, off = ((1 - (points * true[:, 0]).sum(-1)).mean() for points in (data["embedding"][:, 1], belief))
    assert off < seen_off / 10


def embedded(episodes: int = 6, slots: int = 25) -> TensorDict:
    number = torch.arange(float(episodes * slots)).view(episodes, slots, 1)
    return TensorDict({"embedding": number, "action": number + 0.5}, batch_size=[episodes, slots])


def test_rows_are_slots_in_their_order_from_one_trajectory():
    data = Watches(embedded(), embedded(4, 6), slots=7, horizon=5, counts=(9, 3), seed=1)
    lengths = set()
    for step in range(40):
        batch = data[0, step]
        for part, rows in (("watched", 9), ("starts", 3)):
            embedding, action = batch[part]["embedding"][..., 0], batch[part]["action"][..., 0]
            assert len(embedding) == rows and embedding.shape[1] == action.shape[1] + 1
            assert torch.equal(embedding.diff(dim=1), torch.ones_like(action))
            assert torch.equal(embedding[:, :-1] + 0.5, action)
            every = {"watched": 25, "starts": 6}[part]
            assert torch.equal(embedding[:, 0] // every, embedding[:, -1] // every)
        lengths.add(batch["watched"]["action"].shape[1])
        assert batch["starts"]["action"].shape[1] == 5
    assert lengths == set(range(6, 13))


def test_batches_repeat_by_epoch_and_step_and_processes_draw_other_rows_of_the_same_length():
    first, again, other, rank = (
        Watches(embedded(), embedded(4, 6), 7, 5, (9, 3), seed, rank)[place]
        for seed, rank, place in ((1, 0, (2, 3)), (1, 0, (2, 3)), (1, 0, (3, 3)), (1, 1, (2, 3)))
    )
    assert torch.equal(first["watched"]["embedding"], again["watched"]["embedding"])
    assert first["watched"].shape == rank["watched"].shape
    assert not torch.equal(first["watched"]["embedding"], rank["watched"]["embedding"])
    assert not torch.equal(first["starts"]["embedding"], other["starts"]["embedding"])


def test_the_steps_of_an_epoch_name_it():
    steps = EpochSteps(3)
    walk = iter(steps)
    steps.set_epoch(4)
    assert list(walk) == [(4, 0), (4, 1), (4, 2)] and len(steps) == 3


def test_only_gain_and_predictor_learn_and_the_gain_does_not_decay(tmp_path):
    model = tiny_controller.tiny()
    model.metrics = {"closed_loop": []}
    module = FitObserver(str(entries.save(model, tmp_path / "model", card="of the model without an observer")))
    learning = {name.split(".")[1] for name, parameter in module.named_parameters() if parameter.requires_grad}
    assert learning == {"observer", "predictor"}
    assert module.controller().metrics is None and module.controller().card == ""
    module.trainer = SimpleNamespace(estimated_stepping_batches=10)
    gain, other = module.controller().observer.correction.weight, []
    for group in module.configure_optimizers()["optimizer"].param_groups:
        decays = group["weight_decay"] > 0
        assert not decays or all(parameter is not gain for parameter in group["params"])
        other += group["params"] if decays else []
    assert other


@pytest.mark.parametrize(("slots", "fits"), [(24, True), (18, False)])
def test_rows_have_to_fit_into_a_split_that_is_watched_and_begun_in(tmp_path, slots, fits):
    path = str(tiny_data.write(tmp_path / "data", slots=slots, train=3, test=2))
    data = WatchedTrajectories(path, starts="train", batch_size=8, steps_per_epoch=3, validation="test")
    module = SimpleNamespace(model=tiny_controller.tiny())
    data.trainer = SimpleNamespace(
        lightning_module=module, strategy=SimpleNamespace(root_device="cpu"), global_rank=0, world_size=1
    )
    if not fits:
        with pytest.raises(ValueError, match="20 slots"):
            data.setup()
        return
    data.setup()
    assert len(list(data.train_dataloader())) == 3
    (batch,) = data.val_dataloader()
    assert batch.shape == (2, slots)


def test_a_share_is_one():
    with pytest.raises(ValueError, match=r"start_share is 1\.2"):
        WatchedTrajectories("data", start_share=1.2)


def strided() -> torch.nn.Module:
    model = tiny_controller.tiny()
    model.predictor = HierarchicalPredictor(tiny_controller.DIM, (4, 4), (1, 5))
    return model


@pytest.mark.parametrize(
    ("model", "sentence"),
    [
        (tiny_controller.tiny_supervised, "has no predictor, which an observer corrects: take a TS-JEPA"),
        (tiny_controller.tiny_autoencoder, "has no predictor, which an observer corrects: take a TS-JEPA"),
        (strided, "has several strides: take one of single slots"),
    ],
)
def test_what_cannot_be_observed_is_refused(tmp_path, model, sentence):
    folder = str(entries.save(model(), tmp_path / "model"))
    with pytest.raises(ValueError, match=sentence):
        FitObserver(folder)
