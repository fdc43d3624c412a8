"""Damages a valid recording in one of the ways in which files from elsewhere are damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import recordings as make

HUGE = 2**40


def base_recordings(folder: Path) -> dict[str, Path]:
    """One small valid recording a format."""
    folder.mkdir(parents=True, exist_ok=True)
    return {
        "lerobot-v2.1": make.lerobot_v2(folder / "lerobot-v2.1", [12, 9]),
        "lerobot-v3.0": make.lerobot_v3(folder / "lerobot-v3.0", [12, 9]),
        "videos": make.videos_and_csv(folder / "videos", [12, 9]),
        "pictures": make.numbered_pictures(folder / "pictures", 12),
        "donkeycar": make.donkeycar(folder / "donkeycar", np.arange(12) / 20),
        "robomimic": make.robomimic(_inside(folder / "robomimic") / "demo.hdf5", [12, 9]).parent,
        "aloha": make.aloha(folder / "aloha", [12, 9]),
        "stable-worldmodel": make.stable_worldmodel(_inside(folder / "world") / "world.h5", [12, 9]).parent,
        "npz": _npz(_inside(folder / "npz")),
        "rosbag-db3": make.rosbag(folder / "rosbag-db3", np.arange(12) / 20),
        "rosbag-mcap": make.rosbag(folder / "rosbag-mcap", np.arange(12) / 20, mcap=True),
    }


def _inside(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _npz(folder: Path) -> Path:
    for episode in range(2):
        make.npz(folder / f"episode_{episode}.npz", 10)
    return folder


def mutate(path: Path, random: np.random.Generator) -> str:
    """Changes one file of the recording at ``path``; returns what was done."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    file = files[random.integers(len(files))]
    kinds: list[Callable[[Path, np.random.Generator], str]] = [_cut, _flip, _empty, _delete, _swap, _pointer]
    content = {
        ".json": _json, ".jsonl": _lines, ".catalog": _lines, ".csv": _csv, ".parquet": _parquet,
        ".hdf5": _hdf5, ".h5": _hdf5, ".npz": _npz_content,
    }.get(file.suffix)  # fmt: skip
    kind = content if content is not None and random.random() < 0.6 else kinds[random.integers(len(kinds))]
    return f"{file.relative_to(path)}: {kind(file, random)}"


def _cut(file: Path, random: np.random.Generator) -> str:
    size = int(random.integers(file.stat().st_size + 1))
    file.write_bytes(file.read_bytes()[:size])
    return f"cut to {size} bytes"


def _flip(file: Path, random: np.random.Generator) -> str:
    data = bytearray(file.read_bytes())
    places = random.integers(max(1, len(data)), size=int(random.integers(1, 9)))
    for place in places[: len(data)]:
        data[place] = int(random.integers(256))
    file.write_bytes(data)
    return f"bytes {places.tolist()} changed"


def _empty(file: Path, random: np.random.Generator) -> str:
    file.write_bytes(b"")
    return "emptied"


def _delete(file: Path, random: np.random.Generator) -> str:
    file.unlink()
    return "deleted"


def _swap(file: Path, random: np.random.Generator) -> str:
    others = [other for other in file.parent.rglob("*") if other.is_file() and other != file]
    if not others:
        return _cut(file, random)
    other = others[random.integers(len(others))]
    aside = file.with_name(file.name + ".aside")
    shutil.move(file, aside), shutil.move(other, file), shutil.move(aside, other)
    return f"swapped with {other.name}"


def _pointer(file: Path, random: np.random.Generator) -> str:
    file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    return "made a pointer"


def _value(random: np.random.Generator) -> object:
    values = [None, -1, 0, HUGE, 1e308, float("nan"), "v9.9", "", [], {}, [[1, 2], [3]], True, "../../x", {"a": [1]}]
    return values[random.integers(len(values))]


def _json(file: Path, random: np.random.Generator) -> str:
    """One value anywhere in the file replaced or removed."""
    lines = file.read_text().splitlines()
    try:
        documents = [json.loads(file.read_text())]
    except ValueError:
        documents = [json.loads(line) for line in lines]
    spots: list[tuple[dict | list, object]] = []

    def walk(node: object) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, child in items:
            spots.append((node, key))
            walk(child)

    walk(documents)
    node, key = spots[random.integers(len(spots))]
    if isinstance(node, dict) and random.random() < 0.3:
        del node[key]
        what = f"{key} removed"
    else:
        node[key] = _value(random)
        what = f"{key} is {node[key]!r}"
    file.write_text("\n".join(json.dumps(document) for document in documents))
    return what


def _lines(file: Path, random: np.random.Generator) -> str:
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    rows, what = _rows(rows, random)
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return what


def _rows(rows: list[dict], random: np.random.Generator) -> tuple[list[dict], str]:
    """Rows removed, shuffled, repeated, or one column spoilt."""
    choice = random.integers(6)
    names = sorted({name for row in rows for name in row})
    name = names[random.integers(len(names))] if names else ""
    if choice == 0:
        return [], "no rows"
    if choice == 1:
        return [rows[place] for place in random.permutation(len(rows))], "rows shuffled"
    if choice == 2:
        return [{**row, name: rows[0].get(name)} for row in rows], f"{name} constant"
    if choice == 3:
        return [{key: value for key, value in row.items() if key != name} for row in rows], f"{name} removed"
    if choice == 4:
        spoilt = _value(random)
        return [
            {**row, name: spoilt} if random.random() < 0.5 else row for row in rows
        ], f"{name} is {spoilt!r} in half"
    first, second = random.choice(names, 2) if names else ("", "")
    return [
        {**row, first: row.get(second), second: row.get(first)} for row in rows
    ], f"{first} and {second} changed over"


