"""Writes small recordings in the formats of others, with the libraries that those formats' own tools use."""

from __future__ import annotations

import csv
import json
import os
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

WILD = Path(os.environ.get("TSJEPA_WILD", Path(__file__).parents[2] / "shared" / "wild"))


def wild(part: str) -> Path:
    """A public file that nobody of this project made; skips the test where it is absent."""
    if not (WILD / part).exists():
        pytest.skip(f"{part} is not there; set TSJEPA_WILD to the folder that holds it")
    return WILD / part


def pictures(count: int, height: int = 16, width: int = 24, first: int = 0) -> np.ndarray:
    """uint8 [count, H, W, 3]; picture k shows a bar whose place and colour tell k."""
    frames = np.full((count, height, width, 3), 20, np.uint8)
    for place in range(count):
        number = first + place
        frames[place, :, number % width] = (50 + number % 200, 240 - number % 150, 120)
        frames[place, 0, 0] = (number % 256, number // 256, 7)
    return frames


def commands(count: int, width: int = 2, seed: int = 0) -> np.ndarray:
    """float32 [count, width]."""
    return np.random.default_rng(seed).normal(size=(count, width)).astype(np.float32)


def write_video(path: Path, frames: np.ndarray, rate: int | Fraction = 20, codec: str = "libx264rgb") -> Path:
    """Lossless by default."""
    av = pytest.importorskip("av")
    path.parent.mkdir(parents=True, exist_ok=True)
    lossless = codec == "libx264rgb"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "rgb24" if lossless else "yuv420p"
        stream.options = {"crf": "0"} if lossless else {}
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


def write_csv(path: Path, columns: dict[str, list]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def write_parquet(path: Path, columns: dict) -> Path:
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path.parent.mkdir(parents=True, exist_ok=True)
    lists = {name: list(column) for name, column in columns.items()}
    parquet.write_table(pa.table({name: pa.array(column) for name, column in lists.items()}), path)
    return path


def _info(version: str, episodes: int, lengths: list[int], size: tuple[int, int], rate: int, **paths: str) -> dict:
    return {
        "codebase_version": version,
        "fps": rate,
        "total_episodes": episodes,
        "total_frames": sum(lengths),
        "chunks_size": 1000,
        "features": {
            "action": {"dtype": "float32", "shape": [2], "names": ["left_n", "right_n"]},
            "observation.state": {"dtype": "float32", "shape": [3], "names": ["x_m", "v_m_s", "angle"]},
            "observation.images.front": {"dtype": "video", "shape": [*size, 3]},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        },
        **paths,
    }


def lerobot_v2(path: Path, lengths: list[int], rate: int = 20, version: str = "v2.1") -> Path:
    """LeRobot v2.x with lossless videos."""
    for episode, length in enumerate(lengths):
        frames = pictures(length, first=100 * episode)
        write_video(path / f"videos/chunk-000/observation.images.front/episode_{episode:06d}.mp4", frames, rate)
        write_parquet(
            path / f"data/chunk-000/episode_{episode:06d}.parquet",
            _rows(episode, length, rate, start=sum(lengths[:episode])),
        )
    meta = path / "meta"
    meta.mkdir(parents=True)
    info = _info(
        version, len(lengths), lengths, frames.shape[1:3], rate,
        data_path="data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        video_path="videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    )  # fmt: skip
    (meta / "info.json").write_text(json.dumps(info))
    lines = [json.dumps({"episode_index": episode, "length": length}) for episode, length in enumerate(lengths)]
    (meta / "episodes.jsonl").write_text("\n".join(lines) + "\n")
    return path


def _rows(episode: int, length: int, rate: int, start: int) -> dict:
    return {
        "action": commands(length, 2, seed=episode),
        "observation.state": commands(length, 3, seed=100 + episode),
        "timestamp": (np.arange(length) / rate).astype(np.float32),
        "frame_index": np.arange(length),
        "episode_index": np.full(length, episode),
        "index": start + np.arange(length),
    }


def lerobot_v3(path: Path, lengths: list[int], rate: int = 20) -> Path:
    """LeRobot v3.0: all episodes in one Parquet file and one lossless video."""
    parts = [_rows(episode, length, rate, sum(lengths[:episode])) for episode, length in enumerate(lengths)]
    rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    write_parquet(path / "data/chunk-000/file-000.parquet", rows)
    frames = np.concatenate([pictures(length, first=100 * episode) for episode, length in enumerate(lengths)])
    write_video(path / "videos/observation.images.front/chunk-000/file-000.mp4", frames, rate)
    ends = np.cumsum(lengths)
    zeros = np.zeros(len(lengths), np.int64)
    write_parquet(
        path / "meta/episodes/chunk-000/file-000.parquet",
        {
            "episode_index": np.arange(len(lengths)),
            "length": np.array(lengths),
            "data/chunk_index": zeros,
            "data/file_index": zeros,
            "dataset_from_index": ends - lengths,
            "dataset_to_index": ends,
            "videos/observation.images.front/chunk_index": zeros,
            "videos/observation.images.front/file_index": zeros,
            "videos/observation.images.front/from_timestamp": (ends - lengths) / rate,
            "videos/observation.images.front/to_timestamp": ends / rate,
        },
    )
    info = _info(
        "v3.0", len(lengths), lengths, frames.shape[1:3], rate,
        data_path="data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        video_path="videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    )  # fmt: skip
    (path / "meta" / "info.json").write_text(json.dumps(info))
    return path


def videos_and_csv(path: Path, lengths: list[int], rate: int = 20) -> Path:
    """One MP4 and one CSV of the same name an episode."""
    for episode, length in enumerate(lengths):
        write_video(path / f"run_{episode}.mp4", pictures(length, first=100 * episode), rate)
        action = commands(length, 1, seed=episode)
        columns = {"time_s": [f"{k / rate:.6f}" for k in range(length)], "action(N)": action[:, 0].tolist()}
        write_csv(path / f"run_{episode}.csv", columns)
    return path


def numbered_pictures(path: Path, count: int, rate: int = 20) -> Path:
    """1.png, 2.png, ... without leading zeros, and JSON lines."""
    path.mkdir(parents=True)
    for number, frame in enumerate(pictures(count), 1):
        cv2.imwrite(str(path / f"frame{number}.png"), frame[..., ::-1])
    action = commands(count, 1)
    rows = [{"t": number / rate, "action": float(action[number, 0]), "pos_m": number} for number in range(count)]
    (path / "rows.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


def donkeycar(path: Path, times: np.ndarray, sessions: list[str] | None = None, catalogs: int = 1) -> Path:
    """A tub v2 with one record a time (seconds); the manifest names ``catalogs`` of which one is there."""
    (path / "images").mkdir(parents=True)
    records = []
    action = commands(len(times), 2)
    for index, stamp in enumerate(times):
        name = f"{index}_cam_image_array_.jpg"
        cv2.imwrite(str(path / "images" / name), pictures(1, first=index)[0])
        records.append(
            {
                "_index": index,
                "_session_id": sessions[index] if sessions else "one",
                "_timestamp_ms": int(1_700_000_000_000 + round(1000 * stamp)),
                "cam/image_array": name,
                "user/angle": float(action[index, 0]),
                "user/throttle": float(action[index, 1]),
                "user/mode": "user",
            }
        )
    (path / "catalog_0.catalog").write_text("".join(json.dumps(record) + "\n" for record in records))
    names = [f"catalog_{number}.catalog" for number in range(catalogs)]
    lines = [
        ["cam/image_array", "user/angle", "user/throttle", "user/mode"],
        ["image_array", "float", "float", "str"],
        {},
        {"created_at": 1_700_000_000.0},
        {"paths": names, "current_index": len(times), "max_len": 1000, "deleted_indexes": []},
    ]
    (path / "manifest.json").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def robomimic(path: Path, lengths: list[int]) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for episode, length in enumerate(lengths):
            demo = file.create_group(f"data/demo_{episode}")
            demo.attrs["num_samples"] = length
            demo["actions"] = commands(length, 2, seed=episode).astype(np.float64)
            demo["obs/agentview_image"] = pictures(length, first=100 * episode)
            demo["states"] = commands(length, 5, seed=episode)
    return path


def aloha(path: Path, lengths: list[int], coded: bool = False) -> Path:
    """One file an episode; pictures raw, or as padded JPEG (here PNG, to compare bits)."""
    h5py = pytest.importorskip("h5py")
    path.mkdir(parents=True)
    for episode, length in enumerate(lengths):
        with h5py.File(path / f"episode_{episode}.hdf5", "w") as file:
            file.attrs["sim"] = True
            file["action"] = commands(length, 14, seed=episode)
            file["observations/qpos"] = commands(length, 14, seed=50 + episode)
            frames = pictures(length, first=100 * episode)
            if coded:
                codes = [cv2.imencode(".png", frame[..., ::-1])[1].ravel() for frame in frames]
                longest = max(map(len, codes))
                frames = np.stack([np.pad(code, (0, longest - len(code))) for code in codes])
            file["observations/images/cam_high"] = frames
    return path


def stable_worldmodel(path: Path, lengths: list[int]) -> Path:
    """Flat arrays with ep_len and ep_offset; the last command of an episode is NaN, as its recorder leaves it."""
    h5py = pytest.importorskip("h5py")
    parts = []
    for episode, length in enumerate(lengths):
        part = commands(length, 2, seed=episode)
        part[-1] = np.nan
        parts.append(part)
    with h5py.File(path, "w") as file:
        frames = np.concatenate([pictures(length, first=100 * episode) for episode, length in enumerate(lengths)])
        file["pixels"] = frames.transpose(0, 3, 1, 2)
        file["action"] = np.concatenate(parts)
        file["ep_len"] = np.array(lengths)
        file["ep_offset"] = np.cumsum(lengths) - lengths
    return path


def npz(path: Path, length: int) -> Path:
    """One episode with one picture more than commands."""
    np.savez_compressed(path, pixels=pictures(length + 1), action=commands(length, 2), time=np.arange(length) * 0.05)
    return path


def rosbag(path: Path, times: np.ndarray, mcap: bool = False) -> Path:
    """A ROS 2 bag with raw pictures at ``times`` and a Twist 10 ms before each."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")
    plugin = rosbag2.StoragePlugin.MCAP if mcap else rosbag2.StoragePlugin.SQLITE3
    action = commands(len(times), 1)
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        image = writer.add_connection("/camera/image_raw", "sensor_msgs/msg/Image", typestore=store)
        twist = writer.add_connection("/cmd_vel", "geometry_msgs/msg/Twist", typestore=store)
        for index, (seconds, frame) in enumerate(zip(times, pictures(len(times)), strict=True)):
            vector = types["geometry_msgs/msg/Vector3"]
            message = types["geometry_msgs/msg/Twist"](
                linear=vector(x=float(action[index, 0]), y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0)
            )
            nanoseconds = 1_700_000_000_000_000_000 + round(1e9 * seconds)
            writer.write(twist, nanoseconds - 10_000_000, store.serialize_cdr(message, message.__msgtype__))
            picture = types["sensor_msgs/msg/Image"](
                header=header, height=frame.shape[0], width=frame.shape[1], encoding="bgr8", is_bigendian=0,
                step=frame.shape[1] * 3, data=np.ascontiguousarray(frame[..., ::-1]).ravel(),
            )  # fmt: skip
            writer.write(image, nanoseconds, store.serialize_cdr(picture, picture.__msgtype__))
    return path
