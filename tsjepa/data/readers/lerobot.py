"""LeRobot data sets, v2.0, v2.1 and v3.0."""

from __future__ import annotations

from pathlib import Path

from tsjepa.data.readers import lerobot_v2, lerobot_v3
from tsjepa.data.readers.episode import Streams
from tsjepa.data.readers.lerobot_files import LeRobotFiles


class LeRobot(LeRobotFiles):
    """Reader of a LeRobot data set; see :class:`tsjepa.data.readers.episode.Recording`."""

    @staticmethod
    def matches(path: Path) -> bool:
        return (path / "meta" / "info.json").is_file()

    def __init__(self, path: Path, streams: Streams) -> None:
        super().__init__(path, streams)
        self._episodes = (lerobot_v3 if self.has_v3_layout else lerobot_v2).list_episodes(self)
