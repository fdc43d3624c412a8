"""The live loop: scores beside the chain's, deadlines, a hundred devices, hostile datagrams, a device without torch.

    python tests/benchmarks/live.py score weather   # on an idle machine; needs pip install 'tsjepa[device,onnx]'
    python tests/benchmarks/live.py crowd hostile restart light

Each part is a few processes of `tsjepa device` and `tsjepa controller` on this machine, and joins its figures to those
of the other parts in the result.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import live_crowd
import numpy as np
import torch
from report import publish

import tsjepa
from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop, every, perfect_feedback, run
from tsjepa.plants import build_plant
from tsjepa.zoo.deploy import deploy

MODEL, EPISODE, HISTORY = "tsjepa-cartpole", 100, 4
ADDRESS = "127.0.0.1:5741"
LIGHT = ("numpy", "onnxruntime", "opencv-python-headless", "cryptography", "jsonargparse[signatures]", "filelock")


def start(*arguments: object, python: str = sys.executable) -> subprocess.Popen:
    """A command of this package, on one thread."""
    command = [python, "-m", "tsjepa.cli", *map(str, arguments)]
    return subprocess.Popen(command, env=os.environ | {"OMP_NUM_THREADS": "1"}, stdout=subprocess.DEVNULL)


def end(child: subprocess.Popen) -> None:
    """Asks a process to end, and waits until it has."""
    child.send_signal(signal.SIGTERM)
    child.wait(timeout=60)


def until(condition: Callable[[], bool], seconds: float = 120) -> None:
    """Waits for ``condition``."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def listening() -> None:
    """Waits until the controller has its socket."""
    port = f":{int(ADDRESS.rpartition(':')[2]):04X}"
    until(lambda: port in Path("/proc/net/udp").read_text())


def used(log: Path) -> list[str]:
    """Lines about updates that a controller has used."""
    return log.read_text().splitlines()[1:] if log.exists() else []


def resident_mib(pid: int) -> float:
    """Memory of a process that is in RAM."""
    text = Path(f"/proc/{pid}/status").read_text()
    return int(text.split("VmRSS:")[1].split()[0]) / 1024


def cpu_seconds(pid: int) -> float:
    """CPU time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def pair(graphs: Path, home: Path, slots: int, device: list, controller: list = ()) -> tuple[dict, dict]:
    """Runs one device process and its controller to the end; their reports."""
    far = start("controller", graphs, "--bind", ADDRESS, "--report", home / "c.json", *controller)
    listening()
    near = start("device", graphs, "--controller", ADDRESS, "--slots", slots, "--report", home / "d.json", *device)
    assert near.wait(timeout=600) == 0
    end(far)
    return tuple(json.loads((home / name).read_text()) for name in ("d.json", "c.json"))


def chain_scores(plant, period: int, episodes: int) -> tuple[list[float], list[float], int]:
    """Raw scores of the chain and of the normaliser on the same starts, and falls of the chain."""
    radio = Radio(codec="int8", lossless=True)
    loop = Loop(plant, tsjepa.load(MODEL), num_devices=1, slots=EPISODE, radio=radio, frame_history=HISTORY)
    played, perfect = every(loop, period), perfect_feedback(loop, plant.normaliser)
    envs = played.env(0), perfect.env(0)
    runs = [run(played, 0, env=envs[0]) for _ in range(episodes)]
    best = [run(perfect, 0, env=envs[1]) for _ in range(episodes)]
    scores = [[float(one.raw_score()) for one in several] for several in (runs, best)]
    return *scores, sum(int(one.failed().sum()) for one in runs)


def compared(device: dict, controller: dict, plant, period: int) -> dict:
    """The figures of a live run beside the chain's."""
    live = device["machine"]["raw_scores"]
    chain, best, falls = chain_scores(plant, period, len(live))
    return {
        "episodes": len(live),
        "normalized_score": sum(live) / sum(best),
        "normalized_score_of_the_chain": sum(chain) / sum(best),
        "episodes_that_score_alike": sum(abs(a - b) <= 0.02 for a, b in zip(live, chain, strict=True)),
        "falls": device["machine"]["fallen"],
        "falls_of_the_chain": falls,
        "missed_share": device["missed_share"],
        "age_slots": controller["age_slots"],
        "commands": device["commands"],
        "stages": {"device": device["stages"], "controller": controller["stages"]},
    }


