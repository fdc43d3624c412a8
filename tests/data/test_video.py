"""What a video's header says about range, matrix, size and rotation reaches the pictures."""

import numpy as np
import pytest
import recordings as make

from tsjepa.data.readers.video import Video

av = pytest.importorskip("av")


def write_yuv(path, y, u, v, color_range, colorspace=5, height=16, width=24):
    """A video of one colour in full chroma, given as its samples."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=20)
        stream.height, stream.width, stream.pix_fmt, stream.options = height, width, "yuv444p", {"crf": "0"}
        stream.codec_context.color_range, stream.codec_context.colorspace = color_range, colorspace
        for _ in range(3):
            planes = np.stack([np.full((height, width), sample, np.uint8) for sample in (y, u, v)])
            frame = av.VideoFrame.from_ndarray(planes, format="yuv444p")
            frame.color_range, frame.colorspace = color_range, colorspace
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("color_range", "luma", "grey"),
    [(1, 16, 0), (1, 235, 255), (1, 126, 128), (2, 16, 16), (2, 235, 235), (2, 128, 128)],
)
def test_full_and_limited_range(tmp_path, color_range, luma, grey):
    """Limited range maps 16..235 to 0..255 (ITU-R BT.601, 2.5.1), full range is as it stands."""
    picture = Video(write_yuv(tmp_path / "a.mp4", luma, 128, 128, color_range)).read([1])[0]
    np.testing.assert_allclose(picture, grey, atol=1)


@pytest.mark.parametrize(("colorspace", "kr", "kb"), [(5, 0.299, 0.114), (1, 0.2126, 0.0722)])
def test_the_colour_matrix_is_that_of_the_header(tmp_path, colorspace, kr, kb):
    """BT.601 and BT.709: R = Y + 2 (1 - kr) Cr, B = Y + 2 (1 - kb) Cb, G from Y = kr R + kg G + kb B."""
    y, u, v = 110, 100, 170
    red, blue = y + 2 * (1 - kr) * (v - 128), y + 2 * (1 - kb) * (u - 128)
    green = (y - kr * red - kb * blue) / (1 - kr - kb)
    picture = Video(write_yuv(tmp_path / "a.mp4", y, u, v, 2, colorspace)).read([0])[0]
    np.testing.assert_allclose(picture[8, 8], [red, green, blue], atol=2)


def test_odd_sizes(tmp_path):
    frames = make.pictures(5, 13, 17)
    np.testing.assert_array_equal(Video(make.write_video(tmp_path / "a.mp4", frames)).read(range(5)), frames)


@pytest.mark.parametrize(
    ("matrix", "turns"),
    [((0, 1, -1, 0), 3), ((-1, 0, 0, -1), 2), ((0, -1, 1, 0), 1)],
)
def test_a_rotation_flag_turns_the_picture(tmp_path, matrix, turns):
    """The matrix (a, b, c, d) of the track header maps x to a x + c y: (0, 1, -1, 0) shows it a quarter clockwise."""
    frames = make.pictures(4)
    path = make.write_video(tmp_path / "a.mp4", frames)
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    a, b, c, d = (int(value * 65536).to_bytes(4, "big", signed=True) for value in matrix)
    zero, one = bytes(4), (1 << 30).to_bytes(4, "big")
    data[at : at + 36] = a + b + zero + c + d + zero + zero + zero + one
    path.write_bytes(data)
    video = Video(path)
    assert (video.height, video.width) == ((24, 16) if turns % 2 else (16, 24))
    np.testing.assert_array_equal(video.read([2])[0], np.rot90(frames[2], turns))


def test_pictures_are_the_same_in_any_order_and_across_key_frames(tmp_path):
    frames = make.pictures(300)
    video = Video(make.write_video(tmp_path / "a.mp4", frames))
    assert video.count == 300
    for index in (299, 0, 130, 131, 12, 290, 290):
        np.testing.assert_array_equal(video.read([index])[0], frames[index])


def test_a_video_whose_end_is_missing_is_counted_by_what_is_there(tmp_path):
    path = make.write_video(tmp_path / "a.mkv", make.pictures(60))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    video = Video(path)
    assert 0 < video.count < 60
    np.testing.assert_array_equal(video.read([0])[0], make.pictures(1)[0])


def test_what_is_no_video_is_refused_in_one_sentence(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"not a video at all" * 100)
    with pytest.raises(ValueError, match=r"a\.mp4 is no video"):
        Video(tmp_path / "a.mp4")
