"""Reads the small recordings of :mod:`recordings` and says whether they show what was written."""

import numpy as np
import recordings as make

from tsjepa.data.readers import Skipped, Streams, open_recording


def read_all(path, **streams):
    """Episodes and skipped entries of a recording."""
    recording = open_recording(path, Streams(**streams))
    items = list(recording.episodes())
    return recording, [item for item in items if not isinstance(item, Skipped)], [
        item for item in items if isinstance(item, Skipped)
    ]  # fmt: skip


def shows(episode, first=0):
    """Whether the episode's pictures are those of recordings.pictures, forwards and in any order."""
    wanted = make.pictures(episode.frames.count, first=first)
    np.testing.assert_array_equal(episode.frames.read(np.arange(episode.frames.count)), wanted)
    some = np.array([5, 2, 2, episode.frames.count - 1, 0])
    np.testing.assert_array_equal(episode.frames.read(some), wanted[some])
    episode.frames.close()
    np.testing.assert_array_equal(episode.frames.read([3]), wanted[[3]])