def score(graphs: Path, home: Path, options: argparse.Namespace) -> dict:
    """An update every slot and every 5, from the starts of the evaluation."""
    plant, slots = (
        build_plant(json.loads((graphs / "deployment.json").read_text())["plant"]),
        options.episodes * EPISODE,
    )
    pace = ["--realtime_factor", options.realtime_factor]
    episodes = ["--episode_slots", EPISODE, "--frame_history", HISTORY, *pace]
    result = {}
    for period in (1, 5):
        reports = pair(graphs, home, slots, ["--period", period, *episodes], pace)
        result[f"every {period}"] = compared(*reports, plant, period)
    return result


def weather(graphs: Path, home: Path, options: argparse.Namespace) -> dict:
    """30 % of the updates lost and all of them 20 ms late, from 20 starts."""
    pace = ["--realtime_factor", options.realtime_factor]
    device = ["--episode_slots", EPISODE, "--frame_history", HISTORY, "--loss", 0.3, "--delay", 20, *pace]
    near, far = pair(graphs, home, 20 * EPISODE, device, pace)
    kept = ("missed_share", "updates", "commands", "round_trip_slots", "machine")
    return {name: near[name] for name in kept} | {"age_slots": far["age_slots"]}


def crowd(graphs: Path, home: Path, options: argparse.Namespace) -> dict:
    """One controller and 100 load generators that replay embeddings."""
    far = start("controller", graphs, "--bind", ADDRESS, "--num_devices", 100, "--report", home / "c.json")
    listening()
    memory, before, started = [], cpu_seconds(far.pid), time.monotonic()
    figures = live_crowd.replay(
        ADDRESS, 100, options.seconds, 256, lambda: memory.append(round(resident_mib(far.pid), 1))
    )
    share = (cpu_seconds(far.pid) - before) / (time.monotonic() - started)
    end(far)
    report = json.loads((home / "c.json").read_text())
    return {
        "seconds": options.seconds,
        "generator": figures,
        "cpu_share": share,
        "memory_mib": {"at 5 s": memory[5], "last": memory[-1], "largest": max(memory)},
        "receive_to_command_ms": report["stages"]["receive to command"],
        "counts": report["counts"],
        "dropped": report["dropped"],
        "age_slots": report["age_slots"],
        "stages": report["stages"],
    }


def hostile(graphs: Path, home: Path, options: argparse.Namespace) -> dict:
    """A million hostile datagrams while 10 devices are controlled."""
    (home / "key").write_text(os.urandom(32).hex())
    pace = ["--realtime_factor", options.slow_factor, "--key", home / "key"]
    options_far = ["--bind", ADDRESS, "--num_devices", 10, "--report", home / "c.json", *pace]
    far = start("controller", graphs, *options_far)
    listening()
    relay = live_crowd.Relay(ADDRESS)
    relay.start()
    report = home / "d.json"
    near = start("device", graphs, "--controller", relay.address, "--num_devices", 10, "--report", report, *pace)
    until(lambda: len(relay.recorded) >= 1000, 600)
    (home / "recorded").write_text("\n".join(data.hex() for data in list(relay.recorded)))
    before = resident_mib(far.pid)
    enemy = [sys.executable, live_crowd.__file__, ADDRESS, str(options.hostile), home / "recorded"]
    sent = json.loads(subprocess.run(enemy, check=True, capture_output=True, text=True).stdout)
    after = resident_mib(far.pid)
    time.sleep(3)
    end(near)
    end(far)
    device, report = (json.loads((home / name).read_text()) for name in ("d.json", "c.json"))
    return {
        **sent,
        "realtime_factor": options.slow_factor,
        "memory_mib": {"before": before, "after": after},
        "datagrams_read": report["datagrams"],
        "dropped": report["dropped"],
        "updates_sent": device["updates"]["sent"],
        "updates_used": report["counts"]["updates"],
        "slots": device["slots"],
        "commands": device["commands"],
        "fallen": device["machine"]["fallen"],
    }


