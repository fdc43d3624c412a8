import sys

import pytest
import torch
from tensordict import MemoryMappedTensor, TensorDict

from tsjepa.data.frames import Frames, release

MEBIBYTE = 2**20


def numbered(episodes: int, first: int) -> TensorDict:
    number = first + torch.arange(episodes * 5, dtype=torch.uint8).view(episodes, 5)
    return TensorDict({"pixels": number[..., None, None, None].repeat(1, 1, 4, 8, 3)}, batch_size=[episodes, 5])


def test_frames_of_several_splits_come_in_the_order_that_was_asked_for():
    frames = Frames([numbered(2, 0), numbered(1, 100), numbered(3, 200)])
    assert len(frames) == 30
    assert frames[torch.tensor([12, 3, 29, 9, 15])][:, 0, 0, 0].tolist() == [102, 3, 214, 9, 200]
    assert frames[torch.tensor([[1, 0], [3, 3]])][..., 3, 7, 2].tolist() == [[1, 0], [3, 3]]


def resident() -> int:
    with open("/proc/self/status") as file:
        return int(file.read().split("RssFile:")[1].split()[0]) * 1024


@pytest.mark.skipif(sys.platform != "linux", reason="reads the resident memory where Linux tells it")
def test_what_was_read_does_not_stay_resident(tmp_path):
    shape = torch.Size((16, 64, 64, 128, 3))  # 24 MiB
    pixels = MemoryMappedTensor.from_tensor(
        torch.full(shape, 7, dtype=torch.uint8), filename=tmp_path / "pixels.memmap"
    )
    release(pixels)
    before = resident()
    frames = Frames([TensorDict({"pixels": pixels}, batch_size=[16, 64])])
    for start in range(0, 1024, 64):
        assert (frames[torch.arange(start, start + 64)] == 7).all()
    assert resident() - before < 4 * MEBIBYTE
    assert pixels.sum() == 7 * pixels.numel()  # read past the frames: it stays, which shows that the measure sees it
    assert resident() - before > 20 * MEBIBYTE


def test_what_was_written_to_a_map_survives_its_release(tmp_path):
    pixels = MemoryMappedTensor.from_tensor(torch.zeros(1000, 100), filename=tmp_path / "pixels.memmap")
    pixels[3] = 5.0
    release(pixels)
    assert pixels[3].sum() == 500


def test_a_tensor_that_is_no_map_keeps_its_contents():
    values = torch.arange(100_000)
    release(values)
    assert torch.equal(values, torch.arange(100_000))
