import pytest
import torch
from torch import nn
from torch.nn import functional as F

from tsjepa.training.losses import InverseDynamics, LossTerm, cosine_loss, covariance_loss, variance_loss


def test_cosine_loss_is_zero_one_and_two_for_equal_orthogonal_and_opposite_vectors():
    vectors = torch.tensor([[3.0, 0.0], [0.0, 2.0]])
    assert cosine_loss(vectors, 5 * vectors).item() == pytest.approx(0.0, abs=1e-6)
    assert cosine_loss(vectors, vectors.flip(0)).item() == pytest.approx(1.0)
    assert cosine_loss(vectors, -vectors).item() == pytest.approx(2.0)


def test_variance_loss_is_zero_for_isotropy_and_nearly_one_for_a_point():
    d = 4
    # +- unit vectors: variance 2 / (2d - 1) each, which the factor d brings to 2d / (2d - 1) >= 1
    isotropic = torch.cat((torch.eye(d), -torch.eye(d)))
    assert variance_loss(isotropic).item() == 0.0
    point = torch.eye(d)[:1].repeat(8, 1)
    assert variance_loss(point).item() == pytest.approx(1 - 1e-4**0.5)


def test_variance_loss_of_a_known_spread():
    column = torch.tensor([0.0, 1.0]).repeat(50)[:, None]
    variance = 100 / 99 / 4
    assert variance_loss(column).item() == pytest.approx(1 - (variance + 1e-4) ** 0.5, rel=1e-5)


def test_covariance_loss_of_uncorrelated_and_of_equal_columns():
    signs = torch.tensor([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    assert covariance_loss(signs).item() == pytest.approx(0.0, abs=1e-6)
    equal = signs[:, :1].repeat(1, 2)
    # each column has variance 4 / 3; scaled by d = 2; two off-diagonal entries, over d
    assert covariance_loss(equal).item() == pytest.approx((2 * 4 / 3) ** 2, rel=1e-5)


def test_covariance_loss_agrees_with_torch_cov():
    embedding = F.normalize(torch.randn(30, 5, generator=torch.Generator().manual_seed(0)), dim=-1)
    covariance = 5 * torch.cov(embedding.T)
    off = covariance - torch.diag(covariance.diagonal())
    assert covariance_loss(embedding).item() == pytest.approx((off.square().sum() / 5).item(), rel=1e-5)


def test_inverse_dynamics_sees_both_embeddings_and_the_gap():
    network = InverseDynamics(4, action_dim=1, hidden_dim=8)
    before, after = torch.randn(2, 3, 4, generator=torch.Generator().manual_seed(0))
    answer = network(before, after, gap=2)
    assert answer.shape == (3, 1)
    inputs = torch.cat((2 * before, 2 * (after - before), torch.full((3, 1), 0.5)), dim=1)
    torch.testing.assert_close(answer, network.layers(inputs))


def spread(embedding, target, commands):
    return embedding.var(1)


def test_a_term_of_ones_own_is_a_scalar():
    embedding, commands = torch.ones(2, 3, 4), torch.zeros(2, 2, 1, 1)
    assert LossTerm(lambda *tensors: 0.5)(embedding, embedding, commands) == 0.5
    assert LossTerm(lambda e, t, c: e.sum() - t.mean() + c.sum())(embedding, embedding, commands).item() == 23
    with pytest.raises(
        ValueError, match=rf"{__name__}\.spread gives a tensor of shape \[2, 4\]; it has to give a scalar"
    ):
        LossTerm(spread)(embedding, embedding, commands)
    with pytest.raises(ValueError, match="lambda> gives NoneType; it has to give a scalar"):
        LossTerm(lambda *tensors: None)(embedding, embedding, commands)


def test_a_term_that_is_not_finite_is_named_unless_the_embeddings_are_to_blame():
    embedding, commands = torch.ones(2, 3, 4), torch.zeros(2, 2, 1, 1)
    term = LossTerm(lambda e, t, c: e.mean() / c.sum())
    with pytest.raises(ValueError, match="lambda> is inf though all embeddings are finite"):
        term(embedding, embedding, commands)
    embedding[0, 0, 0] = torch.nan
    assert term(embedding, embedding, commands).isnan()


def test_a_term_that_takes_something_else_is_refused_before_training():
    with pytest.raises(ValueError, match=r"lambda> takes \(embedding, target\); it is called with the context emb"):
        LossTerm(lambda embedding, target: embedding)
    assert LossTerm(nn.CosineSimilarity()).path == "torch.nn.modules.distance.CosineSimilarity"
