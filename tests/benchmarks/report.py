"""What the benchmarks share: interleaved medians, the machine, and the JSON file."""

import json
import os
import statistics
from pathlib import Path

from tsjepa.support.files import write_text
from tsjepa.support.provenance import machine, provenance


def spread(values: list[float]) -> dict[str, float]:
    """Median with the smallest and the largest value."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values), "rounds": len(values)}


def publish(path: str, result: dict) -> None:
    """Writes the result with its provenance, the machine and its load, and prints it."""
    result = {"made_by": provenance(), "machine": machine() | {"load_average": round(os.getloadavg()[0], 2)}, **result}
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
