"""HDF5 and npz files against small ones whose pictures and commands are known."""

import zipfile

import numpy as np
import pytest
import recordings as make
from reading import read_all, shows


def test_robomimic(tmp_path):
    recording, episodes, _ = read_all(make.robomimic(tmp_path / "demo.hdf5", [12] * 11))
    assert "robomimic" in recording.format
    assert [episode.name for episode in episodes][1:3] == ["demo_1", "demo_2"]
    shows(episodes[10], first=1000)
    np.testing.assert_array_equal(episodes[10].action, make.commands(12, 2, seed=10))
    assert episodes[0].state.shape == (12, 5)


@pytest.mark.parametrize("coded", [False, True])
def test_aloha(tmp_path, coded):
    recording, episodes, _ = read_all(make.aloha(tmp_path / "aloha", [12, 9], coded))
    assert "ALOHA" in recording.format and recording.cameras == ["observations/images/cam_high"]
    shows(episodes[1], first=100)
    np.testing.assert_array_equal(episodes[1].action, make.commands(9, 14, seed=1))
    np.testing.assert_array_equal(episodes[1].state, make.commands(9, 14, seed=51))


def test_stable_worldmodel(tmp_path):
    recording, episodes, _ = read_all(make.stable_worldmodel(tmp_path / "world.h5", [12, 9]))
    assert "stable-worldmodel" in recording.format
    shows(episodes[1], first=100)
    np.testing.assert_array_equal(episodes[1].action[:-1], make.commands(9, 2, seed=1)[:-1])


def test_hdf5_of_another_layout_by_naming_the_keys(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "own.h5", "w") as file:
        file["log/view"], file["log/motor"], file["log/clock"] = make.pictures(8), make.commands(8), np.arange(8) / 20
    _, _, (entry,) = read_all(tmp_path / "own.h5")
    assert "log/motor (8, 2)" in entry.reason and "--action" in entry.reason
    _, (episode,), _ = read_all(tmp_path / "own.h5", action=["log/motor"], time="log/clock")
    shows(episode)
    np.testing.assert_allclose(episode.times, np.arange(8) / 20)


def test_hdf5_that_claims_more_than_it_holds_is_refused_without_reading_it(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "huge.h5", "w") as file:
        file.create_dataset("pixels", shape=(10**9, 480, 640, 3), dtype="u1", chunks=(1, 480, 640, 3))
        file.create_dataset("action", shape=(10**9, 2), dtype="f4", chunks=(1024, 2))
    _, _, (entry,) = read_all(tmp_path / "huge.h5")
    assert "claims the shape (1000000000, " in entry.reason


def test_npz_with_one_picture_more_than_commands(tmp_path):
    _, (episode,), _ = read_all(make.npz(tmp_path / "episode.npz", 10))
    assert episode.frames.count == 11 and episode.action.shape == (10, 2)
    shows(episode)


def test_nothing_pickled_is_read(tmp_path):
    np.savez(tmp_path / "a.npz", pixels=make.pictures(8), action=np.array([{"a": 1}] * 8, dtype=object))
    _, _, (entry,) = read_all(tmp_path / "a.npz")
    assert "no commands" in entry.reason


def test_npz_that_claims_more_than_it_holds_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", action=make.commands(8))
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive:
        header = b"{'descr': '|u1', 'fortran_order': False, 'shape': (1000000000000, 64, 64, 3), }".ljust(117) + b"\n"
        member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
        archive.writestr("pixels.npy", member)
    _, _, (entry,) = read_all(tmp_path / "a.npz")
    assert "pixels.npy in a.npz claims (1000000000000, 64, 64, 3)" in entry.reason