def restart(graphs: Path, home: Path, options: argparse.Namespace) -> dict:
    """The controller is killed and comes back."""
    far = start("controller", graphs, "--bind", ADDRESS, "--log", home / "first.csv")
    listening()
    near = start("device", graphs, "--controller", ADDRESS, "--report", home / "d.json", "--watchdog_ms", 200)
    until(lambda: len(used(home / "first.csv")) > 100)
    far.kill()
    far.wait()
    time.sleep(1)
    again = start("controller", graphs, "--bind", ADDRESS, "--log", home / "log.csv")
    until(lambda: len(used(home / "log.csv")) > 100)
    end(near)
    end(again)
    device = json.loads((home / "d.json").read_text())
    return {
        "first_update_used_after_s": float(used(home / "log.csv")[0].split(",")[0]),
        "commands": device["commands"],
        "watchdog_ms": 200,
    }


def light(graphs: Path, home: Path, options: argparse.Namespace) -> dict:
    """An environment without torch: size, time until it says hello, CPU share at 50 Hz."""
    import cv2

    root = Path(tsjepa.__file__).parents[1]
    subprocess.run([sys.executable, "-m", "venv", home / "venv"], check=True)
    python = home / "venv/bin/python"
    pip = [python, "-m", "pip", "install", "-q"]
    subprocess.run([*pip, *LIGHT], check=True)
    subprocess.run([*pip, "hatchling"], check=True)
    subprocess.run([*pip, "--no-deps", "--no-build-isolation", root], check=True)
    subprocess.run([python, "-m", "pip", "uninstall", "-q", "-y", "hatchling", "pip"], check=True)
    size = sum(path.stat().st_size for path in (home / "venv").rglob("*") if path.is_file() and not path.is_symlink())
    writer = cv2.VideoWriter(str(home / "film.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 50, (640, 480))
    for _ in range(100):
        writer.write(np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8))
    writer.release()
    hello = live_crowd.waits_for_hello(ADDRESS)
    asked = time.monotonic()
    film = ["--camera", home / "film.avi", "--controller", ADDRESS]
    child = start("device", graphs, *film, python=str(python))
    begun = hello() - asked
    child.kill()
    child.wait()
    far = start("controller", graphs, "--bind", ADDRESS, "--log", home / "log.csv")
    listening()
    near = start("device", graphs, *film, "--report", home / "d.json", python=str(python))
    until(lambda: len(used(home / "log.csv")) > 50)
    before, clock = cpu_seconds(near.pid), time.monotonic()
    time.sleep(10)
    share = (cpu_seconds(near.pid) - before) / (time.monotonic() - clock)
    memory = resident_mib(near.pid)
    end(near)
    end(far)
    report = json.loads((home / "d.json").read_text())
    return {
        "environment_mib": size / 2**20,
        "start_to_hello_s": begun,
        "cpu_share_at_50_hz": share,
        "memory_mib": memory,
        "film": "640 x 480 MJPEG, decoded and brought to 64 x 128",
        "missed_share": report["missed_share"],
        "stages": report["stages"],
    }


PARTS = {part.__name__: part for part in (score, weather, crowd, hostile, restart, light)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", choices=PARTS)
    parser.add_argument("--episodes", type=int, default=30, help="of score, for each period")
    parser.add_argument("--seconds", type=float, default=600, help="of crowd")
    parser.add_argument("--hostile", type=int, default=1_000_000, help="datagrams")
    parser.add_argument("--realtime_factor", type=float, default=1.0, help="of score and weather")
    parser.add_argument("--slow_factor", type=float, default=0.25, help="of hostile, whose 10 cameras share a core")
    parser.add_argument("--output", default="docs/results/live.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    path = Path(options.output)
    result = json.loads(path.read_text()) if path.is_file() else {}
    result = {name: part for name, part in result.items() if name in PARTS}
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        deploy(MODEL, str(home / "graphs"))
        for name in options.parts:
            figures = PARTS[name](home / "graphs", home, options)
            pace = {"realtime_factor": options.realtime_factor} if name in ("score", "weather") else {}
            result[name] = {**pace, "load_average": round(os.getloadavg()[0], 1), **figures}
    publish(options.output, {"model": MODEL, **result})


if __name__ == "__main__":
    main()
