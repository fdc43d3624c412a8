"""Camera, training step and network rates of this checkout beside those of another one, in turns.

    git worktree add ../old c00b92b
    python tests/benchmarks/commits.py --old ../old      # a few minutes; both collect a small data set

One process for each checkout, which answer in turns, so that both see the same machine; the ratio is that within a
round. Both train the same network on windows of the same length: the network of c00b92b's
recipe, with 256 numbers and coloured patches.
"""

import argparse
import math
import os
import subprocess
import sys
import time
from pathlib import Path

STEPS = 5  # of training, in a turn
# a small data set, and the same slots between stacks in every batch, which a fit draws: a step's work depends on them
COMMON = ("--data.init_args.episodes", "40", "--data.init_args.steps", "[2]")
SAME_NETWORK = (
    *("--model.init_args.encoder.init_args.embedding_dim", "256"),
    *("--model.init_args.encoder.init_args.grey", "false"),
    *("--model.init_args.encoder.init_args.stem_kernel", "3"),
    *("--model.init_args.predictor.init_args.embedding_dim", "256"),
    *("--model.init_args.predictor.init_args.hidden_dim", "1024"),
    *("--data.init_args.start_share", "0"),
)


def training(precision: str, threads: int, changes: list[str]):
    """Answers every request with the seconds of some steps of a fit that goes on in between."""
    import lightning
    import torch
    from lightning.pytorch.cli import LightningCLI

    torch.set_num_threads(threads)

    class Turns(lightning.Callback):
        def on_train_batch_start(self, trainer, module, batch, batch_idx: int) -> None:
            if trainer.global_step % STEPS == 0:
                now = time.perf_counter()
                if trainer.global_step:
                    answer(256 * STEPS / (now - self.started))
                if not asked():
                    os._exit(0)  # nothing of this fit is wanted
                self.started = time.perf_counter()

    options = {"trainer.logger": "false", "trainer.callbacks": "null", "trainer.enable_checkpointing": "false"}
    options |= {"trainer.limit_val_batches": "0", "trainer.max_epochs": "1000", "trainer.precision": precision}
    cli = LightningCLI(
        run=False,
        save_config_callback=None,
        seed_everything_default=0,
        trainer_defaults={"enable_progress_bar": False},
        auto_configure_optimizers=False,
        args=[
            "--config",
            "recipes/jepa.yaml",
            *(part for item in options.items() for part in (f"--{item[0]}", item[1])),
            *COMMON,
            *changes,
        ],
    )
    if changes:  # this checkout chooses the memory format by the machine
        from tsjepa.support.precision import MEMORY_FORMATS, choose

        chosen = choose(cli.model.encoder, torch.device("cpu"))
        cli.model.to(memory_format=MEMORY_FORMATS[chosen.memory_format])
    cli.trainer.callbacks.append(Turns())
    cli.trainer.fit(cli.model, cli.datamodule)


def camera() -> None:
    """Answers every request with the frames per second of a fleet of 64."""
    from camera import fleet

    make, _ = fleet(64, 1)
    make(640)
    while asked():
        start = time.perf_counter()
        made = make(1280)
        answer(made / (time.perf_counter() - start))


def network(threads: int) -> None:
    """Answers every request with the device-slots per second of the pure network mode."""
    from network import pure

    pure("channel_aware", 100, 200, 50, threads)
    while asked():
        answer(pure("channel_aware", 100, 1000, 200, threads))


def asked() -> bool:
    return sys.stdin.readline().strip() == "go"


def answer(rate: float) -> None:
    print(f"rate {rate}", file=sys.__stdout__, flush=True)


def serve(what: str, precision: str, threads: int, changes: list[str]) -> None:
    sys.path.pop(0)  # this script's folder: each contender has the benchmarks of its own checkout
    import tsjepa  # noqa: F401  (chooses the GL backend)

    {"camera": camera, "network": lambda: network(threads)}.get(what, lambda: training(precision, threads, changes))()


class Contender:
    """A process of one checkout."""

    def __init__(self, tree: Path, words: list[str]) -> None:
        paths = os.pathsep.join((str(tree), str(tree / "tests" / "benchmarks")))
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--serve", *words],
            cwd=tree,
            env=os.environ | {"PYTHONPATH": paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def rate(self) -> float:
        self.process.stdin.write("go\n")
        self.process.stdin.flush()
        for line in self.process.stdout:
            if line.startswith("rate "):
                return float(line.split()[1])
        raise SystemExit(f"the process ended with {self.process.wait()}")

    def close(self) -> None:
        self.process.stdin.close()
        self.process.wait()


def compare(what: str, old: Path, new: Path, rounds: int, precision: str, threads: int) -> dict:
    """Rates of both, and new over old in each round."""
    from report import spread

    started = {"old": (old, []), "new": (new, [*SAME_NETWORK])}
    contenders = {}
    for name, (tree, changes) in started.items():
        words = [what, "--precision", precision, "--threads", str(threads), *(changes if what == "training" else [])]
        contenders[name] = Contender(tree, words)
    rates = {name: [] for name in contenders}
    for turn in range(rounds + 1):
        for name in ("old", "new") if turn % 2 else ("new", "old"):
            rates[name].append(contenders[name].rate())
    for contender in contenders.values():
        contender.close()
    pairs = list(zip(rates["new"], rates["old"], strict=True))[1:]
    ratios = [mine / theirs for mine, theirs in pairs]
    return {
        "new": spread([pair[0] for pair in pairs]),
        "old": spread([pair[1] for pair in pairs]),
        "new_over_old": spread(ratios) | of_median(ratios),
    }


def of_median(values: list[float]) -> dict[str, list[float]]:
    """The 95 % interval of the median, from order statistics; of at least 6 values."""
    ordered, count = sorted(values), len(values)
    reach = 0.98 * math.sqrt(count)  # half of 1.96 standard deviations of a fair coin's count
    low, high = max(0, math.floor(count / 2 - reach)), min(count - 1, math.ceil(count / 2 + reach) - 1)
    return {"interval": [ordered[low], ordered[high]]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", help="folder of the other checkout")
    parser.add_argument("--only", nargs="+", default=["camera", "network", "training"])
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--precision", default="32-true")
    parser.add_argument("--serve", choices=("camera", "network", "training"), help="what a contender answers with")
    parser.add_argument("--output", default="docs/results/commits.json")
    options, changes = parser.parse_known_args()
    if options.serve:
        return serve(options.serve, options.precision, options.threads, changes)
    from report import publish

    old, new = Path(options.old).resolve(), Path(__file__).resolve().parents[2]
    given = (old, new, options.rounds, options.precision, options.threads)
    results = {name: compare(name, *given) for name in options.only}
    publish(options.output, {"threads": options.threads, "training_precision": options.precision, **results})
    return None


if __name__ == "__main__":
    main()
