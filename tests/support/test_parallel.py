import subprocess
import sys
from pathlib import Path

import gather_rows
import pytest
import torch

from tsjepa.support.parallel import gather


def test_one_process_has_its_own_rows():
    rows = torch.ones(3, 2)
    assert gather(rows) is rows


@pytest.mark.slow
def test_a_loss_over_unequal_shares_is_that_of_the_whole_batch(tmp_path):
    program = Path(gather_rows.__file__)
    processes = [
        subprocess.Popen([sys.executable, program, str(rank), str(tmp_path)]) for rank in range(len(gather_rows.COUNTS))
    ]
    assert [process.wait(timeout=120) for process in processes] == [0, 0]
    whole = gather_rows.rows().requires_grad_()
    expected = gather_rows.loss(whole)
    expected.backward()
    values, gradients = zip(*(torch.load(tmp_path / f"{rank}.pt") for rank in (0, 1)), strict=True)
    torch.testing.assert_close(torch.stack(values), expected.detach().expand(2))
    # summed over the processes here; DistributedDataParallel takes their mean
    torch.testing.assert_close(torch.cat(gradients) / 2, whole.grad)
