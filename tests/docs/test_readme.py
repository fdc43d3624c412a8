"""The Python of the README does what its comments say."""

import re

import pytest
import torch
from pages import blocks


@pytest.mark.slow
def test_a_model_takes_and_gives_what_the_comments_say():
    (block,) = blocks("README.md", "python")
    shape = re.search(r"uint8 \[\.\.\., ([\d, ]+)\]", block)[1]
    width = re.search(r"-> \[\.\.\., (\d+)\]", block)[1]
    names = {"frames": torch.zeros(3, *map(int, shape.split(", ")), dtype=torch.uint8)}
    exec(compile(block, "README.md", "exec"), names)
    assert names["z"].shape == names["z_next"].shape == (3, int(width))
    assert names["u"].abs().max() <= names["model"].spec.action_high[0]