def _csv(file: Path, random: np.random.Generator) -> str:
    lines = [line.split(",") for line in file.read_text().splitlines()]
    rows, what = _rows([dict(zip(lines[0], line, strict=True)) for line in lines[1:]], random)
    names = list(rows[0]) if rows else lines[0]
    make.write_csv(file, {name: [row.get(name) for row in rows] for name in names})
    return what


def _parquet(file: Path, random: np.random.Generator) -> str:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    table = parquet.read_table(file)
    rows, what = _rows(table.to_pylist(), random)
    try:
        changed = pa.Table.from_pylist(rows) if rows else table.slice(0, 0)
    except (pa.ArrowException, ValueError, TypeError, OverflowError):
        changed, what = table.slice(0, 1), "one row"
    parquet.write_table(changed, file)
    return what


def _hdf5(file: Path, random: np.random.Generator) -> str:
    import h5py

    with h5py.File(file, "a") as opened:
        names: list[str] = []
        opened.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        name = names[random.integers(len(names))]
        shape, dtype = opened[name].shape, opened[name].dtype
        values = opened[name][:]
        del opened[name]
        choice = random.integers(6)
        if choice == 0:
            return f"{name} removed"
        if choice == 1:
            opened[name] = values[:0]
            return f"{name} has no rows"
        if choice == 2:
            chunks = (1, *shape[1:])
            opened.create_dataset(name, shape=(HUGE, *shape[1:]), dtype=dtype, chunks=chunks)
            return f"{name} claims {HUGE} rows"
        if choice == 3:
            opened[name] = np.full(shape, np.nan, np.float32)
            return f"{name} is NaN"
        if choice == 4:
            opened[name] = values.ravel()
            return f"{name} is flat"
        opened[name] = values[: max(1, len(values) // 2)]
        return f"{name} has half the rows"


def _npz_content(file: Path, random: np.random.Generator) -> str:
    import zipfile

    with np.load(file) as archive:
        arrays = dict(archive)
    name = sorted(arrays)[random.integers(len(arrays))]
    choice = random.integers(5)
    if choice == 0:
        del arrays[name]
    elif choice == 1:
        arrays[name] = arrays[name][:0]
    elif choice == 2:
        arrays[name] = arrays[name].astype(np.float64) * np.nan
    elif choice == 3:
        arrays[name] = arrays[name].ravel()
    np.savez_compressed(file, **arrays)
    if choice == 4:
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({HUGE}, 3), }}".ljust(117).encode() + b"\n"
        with zipfile.ZipFile(file, "a") as archive:
            archive.writestr(f"{name}2.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    return f"{name}: change {choice}"


def base_logs(folder: Path) -> dict[str, Path]:
    """One small valid log of a radio link a kind."""
    folder.mkdir(parents=True, exist_ok=True)
    sent = 1_700_000_000_000_000_000
    packets = [
        {"timestamp": sent + 10**8 * k + 5 * 10**6, "payload": {"seqnum": k, "src_timestamp_ns": str(sent + 10**8 * k)}}
        for k in range(30)
        if k % 7
    ]
    texts = {
        "table.txt": "pub_time(ms) delay(ms) sinr(db)\n"
        + "".join(f"{1_700_000_000_000 + 55 * k} {20 + k % 9} {k % 20} \n" for k in range(30)),
        "packets.jsonl": "".join(json.dumps(row) + "\n" for row in packets),
        "ping.txt": "".join(
            f"64 bytes from host: icmp_seq={k} ttl=60 time={10 + k % 5}.5 ms\n" for k in range(30) if k % 6
        ),
        "iperf.txt": "".join(
            f"[  5]   {k}.00-{k + 1}.00   sec   128 KBytes  1.05 Mbits/sec  0.045 ms  {k}/100 ({k}%)\n"
            for k in range(9)
        ),
        "iw.jsonl": "".join(
            json.dumps({"timestamp": sent + 5 * 10**8 * k, "payload": {"phy": f"SSID: a\n\tsignal: -{60 + k} dBm"}})
            + "\n"
            for k in range(20)
        ),
        "link.trace": "".join(f"{3 * k + k % 2}\n" for k in range(90)),
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    return {name: folder / name for name in texts}


def mutate_log(file: Path, random: np.random.Generator) -> str:
    """Changes a log: its bytes, its lines, or one of its words."""
    choice = random.integers(6)
    if choice < 3:
        return (_cut, _flip, _pointer)[choice](file, random)
    lines = file.read_text().splitlines()
    place = int(random.integers(len(lines)))
    if choice == 3:
        file.write_text("\n".join(lines[other] for other in random.permutation(len(lines))))
        return "lines shuffled"
    if choice == 4:
        del lines[place]
    else:
        words = lines[place].split(" ")
        words[random.integers(len(words))] = str(_value(random))
        lines[place] = " ".join(words)
    file.write_text("\n".join(lines))
    return f"line {place + 1} changed"
