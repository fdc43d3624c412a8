"""ROS 2 bags (.db3 and .mcap) and ROS 1 bags, through the package rosbags; no ROS is needed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from tsjepa.data.readers.bounded import BoundedPath
from tsjepa.data.readers.episode import Episode, Frames, Skipped, Streams, attempt, check_picture_size
from tsjepa.data.readers.names import units_of
from tsjepa.data.readers.pictures import decode_picture, natural
from tsjepa.support.foreign import optional, refuse_pointers

SUFFIXES = (".db3", ".mcap", ".bag")
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
COMMANDS = (
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "ackermann_msgs/msg/AckermannDrive",
    "ackermann_msgs/msg/AckermannDriveStamped",
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/Float32MultiArray",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Float32",
    "trajectory_msgs/msg/JointTrajectoryPoint",
)
CHANNELS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "8UC3": 3}


class RosBag:
    """Reader of a bag, which is one episode; see :class:`tsjepa.data.readers.episode.Recording`.

    ``camera`` and ``action`` are topics (an action may be ``/topic`` or ``/topic/field``). Times are those at which the
    bag received a message.
    """

    rate_hz = None

    @staticmethod
    def matches(path: Path) -> bool:
        if path.is_file():
            return path.suffix in SUFFIXES
        return any(file.suffix in (".db3", ".mcap") for file in path.iterdir())

    def __init__(self, path: Path, streams: Streams) -> None:
        self.path, self.streams, self.notes = path, streams, []
        files = [path] if path.is_file() else [file for file in path.iterdir() if file.suffix in SUFFIXES]
        refuse_pointers(files)
        self.source = path
        if path.is_file() and path.suffix in (".db3", ".mcap") and (path.parent / "metadata.yaml").is_file():
            self.source = path.parent
        with open_bag(self.source) as bag:
            self.topics = {name: topic.msgtype or "" for name, topic in bag.topics.items()}
        suffix = "ROS 1" if files[0].suffix == ".bag" else "ROS 2"
        self.format = f"{suffix} bag ({files[0].suffix[1:]})"
        self.cameras = [name for name, kind in self.topics.items() if kind in IMAGES]
        listed = ", ".join(f"{name} ({kind})" for name, kind in self.topics.items()) or "nothing"
        self.camera = self._choose(streams.camera, self.cameras, "picture", "--camera", listed)
        commands = [name for name, kind in self.topics.items() if kind in COMMANDS]
        wanted = streams.action or [self._choose(None, commands, "command", "--action", listed)]
        self.actions, self.states = ([self._topic(name, listed) for name in names] for names in
                                     (wanted, streams.state or []))  # fmt: skip

        taken = {self.camera, *(topic for topic, _ in [*self.actions, *self.states])}
        self.others = [f"{name} ({kind})" for name, kind in self.topics.items() if name not in taken]

    def _choose(self, wanted: str | None, candidates: list[str], what: str, option: str, listed: str) -> str:
        if wanted is not None:
            if wanted not in self.topics:
                raise ValueError(f"There is no topic {wanted}; the bag has {listed}.")
            return wanted
        if len(candidates) != 1:
            raise ValueError(f"{len(candidates)} topics are of a {what}: name one ({option}) of {listed}.")
        return candidates[0]

    def _topic(self, name: str, listed: str) -> tuple[str, str]:
        """Topic and field of ``/topic/field``."""
        for topic in sorted(self.topics, key=len, reverse=True):
            if name == topic or name.startswith(topic + "/"):
                return topic, name[len(topic) + 1 :].replace("/", ".")
        raise ValueError(f"There is no topic {name}; the bag has {listed}.")

    def episodes(self) -> Iterator[Episode | Skipped]:
        """The bag as one episode."""
        yield attempt(self.path.name, self._episode)

    def _episode(self) -> Episode:
        names, action, times = self._series(self.actions)
        episode = Episode(
            name=self.path.name,
            frames=BagPictures(self.source, self.camera),
            action=action,
            action_names=names,
            action_units=units_of(names),
            times=times,
        )
        if self.states:
            state_names, state, state_times = self._series(self.states)
            newest = np.searchsorted(state_times, times, side="right") - 1
            held = state[newest.clip(0)]
            held[newest < 0] = np.nan
            episode.state, episode.state_names, episode.state_units = held, state_names, units_of(state_names)
        return episode

    def _series(self, topics: list[tuple[str, str]]) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Names, values [R, m] and times [R] of the numbers in the messages of some topics.

        A row stands for every message of the first topic; the others are held.
        """
        stamps: dict[str, list[float]] = {topic: [] for topic, _ in topics}
        rows: dict[str, list[dict[str, float]]] = {topic: [] for topic, _ in topics}
        with open_bag(self.source) as bag:
            chosen = [connection for connection in bag.connections if connection.topic in stamps]
            for connection, stamp, raw in bag.messages(connections=chosen):
                message = bag.deserialize(raw, connection.msgtype)
                stamps[connection.topic].append(stamp)
                rows[connection.topic].append(dict(numbers(message)))
        lead = topics[0][0]
        if not rows[lead]:
            raise ValueError(f"the topic {lead} has no message.")
        times = np.array(stamps[lead], np.int64)
        names, columns = [], []
        for topic, field in topics:
            keys = [key for key in (rows[topic] or [{}])[0] if not field or key == field or key.startswith(field + ".")]
            if not keys:
                raise ValueError(f"the topic {topic} has no number{' ' + field if field else ''}.")
            newest = np.searchsorted(np.array(stamps[topic], np.int64), times, side="right") - 1
            for key in keys:
                names.append(f"{topic.strip('/')}/{key}")
                values = np.array([row.get(key, np.nan) for row in rows[topic]])
                columns.append(np.where(newest >= 0, values[newest.clip(0)], np.nan))
        return names, np.stack(columns, axis=1).astype(np.float32), times * 1e-9


