"""ROS 2 bags against small ones whose pictures and commands are known."""

import numpy as np
import pytest
import recordings as make
from reading import read_all, shows

from tsjepa.data.readers import open_recording
from tsjepa.data.readers.bounded import BoundedPath


@pytest.mark.parametrize("mcap", [False, True])
def test_ros_2_bags(tmp_path, mcap):
    times = np.arange(12) / 20
    recording, (episode,), _ = read_all(make.rosbag(tmp_path / "bag", times, mcap))
    assert recording.format == f"ROS 2 bag ({'mcap' if mcap else 'db3'})"
    shows(episode)
    np.testing.assert_array_equal(episode.action[:, 0], make.commands(12, 1)[:, 0])
    assert episode.action_names[0] == "cmd_vel/linear.x" and episode.action.shape == (12, 6)
    np.testing.assert_allclose(episode.frames.times - episode.times, 0.01, atol=1e-6)
    _, (episode,), _ = read_all(tmp_path / "bag", action=["/cmd_vel/linear/x"], camera="/camera/image_raw")
    assert episode.action_names == ["cmd_vel/linear.x"]


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_a_bag_without_its_metadata(tmp_path, suffix):
    bag = make.rosbag(tmp_path / "bag", np.arange(12) / 20, suffix == "mcap")
    (bag / "metadata.yaml").unlink()
    _, (episode,), _ = read_all(next(bag.glob(f"*.{suffix}")))
    shows(episode)


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_a_folder_of_a_bag_without_its_metadata(tmp_path, suffix):
    bag = make.rosbag(tmp_path / "bag", np.arange(12) / 20, suffix == "mcap")
    (bag / "metadata.yaml").unlink()
    _, (episode,), _ = read_all(bag)
    shows(episode)


def test_a_bounded_file_takes_no_memory_for_bytes_that_it_does_not_have(tmp_path):
    (tmp_path / "a.bin").write_bytes(bytes(range(100)))
    with BoundedPath(tmp_path / "a.bin").open("rb") as file:
        assert file.read(10) == bytes(range(10)) and file.read(1 << 62) == bytes(range(10, 100))


def test_an_mcap_record_that_claims_more_than_the_file_is_refused(tmp_path):
    """The length of its first record is 2^62; the same file without the claim is read."""
    bag = make.rosbag(tmp_path / "bag", np.arange(12) / 20, mcap=True)
    (bag / "metadata.yaml").unlink()
    (file,) = bag.glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[9:17] = (1 << 62).to_bytes(8, "little")
    file.write_bytes(data)
    with pytest.raises(ValueError, match="Truncated record at offset 17"):
        open_recording(file)
