import pytest
import torch
from torch import nn

from tsjepa.models import HierarchicalPredictor, rollout


class Turn(nn.Module):
    """A world in which the exact answer is known: the embedding turns by the sum of the commands."""

    def __init__(self, stride: int, log: list[int]) -> None:
        super().__init__()
        self.stride, self.log = stride, log

    def forward(self, embedding, commands):
        assert commands.shape[-1] == self.stride
        self.log.append(self.stride)
        angle = torch.atan2(embedding[..., 1], embedding[..., 0]) + commands.sum(-1)
        return torch.stack((torch.cos(angle), torch.sin(angle)), -1)


def turning(strides=(1, 5, 20)) -> tuple[HierarchicalPredictor, list[int]]:
    log: list[int] = []
    predictor = HierarchicalPredictor(2, [4] * len(strides), strides)
    predictor.levels = nn.ModuleList(Turn(stride, log) for stride in strides)
    return predictor, log


def turned(commands):
    angle = commands[..., 0].cumsum(-1)
    return torch.stack((torch.cos(angle), torch.sin(angle)), -1)


def drawn(*shape: int) -> torch.Tensor:
    return 0.1 * torch.randn(*shape, 1, generator=torch.Generator().manual_seed(0))


def test_every_slot_is_predicted_from_where_its_largest_stride_began():
    predictor, log = turning()
    commands, start = drawn(3, 48), torch.tensor([1.0, 0.0]).expand(3, 2)
    torch.testing.assert_close(rollout(predictor, start, commands), turned(commands), atol=1e-5, rtol=0)
    assert len(log) == 48  # one jump a slot
    assert [log[slot - 1] for slot in (1, 4, 5, 10, 19, 20, 25, 40, 48)] == [1, 1, 5, 5, 1, 20, 5, 20, 1]


def test_an_error_of_a_small_stride_ends_where_a_larger_one_does():
    predictor, _ = turning()
    predictor.levels[0].forward = lambda embedding, commands: torch.tensor([-1.0, 0.0]).expand_as(embedding)
    commands, start = drawn(3, 20), torch.tensor([1.0, 0.0]).expand(3, 2)
    predicted, true = rollout(predictor, start, commands), turned(commands)
    right = [slot for slot in range(1, 21) if torch.allclose(predicted[:, slot - 1], true[:, slot - 1], atol=1e-5)]
    assert right == [5, 10, 15, 20]


def test_rows_of_different_ages_advance_as_each_would_alone():
    torch.manual_seed(0)
    predictor = HierarchicalPredictor(3, (8, 8, 8), (1, 2, 6))
    commands, start = drawn(4, 15), nn.functional.normalize(torch.randn(4, 3), dim=-1)
    begins = torch.tensor([0, 1, 3, 8])  # the slot in which each row's embedding arrived
    trail, slots = torch.zeros(4, 3, 3), torch.zeros(4, dtype=torch.int64)
    for slot in range(15):
        arrived = begins == slot
        trail = torch.where(arrived[:, None, None], start[:, None].expand_as(trail), trail)
        slots = torch.where(arrived, 0, slots) + 1
        recent = torch.cat((torch.zeros(4, 6, 1), commands[:, : slot + 1]), 1)[:, -6:]
        trail = predictor.advance(trail, recent, slots)
    for row, begin in enumerate(begins.tolist()):
        alone = predictor.ahead(start[row], commands[row, begin:])[-1]
        torch.testing.assert_close(trail[row, 0], alone)


def test_with_one_stride_it_is_the_predictor_of_one_slot():
    torch.manual_seed(0)
    predictor = HierarchicalPredictor(3, (8,), (1,))
    predictor.command_mean.fill_(2.0)
    predictor.command_std.fill_(3.0)
    commands, start = drawn(5, 4), nn.functional.normalize(torch.randn(5, 3), dim=-1)
    expected, embedding = [], start
    for command in commands.unbind(1):
        embedding = predictor.levels[0](embedding, (command - 2) / 3)
        expected.append(embedding)
    torch.testing.assert_close(rollout(predictor, start, commands), torch.stack(expected, 1))
    torch.testing.assert_close(predictor(start, commands[:, 0]), expected[0])


@pytest.mark.parametrize("strides", [(), (2, 4), (1, 1), (1, 5, 12), (5, 1), (1, 0)])
def test_strides_that_do_not_nest_are_refused(strides):
    with pytest.raises(ValueError, match="strides"):
        HierarchicalPredictor(2, [4] * len(strides), strides)


def test_a_width_is_given_for_each_stride():
    with pytest.raises(ValueError, match="widths has 1 numbers for 3 strides"):
        HierarchicalPredictor(2, (4,))
