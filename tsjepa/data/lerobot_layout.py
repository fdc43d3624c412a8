"""Paths, features and tables of LeRobot v3.0."""

from __future__ import annotations

import json
from pathlib import Path

from tensordict import TensorDict

from tsjepa.support.foreign import optional
from tsjepa.support.spec import PlantSpec

CAMERA = "observation.images.view"
VERSION = "v3.0"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
CODECS = {
    "lossless": ("libx264rgb", "rgb24", "0", "h264", "gbrp"),
    "small": ("libx264", "yuv444p", "10", "h264", "yuv444p"),
}


def features(split: TensorDict, spec: PlantSpec, rate: float, codec: str) -> dict:
    """The features of info.json: shapes, types and the plant's own names."""
    height, width = split["pixels"].shape[2:4]
    _, _, _, name, layout = CODECS[codec]
    found, keys = {}, set(split.keys())
    for key, kind in (("observation.state", "state"), ("action", "action")):
        if kind in keys:
            size = split[kind].shape[-1]
            names = getattr(spec, f"{kind}_names") or [f"{kind}_{column}" for column in range(size)]
            found[key] = {"dtype": "float32", "shape": [size], "names": list(names)}
    found[CAMERA] = {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.codec": name,
            "video.pix_fmt": layout,
            "video.fps": rate,
            "video.channels": 3,
            "is_depth_map": False,
            "has_audio": False,
        },
    }
    for key, dtype in (("timestamp", "float32"), *((key, "int64") for key in
                       ("frame_index", "episode_index", "index", "task_index"))):  # fmt: skip
        found[key] = {"dtype": dtype, "shape": [1], "names": None}
    return found


def write_tasks(path: Path, task: str) -> None:
    """The table of tasks; its index is the task's words, which is how LeRobot's reader (pandas) finds them."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_kind, "metadata": None}
        for name, (kind, numpy_kind) in kinds.items()
    ]
    index = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    write_parquet(path, {"task_index": [0], "task": [task]}, {"pandas": json.dumps(index)})


def write_parquet(path: Path, columns: dict, metadata: dict[str, str] | None = None) -> None:
    pa, parquet = optional("pyarrow"), optional("pyarrow.parquet")
    path.parent.mkdir(parents=True, exist_ok=True)
    table = pa.table(columns)
    parquet.write_table(table.replace_schema_metadata(metadata) if metadata else table, path)
