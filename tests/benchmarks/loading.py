"""How long an entry of the zoo takes to load, once torch and the package are imported; the limit is 2 s.

    python tests/benchmarks/loading.py            # a few seconds an entry and round

Every load is the first of a process of its own.
"""

import argparse
import json
import subprocess
import sys

from report import publish, spread

from tsjepa.models import entries

LIMIT_S = 2.0
PROGRAM = """
import sys, time
import tsjepa.models.entries
start = time.perf_counter()
tsjepa.models.entries.load(sys.argv[1])
print(time.perf_counter() - start)
"""


def seconds_to_load(name: str) -> float:
    """In a process of its own."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, name], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--entries", nargs="*", default=entries.names())
    parser.add_argument("--output", default="docs/results/loading.json")
    options = parser.parse_args()
    rounds = [{name: seconds_to_load(name) for name in options.entries} for _ in range(options.rounds)]
    seconds = {name: spread([times[name] for times in rounds]) for name in options.entries}
    publish(options.output, {"limit_s": LIMIT_S, "seconds_to_load": seconds})


if __name__ == "__main__":
    main()
