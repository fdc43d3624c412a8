"""``tsjepa export-data``: a data set as LeRobot v3.0, with video that loses nothing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
from tensordict import TensorDict

from tsjepa.data.lerobot_layout import (
    CAMERA,
    CODECS,
    DATA_PATH,
    EPISODES_PATH,
    VERSION,
    VIDEO_PATH,
    features,
    write_parquet,
    write_tasks,
)
from tsjepa.data.lerobot_stats import Statistics
from tsjepa.data.storage import open_split, read_metadata, spec_of
from tsjepa.support.files import refuse_to_replace, replace_folder
from tsjepa.support.foreign import optional


def export_data(
    path: str, output: str, task: str = "control the machine", codec: str = "lossless", overwrite: bool = False
) -> Path:
    """Writes a data set as LeRobot v3.0: Parquet rows, one MP4 and one Parquet file a split, and the metadata.

    The row of a trajectory's last picture has the command zero, as in the data set: its result is not recorded. What
    LeRobot has no place for (the expert's command, references, scenes) is left out.

    Args:
        path: folder of the data set.
        output: folder to write.
        task: what the machine does, in words; LeRobot wants it.
        codec: "lossless" (H.264 in RGB, CRF 0: bit for bit) or "small" (H.264 4:4:4, CRF 10).
        overwrite: replace what is there.

    Raises:
        FileNotFoundError, FileExistsError, ValueError: see the sentence.
        ModuleNotFoundError: the optional packages are not installed.
    """
    if codec not in CODECS:
        raise ValueError(f"codec is {codec}; it is one of {', '.join(CODECS)}.")
    optional("av"), optional("pyarrow")
    folder = Path(output)
    if folder.exists() and not overwrite:
        raise FileExistsError(f"{folder} exists; pass --overwrite true to replace it, or choose another folder.")
    refuse_to_replace(folder, "LeRobot data set", "meta/info.json")
    metadata = read_metadata(path)
    partial = folder.with_name(folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        info = _write(Path(path), partial, metadata, task, codec)
        replace_folder(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    print(
        f"{folder}: {info['total_episodes']} episodes of LeRobot {VERSION}, slots of {spec_of(metadata).slot:.6g} s, "
        f"{info['total_frames']} pictures, episodes of the splits: "
        f"{', '.join(f'{name} {span}' for name, span in info['splits'].items())}."
    )
    return folder


def _write(path: Path, folder: Path, metadata: dict, task: str, codec: str) -> dict:
    """Writes all files; returns what ``meta/info.json`` says."""
    spec = spec_of(metadata)
    rate = Fraction(1 / spec.slot).limit_denominator(10_000)  # of rows and video alike: LeRobot compares their times
    spans, entries, start = {}, [], 0
    whole = Statistics()
    for index, name in enumerate(metadata["splits"]):
        split = open_split(path, name)
        first = len(entries)
        entries += _write_split(folder, split, index, first, start, rate, codec, whole)
        start += split.shape[0] * split.shape[1]
        spans[name] = f"{first}:{len(entries)}"
    for number, entry in enumerate(entries):
        entry |= {
            "tasks": [task],
            "episode_index": number,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
    write_parquet(folder / EPISODES_PATH, {key: [entry[key] for entry in entries] for key in entries[0]})
    write_tasks(folder / "meta/tasks.parquet", task)
    (folder / "meta/stats.json").write_text(json.dumps(whole.summary(), indent=4) + "\n")
    info = {
        "codebase_version": VERSION,
        "robot_type": str((metadata.get("plant") or {}).get("class_path", "unknown")).rpartition(".")[2],
        "total_episodes": len(entries),
        "total_frames": start,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": _plain(rate),
        "splits": spans,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH,
        "features": features(split, spec, _plain(rate), codec),
    }
    (folder / "meta/info.json").write_text(json.dumps(info, indent=4) + "\n")
    return info


def _plain(rate: Fraction) -> int | float:
    """Pictures a second; LeRobot wants a whole number where it is one."""
    return int(rate) if rate.denominator == 1 else float(rate)


def _write_split(
    folder: Path, split: TensorDict, index: int, first: int, start: int, rate: Fraction, codec: str, whole: Statistics
) -> list[dict]:
    """Rows and pictures of one split; returns an entry of meta/episodes for every trajectory."""
    count, frames = split.batch_size
    _video(folder / VIDEO_PATH.format(video_key=CAMERA, chunk_index=0, file_index=index), split, rate, codec)
    rows: dict[str, list] = {}
    entries = []
    for trajectory in range(count):
        part = {
            "action": split["action"][trajectory].numpy(),
            **({"observation.state": split["state"][trajectory].numpy()} if "state" in set(split.keys()) else {}),
            "timestamp": (np.arange(frames) / float(rate)).astype(np.float32),
            "frame_index": np.arange(frames),
            "episode_index": np.full(frames, first + trajectory),
            "index": start + trajectory * frames + np.arange(frames),
            "task_index": np.zeros(frames, np.int64),
        }
        for key, column in part.items():
            rows.setdefault(key, []).append(column)
        own = Statistics()
        for statistics in (own, whole):
            for key, column in part.items():
                statistics.add(key, column.reshape(frames, -1))
            statistics.add_pictures(CAMERA, split["pixels"][trajectory].numpy())
        at = trajectory * frames
        entries.append(
            {
                "length": frames,
                "data/chunk_index": 0,
                "data/file_index": index,
                "dataset_from_index": start + at,
                "dataset_to_index": start + at + frames,
                f"videos/{CAMERA}/chunk_index": 0,
                f"videos/{CAMERA}/file_index": index,
                f"videos/{CAMERA}/from_timestamp": float(at / rate),
                f"videos/{CAMERA}/to_timestamp": float((at + frames) / rate),
                **{f"stats/{key}/{name}": value for key, stat in own.summary().items() for name, value in stat.items()},
            }
        )
    _rows(folder / DATA_PATH.format(chunk_index=0, file_index=index), rows)
    return entries


def _video(path: Path, split: TensorDict, rate: Fraction, codec: str) -> None:
    av = optional("av")
    path.parent.mkdir(parents=True, exist_ok=True)
    encoder, layout, crf, _, _ = CODECS[codec]
    pixels = split["pixels"]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(encoder, rate=rate)
        stream.height, stream.width, stream.pix_fmt = pixels.shape[2], pixels.shape[3], layout
        stream.options = {"crf": crf, "g": "10"}
        for picture in _pictures(pixels):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def _pictures(pixels) -> Iterator[np.ndarray]:
    for trajectory in range(len(pixels)):
        yield from np.ascontiguousarray(pixels[trajectory].numpy())


def _rows(path: Path, rows: dict[str, list[np.ndarray]]) -> None:
    """Rows with columns of fixed width, and of plain numbers where the width is one, as LeRobot writes them."""
    pa = optional("pyarrow")
    columns = {}
    for key, parts in rows.items():
        column = np.concatenate(parts)
        if column.ndim == 1 or column.shape[1] == 1:
            columns[key] = pa.array(column.ravel())
        else:
            columns[key] = pa.FixedSizeListArray.from_arrays(pa.array(column.ravel()), column.shape[1])
    write_parquet(path, columns)
