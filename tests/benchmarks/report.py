"""What the benchmarks share: interleaved medians, the machine, and the JSON file."""

import json
import os
import platform
import statistics
from pathlib import Path

from tsjepa.evaluation.provenance import provenance
from tsjepa.files import write_text


def spread(values: list[float]) -> dict[str, float]:
    """Median with the smallest and the largest value."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values), "rounds": len(values)}


def machine() -> dict[str, str | int]:
    """Processor, its number of cores here, and the load of the machine when the benchmark ended."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        name = platform.processor() or platform.machine()
    return {"processor": name, "cores": os.cpu_count(), "load_average": round(os.getloadavg()[0], 2)}


def publish(path: str, result: dict) -> None:
    """Writes the result with its provenance and prints it."""
    result = {"made_by": provenance(), "machine": machine(), **result}
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
