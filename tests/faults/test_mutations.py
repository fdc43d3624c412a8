"""Damaged recordings: a sentence or a whole data set, never a traceback, half a data set or a claimed size in memory.

``TSJEPA_MUTATIONS=500 pytest tests/faults/test_mutations.py`` tries 500 damages of every format.
"""

import json
import os
import resource
import shutil

import numpy as np
import pytest
from mutations import base_logs, base_recordings, mutate, mutate_log

from tsjepa.cli import main
from tsjepa.data.storage import open_split, read_metadata

COUNT = int(os.environ.get("TSJEPA_MUTATIONS", 4))
MOST_MEMORY = 400 << 10  # KiB, beyond what the process had before


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    return base_recordings(tmp_path_factory.mktemp("valid"))


FORMATS = ["lerobot-v2.1", "lerobot-v3.0", "videos", "pictures", "donkeycar"]
FORMATS += ["robomimic", "aloha", "stable-worldmodel", "npz", "rosbag-db3", "rosbag-mcap"]


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_recording_is_refused_or_imported_whole(name, valid, tmp_path, capsys):
    options = ["--slots", "4", "--size", "[8, 8]", "--rate_hz", "20"]
    assert main(["import", str(valid[name]), str(tmp_path / "whole"), *options]) == 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    noticed = 0
    for seed in range(COUNT):
        path = tmp_path / f"damaged{seed}"
        shutil.copytree(valid[name], path)
        done = f"seed {seed}: {mutate(path, np.random.default_rng([seed, *name.encode()]))}"
        capsys.readouterr()
        for command, extra in (("inspect", []), ("import", [str(tmp_path / "set"), *options])):
            status = main([command, str(path), *extra])  # what nobody foresaw is raised
            said = capsys.readouterr()
            assert status in (0, 1, 2) and "Traceback" not in said.err, done
            if status:
                assert said.err.count("\n") == 1, (done, said.err)
        if status:
            noticed += 1
            assert not (tmp_path / "set").exists(), done
        else:
            for split in read_metadata(tmp_path / "set")["splits"]:
                stored = open_split(tmp_path / "set", split)
                assert stored["action"].isfinite().all() and stored["pixels"].shape[1] == 5, done
            noticed += bool(json.loads((tmp_path / "set" / "import.json").read_text())["skipped"])
            shutil.rmtree(tmp_path / "set")
        assert not list(tmp_path.glob("*.partial")) and not list(tmp_path.glob(".*.lock")), done
        shutil.rmtree(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_MEMORY
    assert COUNT < 50 or noticed > COUNT // 10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["table.txt", "packets.jsonl", "ping.txt", "iperf.txt", "iw.jsonl", "link.trace"])
def test_a_damaged_log_of_a_radio_link_is_refused_or_imported_whole(name, tmp_path, capsys):
    valid = base_logs(tmp_path / "valid")[name]
    assert main(["trace", "import", str(valid), str(tmp_path / "whole.parquet")]) == 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for seed in range(COUNT):
        path = tmp_path / name
        shutil.copy(valid, path)
        done = f"seed {seed}: {mutate_log(path, np.random.default_rng([seed, *name.encode()]))}"
        capsys.readouterr()
        status = main(["trace", "import", str(path), str(tmp_path / "out.parquet")])
        said = capsys.readouterr()
        assert status in (0, 1, 2) and "Traceback" not in said.err, done
        if status:
            assert said.err.count("\n") == 1 and not (tmp_path / "out.parquet").exists(), (done, said.err)
        for file in tmp_path.glob("out.*"):
            file.unlink()
        assert sorted(file.name for file in tmp_path.iterdir()) == sorted(
            [name, "valid", "whole.json", "whole.parquet", "whole.png"]
        ), done
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_MEMORY
