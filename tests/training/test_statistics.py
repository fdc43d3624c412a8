import torch

from tsjepa.training.statistics import mean_and_std


def test_what_does_not_vary_is_scaled_by_one():
    values = torch.stack((torch.arange(5.0), torch.full((5,), 3.0)), dim=1)
    mean, std = mean_and_std(values)
    assert mean.tolist() == [2.0, 3.0]
    torch.testing.assert_close(std, torch.tensor([2.5**0.5, 1.0]))


def test_a_single_sample_is_scaled_by_one():
    mean, std = mean_and_std(torch.tensor([[4.0, -1.0]]))
    assert mean.tolist() == [4.0, -1.0] and std.tolist() == [1.0, 1.0]