def open_bag(path: Path):
    """A bag opened through rosbags; a bag without message definitions is read as ROS 2 Humble's."""
    highlevel, typesys = optional("rosbags.highlevel"), optional("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    paths = [path]
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        paths = sorted((file for file in path.iterdir() if file.suffix in SUFFIXES), key=natural)
    return highlevel.AnyReader([BoundedPath(part) for part in paths], default_typestore=store)


def numbers(message: object, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a message by its path; headers are left out."""
    for name in getattr(message, "__dataclass_fields__", ()):
        value = getattr(message, name)
        if name in ("header", "layout", "covariance") or name.startswith("__"):
            continue
        if isinstance(value, (bool, int, float, np.number)):
            yield prefix + name, float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size <= 256:
            for place, number in enumerate(value.ravel()):
                yield f"{prefix}{name}.{place}", float(number)
        elif hasattr(value, "__dataclass_fields__"):
            yield from numbers(value, f"{prefix}{name}.")


class BagPictures(Frames):
    """Pictures of one topic, read in the order of the bag."""

    def __init__(self, source: Path, topic: str) -> None:
        self.source, self.topic = source, topic
        with open_bag(source) as bag:
            chosen = [connection for connection in bag.connections if connection.topic == topic]
            stamps = np.array([stamp for _, stamp, _ in bag.messages(connections=chosen)], np.int64)
        self.count = len(stamps)
        if not self.count:
            raise ValueError(f"the topic {topic} has no picture.")
        self.times = stamps * 1e-9
        self._bag = self._messages = None
        self._at = -1
        first = self._next()
        self.height, self.width = first.shape[:2]

    def _next(self) -> np.ndarray:
        if self._bag is None:
            self._bag = open_bag(self.source)
            self._bag.open()
            chosen = [connection for connection in self._bag.connections if connection.topic == self.topic]
            self._messages, self._at = self._bag.messages(connections=chosen), -1
        connection, _, raw = next(self._messages)
        self._at += 1
        message = self._bag.deserialize(raw, connection.msgtype)
        self.coding = getattr(message, "encoding", None) or message.format
        self._picture = to_rgb(message, f"picture {self._at} of {self.topic}")
        return self._picture

    def read(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        pictures = np.empty((len(indices), self.height, self.width, 3), np.uint8)
        for place, index in enumerate(indices):
            if index < self._at:
                self.close()
            while self._at < index:
                self._next()
            if self._picture.shape != pictures.shape[1:]:
                raise ValueError(f"picture {int(index)} of {self.topic} has another size than the first.")
            pictures[place] = self._picture
        return pictures

    def close(self) -> None:
        if self._bag is not None:
            self._bag.close()
        self._bag = self._messages = None
        self._at = -1


def to_rgb(message: object, name: str) -> np.ndarray:
    """RGB uint8 [H, W, 3] of an Image or a CompressedImage.

    Raises:
        ValueError: its encoding is not known, or its data is not as long as its size says.
    """
    if not hasattr(message, "encoding"):
        return decode_picture(bytes(message.data), name)
    channels = CHANNELS.get(message.encoding)
    if channels is None:
        raise ValueError(f"{name} has the encoding {message.encoding}; known are {', '.join(CHANNELS)}.")
    check_picture_size(message.width, message.height, name)
    if len(message.data) < message.step * message.height or message.step < message.width * channels:
        raise ValueError(f"{name} is {message.width} x {message.height} pixels and holds {len(message.data)} bytes.")
    rows = np.asarray(message.data)[: message.step * message.height].reshape(message.height, message.step)
    picture = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    if channels == 1:
        return np.repeat(picture, 3, axis=-1)
    picture = picture[..., :3]
    return picture[..., ::-1] if message.encoding in ("bgr8", "bgra8", "8UC3") else picture
