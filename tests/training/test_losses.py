import pytest
import torch
from torch.nn import functional as F

from tsjepa.training.losses import InverseDynamics, cosine_loss, covariance_loss, variance_loss


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
