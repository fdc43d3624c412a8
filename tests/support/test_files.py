import json

import pytest

from tsjepa.paper import store
from tsjepa.support.files import read_json, whole, write_json, write_text


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -float("inf")])
def test_a_result_with_a_number_that_is_none_is_not_written_and_its_place_is_named(tmp_path, wrong):
    path = tmp_path / "result.json"
    write_json(path, {"score": 0.5, "rows": [{"x": None}, [1, 2.5, True]]})
    whole = path.read_text()
    assert json.loads(whole) == {"score": 0.5, "rows": [{"x": None}, [1, 2.5, True]]}
    with pytest.raises(ValueError, match=r"result\.json is not written: result\.rows\[1\]\.score in it is not finite"):
        write_json(path, {"rows": [{"score": 1.0}, {"score": wrong}]})
    assert path.read_text() == whole
    assert [file.name for file in tmp_path.iterdir()] == ["result.json"]


def test_the_records_of_a_figure_hold_finite_numbers_only(tmp_path):
    record = {"point": {}, "rows": [{"score": float("nan")}], "made_by": {}}
    with pytest.raises(ValueError, match=r"toy\.json is not written: result\.rows\[0\]\.score"):
        store.write(tmp_path, "toy", [record])
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_not_whole_leaves_what_was_there_and_nothing_beside_it(tmp_path):
    write_text(tmp_path / "text", "before")
    with pytest.raises(KeyboardInterrupt), whole(tmp_path / "text") as partial:
        partial.write_text("half")
        raise KeyboardInterrupt
    assert (tmp_path / "text").read_text() == "before"
    assert [file.name for file in tmp_path.iterdir()] == ["text"]


def test_a_writer_that_goes_by_the_suffix_has_it(tmp_path):
    with whole(tmp_path / "film.mp4", ".mp4") as partial:
        assert partial.suffix == ".mp4" and partial.parent == tmp_path
        partial.write_text("film")
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize("content", [b"", b'{"a": 1', b"[1]", b"null", b'{"a": "\xff"}'])
def test_a_damaged_file_of_json_is_named_in_one_sentence(tmp_path, content):
    (tmp_path / "result.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"result\.json is damaged: it .*; make it anew\.$"):
        read_json(tmp_path / "result.json")
