"""A figure whose points are sums of random numbers, for tests of the sweep: importable by its workers too."""

import os
import signal
from pathlib import Path

import torch

MEASURES = ("value",)
TITLE, CAPTION = "Toy", "Random numbers."


def points(count: int, folder: str) -> list[dict]:
    return [{"x": x, "seeds": 3, "folder": folder} for x in range(count)]


def evaluate(point: dict) -> list[dict]:
    """Notes that it was called; stops at x = 2 where the folder holds "interrupt", is killed there where "kill"."""
    folder = Path(point["folder"])
    if point["x"] == 2 and (folder / "interrupt").exists():
        raise KeyboardInterrupt
    if point["x"] == 2 and (folder / "kill").exists():
        (folder / "kill").unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    with (folder / "calls").open("a") as file:
        file.write(f"{point['x']}\n")
    rows = []
    for seed in range(point["seeds"]):
        values = torch.randn(64, 64, generator=torch.Generator().manual_seed(100 * point["x"] + seed))
        rows.append({"seed": seed, "value": float((values @ values).sum()), "curve": [1 / 3, 2.0]})
    return rows


def draw(records: list[dict], path) -> None:
    Path(path).write_text("\n".join(str(row["value"]) for record in records for row in record["rows"]))
