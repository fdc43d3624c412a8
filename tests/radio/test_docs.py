"""The code on the docs page runs."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "write-a-scheduler.md"


@pytest.mark.skipif(not PAGE.exists(), reason="the docs are not part of this installation")
def test_the_docs_page_runs(capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    assert len(blocks) == 5
    names = {}
    for block in blocks:
        exec(block, names)
    printed = capsys.readouterr().out
    assert "patient_opportunist" in printed and "channel_aware" in printed
