import pytest
import torch

from tsjepa.training.imitation_data import ImitationPairs, RowSampler


def rows(**changes) -> list[list[int]]:
    sampler = RowSampler(**{"rows": 22, "batch": 6, "seed": 3, **changes})
    sampler.set_epoch(1)
    return [batch.tolist() for batch in sampler]


def test_an_epoch_takes_every_row_once_but_those_that_do_not_fill_a_batch():
    batches = rows()
    assert [len(batch) for batch in batches] == [6, 6, 6]
    assert len({row for batch in batches for row in batch}) == 18


def test_processes_share_a_batch_without_overlap():
    parts = [rows(rank=rank, world_size=2) for rank in (0, 1)]
    for whole, first, second in zip(rows(), *parts, strict=True):
        assert [row for pair in zip(first, second, strict=True) for row in pair] == whole


def test_rows_move_with_the_seed_and_repeat():
    assert rows() == rows() != rows(seed=4)


def test_rows_do_not_touch_the_global_stream():
    before = torch.get_rng_state()
    rows()
    assert torch.equal(torch.get_rng_state(), before)


def test_fewer_rows_than_a_batch_are_refused_with_both_numbers():
    assert [len(batch) for batch in rows(rows=6)] == [6]
    with pytest.raises(ValueError, match=r"give 5 rows, and batch_size = 6 takes more: make .*batch_size 5 or smaller"):
        rows(rows=5)


@pytest.mark.parametrize(("horizons", "said"), [([], "horizons is empty"), ([0, -1], r"horizons\[1\] is -1")])
def test_horizons_that_cannot_be_are_refused_before_the_data_are_read(horizons, said):
    with pytest.raises(ValueError, match=said):
        ImitationPairs("data/absent", horizons=horizons)
