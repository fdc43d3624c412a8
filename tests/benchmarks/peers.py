"""Our training loop and our fleet beside those of other libraries, in turns.

    pip install 'tsjepa[bench]'
    python tests/benchmarks/peers.py --threads 2            # about four minutes on an idle machine

- training: samples per second of recipes/jepa.yaml, and of the same encoder, predictor, optimizer, precision and batch
  in the loop that lightly's examples teach: a data set whose items go through torchvision's transforms one by one, a
  momentum encoder, the negative cosine similarity, Lightning's trainer. It does less per sample: it predicts one stack
  ahead instead of seven, and has no other loss.
- environment: frames per second of our fleet of 64, and of stable-worldmodel's ``swm/CartpoleDMControl-v0``, stepped
  and rendered in our size and in its own (224 x 224).

What is not installed is left out, and the reason stands in its place. A torchvision that was built for another torch
than the one here breaks other imports of its environment; a second environment for this script keeps that apart.
"""

import argparse
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version

import camera
from report import publish, spread
from turns import Contender

import tsjepa  # noqa: F401  (chooses the GL backend before mujoco is imported)

SHIMS = []  # what registers an operator has to live as long as the process


def mend_torchvision() -> None:
    """Makes torchvision importable beside a torch it was not built for.

    Its compiled operators do not load then, and its import fails because two of them lack a declaration. Nothing here
    calls them.
    """
    import sys

    import torch

    try:
        import torchvision  # noqa: F401
    except ModuleNotFoundError:
        return
    except RuntimeError:
        for name in [name for name in sys.modules if name.partition(".")[0] == "torchvision"]:
            del sys.modules[name]
        SHIMS.append(torch.library.Library("torchvision", "DEF"))
        for operator in ("nms", "qnms"):
            SHIMS[0].define(f"{operator}(Tensor boxes, Tensor scores, float threshold) -> Tensor")


def swm(height: int, width: int) -> tuple[Callable[[int], int], dict]:
    """Steps and renders stable-worldmodel's cart-pole under random commands; for :func:`turns.serve`."""
    mend_torchvision()
    import gymnasium
    import stable_worldmodel.envs  # noqa: F401  (registers it)
    import torchrl  # noqa: F401  (before dm_control)

    env = gymnasium.make("swm/CartpoleDMControl-v0").unwrapped
    env.reset(seed=0)

    def make(frames: int) -> int:
        for _ in range(frames):
            env.step(env.action_space.sample())
            env.render(width=width, height=height)
        return frames

    return make, {}


def fleet(devices: int) -> tuple[Callable[[int], int], dict]:
    """Our fleet with its camera, one frame a device and slot."""
    mend_torchvision()
    return camera.fleet(devices, 1)


def train(connection, build: Callable, arguments: tuple) -> None:
    """Trains as many steps as it is told to, and answers with samples per second; the counterpart of turns.serve.

    Args:
        connection: of the pipe to the parent; 0 steps end the fit.
        build: gives trainer, module, data and samples a step.
        arguments: of ``build``.
    """
    mend_torchvision()
    trainer, module, data, samples = build(*arguments)
    trainer.callbacks.append(take_orders(connection, samples))
    trainer.fit(module, data)


def take_orders(connection, samples: int):
    """A callback that pauses the trainer between the parent's orders."""
    import lightning

    class TakeOrders(lightning.Callback):
        def on_train_start(self, trainer, module) -> None:
            self.ordered = self.left = 2  # to warm up
            self.started = None

        def on_train_batch_end(self, trainer, module, outputs, batch, batch_idx: int) -> None:
            self.left -= 1
            if self.left:
                return
            seconds = self.started and time.perf_counter() - self.started
            connection.send(self.ordered * samples / seconds if seconds else {})
            self.ordered = self.left = connection.recv()
            trainer.should_stop = not self.ordered
            self.started = time.perf_counter()

    return TakeOrders()


