from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from torch.nn import functional as F

from tsjepa.data.augmentation import Augmentation
from tsjepa.models import Encoder, HierarchicalPredictor, Predictor
from tsjepa.training.finish.hierarchy import FitHierarchy, disagreement, fit_hierarchy
from tsjepa.training.jepa import TSJEPA


def circle(episodes: int = 40, slots: int = 30, seed: int = 0) -> TensorDict:
    """Embeddings on a circle that turn by half of the command in every slot."""
    action = 0.4 * torch.randn(episodes, slots, 1, generator=torch.Generator().manual_seed(seed))
    angle = torch.cat((torch.zeros(episodes, 1), 0.5 * action[..., 0].cumsum(1)), 1)[:, :-1]
    embedding = torch.stack((torch.cos(angle), torch.sin(angle)), -1)
    return TensorDict({"embedding": embedding, "action": action}, batch_size=[episodes, slots])


def predictor() -> HierarchicalPredictor:
    torch.manual_seed(0)
    made = HierarchicalPredictor(2, (32, 32, 32), (1, 3, 12))
    made.command_std.fill_(0.4)
    return made


@pytest.mark.slow
def test_every_stride_learns_where_its_jumps_lead():
    made, unseen = predictor(), circle(seed=1)
    fit_hierarchy(made, circle(), 600, (6, 4, 2), 64, 5e-3, seed=0)
    for level, (stride, count) in enumerate(zip(made.strides, (6, 4, 2), strict=True)):
        predicted = made.jumps(level, unseen["embedding"][:, 0], unseen["action"][:, : count * stride])
        true = unseen["embedding"][:, stride : count * stride + 1 : stride]
        copied = unseen["embedding"][:, :1].expand_as(true)
        error, of_copy = (1 - F.cosine_similarity(told, true, dim=-1).mean() for told in (predicted, copied))
        assert error < 0.05 * of_copy


def test_disagreement_counts_the_slots_that_two_strides_reach():
    here, there = torch.tensor([1.0, 0.0]), torch.tensor([0.0, 1.0])
    fine = here.expand(5, 6, 2)
    coarse = torch.stack((here, there), 0).expand(5, 2, 2)  # at slots 3 and 6 of strides 1 and 3
    assert disagreement([fine, coarse], (1, 3)).item() == pytest.approx(0.5)
    assert disagreement([fine[:, :3], coarse], (1, 3)).item() == pytest.approx(0.0)
    assert disagreement([fine[:, :2], coarse], (1, 3)).item() == 0.0


def test_the_weight_of_consistency_brings_strides_together():
    apart = []
    for weight in (0.0, 30.0):
        made, data = predictor(), circle()
        data["embedding"] = F.normalize(torch.randn(40, 30, 2, generator=torch.Generator().manual_seed(3)), dim=-1)
        fit_hierarchy(made, data, 60, (3, 1, 1), 64, 5e-3, seed=0, consistency_weight=weight)
        told = [made.jumps(0, data["embedding"][:, 0], data["action"][:, :3])]
        told.append(made.jumps(1, data["embedding"][:, 0], data["action"][:, :3]))
        apart.append(disagreement(told, (1, 3)).item())
    assert apart[1] < 0.5 * apart[0]


def test_what_does_not_fit_is_said():
    with pytest.raises(ValueError, match="do not fit into trajectories of 30"):
        fit_hierarchy(predictor(), circle(), 1, (1, 1, 3), 8, 1e-3, seed=0)
    with pytest.raises(ValueError, match="for each of the strides"):
        fit_hierarchy(predictor(), circle(), 1, (1, 1), 8, 1e-3, seed=0)
    with pytest.raises(ValueError, match="has a Predictor"):
        FitHierarchy().on_fit_start(SimpleNamespace(), SimpleNamespace(predictor=Predictor(2, 4)))


def test_only_the_stride_of_one_slot_learns_with_the_encoder():
    made = HierarchicalPredictor(8, (4, 4, 4))
    module = TSJEPA(Encoder(2, (4, 8, 8), 8, 64, 128), made, Augmentation())
    learns = [all(weight.requires_grad for weight in level.parameters()) for level in module.predictor.levels]
    assert learns == [True, False, False]
    before = [level.hidden.weight.clone() for level in made.levels]
    data = TensorDict({"embedding": torch.randn(3, 30, 8), "action": torch.randn(3, 30, 1)}, batch_size=[3, 30])
    fit_hierarchy(made, data, 2, (1, 1, 1), 4, 1e-3, seed=0)
    assert not any(torch.equal(level.hidden.weight, old) for level, old in zip(made.levels, before, strict=True))
