"""The reader on the docs page imports."""

import re
import sys
import types
from pathlib import Path

import cv2
import numpy as np
import pytest
import recordings as make

from tsjepa.data.importer import import_recording
from tsjepa.data.storage import open_split

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "recordings.md"


@pytest.mark.skipif(not PAGE.exists(), reason="the docs are not part of this installation")
def test_the_reader_of_the_docs_page_imports(tmp_path, monkeypatch):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    module = types.ModuleType("my_readers")
    exec(block, module.__dict__)
    monkeypatch.setitem(sys.modules, "my_readers", module)
    for run in (2, 10):
        (tmp_path / "runs" / f"run{run}").mkdir(parents=True)
        np.savetxt(tmp_path / "runs" / f"run{run}.txt", np.arange(11) + run)
        for number, frame in enumerate(make.pictures(11), 1):
            cv2.imwrite(str(tmp_path / "runs" / f"run{run}" / f"{number}.png"), frame[..., ::-1])
    import_recording(
        str(tmp_path / "runs"), str(tmp_path / "set"), size=None, slots=10, validation=0, test=0,
        reader="my_readers.TextAndPictures",
    )  # fmt: skip
    split = open_split(tmp_path / "set", "train")
    np.testing.assert_array_equal(split["action"][:, :-1, 0].numpy(), np.arange(10) + np.array([[2], [10]]))
    np.testing.assert_array_equal(split["pixels"][0].numpy(), make.pictures(11))