def ours(recipe: str, threads: int, overrides: list[str]) -> tuple:
    """The recipe's trainer, without callbacks, logger and validation, its module and its data."""
    import torch
    from lightning.pytorch.cli import LightningCLI

    from tsjepa.support.allocator import keep_freed_memory

    torch.set_num_threads(threads)
    keep_freed_memory()
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    cli = LightningCLI(
        run=False,
        save_config_callback=None,
        seed_everything_default=0,
        auto_configure_optimizers=False,
        args=[
            *("--config", recipe),
            *(word for name in off for word in (f"--trainer.{name}", "false")),
            *("--trainer.callbacks", "null", "--trainer.limit_val_batches", "0", "--trainer.max_epochs", "1000"),
            *overrides,
        ],
    )
    return cli.trainer, cli.model, cli.datamodule, cli.datamodule.frames_per_batch


def lightly(recipe: str, threads: int, overrides: list[str]) -> tuple:
    """The same trainer with lightly's loop and loader around the same networks."""
    from peer_loop import MomentumLoop, loader

    trainer, module, data, samples = ours(recipe, threads, overrides)
    data.prepare_data()
    return trainer, MomentumLoop(module), loader(data, module.augmentation), samples


def beside(contenders: dict[str, Contender], units: dict[str, int], rounds: int) -> tuple[dict, dict]:
    """Rates of all contenders in turn, and the ratio of the first to every other within each round."""
    rates = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, contender in contenders.items():
            rates[name].append(contender.rate(units[name]))
    for contender in contenders.values():
        contender.stop()
    first, *others = rates
    ratios = {name: spread([a / b for a, b in zip(rates[first], rates[name], strict=True)]) for name in others}
    return {name: spread(values) for name, values in rates.items()}, ratios


def missing(package: str) -> dict | None:
    """Why a row is left out; None where ``package`` is installed."""
    try:
        version(package)
    except PackageNotFoundError:
        return {"left_out": f"{package} is not installed; pip install 'tsjepa[bench]' brings it"}
    return None


def training(recipe: str, threads: int, rounds: int, steps: int, overrides: list[str]) -> dict:
    """Our loop and lightly's."""
    arguments = (recipe, threads, overrides)
    contenders = {build.__name__: Contender(build, *arguments, target=train) for build in (ours, lightly)}
    rates, ratios = beside(contenders, dict.fromkeys(contenders, steps), rounds)
    return {
        "peer": f"lightly {version('lightly')}",
        "recipe": recipe,
        "threads": threads,
        "samples_per_second": rates,
        "ours_over_lightly": ratios["lightly"],
    }


def environment(devices: int, rounds: int, frames: int) -> dict:
    """Our fleet and stable-worldmodel's cart-pole, which makes a tenth of the frames."""
    contenders = {
        "fleet": Contender(fleet, devices),
        "swm": Contender(swm, 64, 128),
        "swm_224": Contender(swm, 224, 224),
    }
    units = {name: frames if name == "fleet" else max(1, frames // 10) for name in contenders}
    rates, ratios = beside(contenders, units, rounds)
    return {
        "peer": f"stable-worldmodel {version('stable-worldmodel')}",
        "devices": devices,
        "frames_per_second": rates,
        "fleet_over_swm": ratios["swm"],
        "fleet_over_swm_224": ratios["swm_224"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", default="recipes/jepa.yaml")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--steps", type=int, default=8, help="of training, a round")
    parser.add_argument("--devices", type=int, default=64, help="I of the fleet")
    parser.add_argument("--frames", type=int, default=1280, help="of the fleet, a round; a tenth for its peer")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", default="docs/results/peers.json")
    options, overrides = parser.parse_known_args()
    result = {
        "training": missing("lightly")
        or training(options.recipe, options.threads, options.rounds, options.steps, overrides),
        "environment": missing("stable-worldmodel") or environment(options.devices, options.rounds, options.frames),
    }
    publish(options.output, result)


if __name__ == "__main__":
    main()
