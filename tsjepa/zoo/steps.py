"""Which commands make each entry of the zoo, from nothing to what is evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

# The first of the sets of starts that training seeds are compared on: recipes were chosen on those from 0 on.
FRESH = 1000
# The expert's trajectories on which the training seed to be shipped is chosen: no fit learns from them, and no card
# tells their error.
VALIDATION = "actor_test"
LARGE = "data/cartpole-large"  # of recipes/zoo/data.yaml
LARGE_DATA = (
    *("--data.init_args.path", LARGE),
    *("--data.init_args.collect", "[recipes/data.yaml, recipes/zoo/data.yaml]"),
    *("--data.init_args.splits", "[train, actor_train, actor_plain]"),
)

# The encoder of 256 features has 2.6 million weights, a whole zoo of which would be too large to ship.
SMALL = ("--model.init_args.encoder.init_args.features", "64", "--model.init_args.encoder.init_args.hidden_dim", "256")


@dataclass(frozen=True)
class Fit:
    """One fit: a base recipe below ``recipes``, what lies over it, options, and its data set if not the entry's."""

    recipe: str
    over: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    data: str | None = None


@dataclass(frozen=True)
class Made:
    """How an entry is made.

    Args:
        fits: in their order; each but the first starts from the model of the one before.
        after: entry from whose model, of the same training seed, the first fit starts; it is made first.
        decoder: whether the entry keeps what draws its embeddings, for pictures and films of them.
        data: set whose test split gives the card's command error.
        evaluation: further options of ``tsjepa evaluate``.
        over: recipes over ``recipes/evaluate.yaml``.
    """

    fits: tuple[Fit, ...]
    data: str = LARGE
    evaluation: tuple[str, ...] = ("--frame_history", "4", "--periods", "[1, 2, 5, 10, 20, 0]")
    over: tuple[str, ...] = ()
    after: str | None = None
    decoder: bool = True


def of_width(dim: int) -> Made:
    """TS-JEPA for the cart-pole with embeddings of ``dim`` numbers."""
    sized = [(f"--model.init_args.{part}.init_args.embedding_dim", str(dim)) for part in ("encoder", "predictor")]
    small = dim < 256
    options = (*sized[0], *sized[1], *(SMALL if small else ()))
    return Made((Fit("jepa", ("zoo/jepa",), options), Fit("actor", ("zoo/actor",))), decoder=not small)


def of_plant(plant: str) -> Made:
    """TS-JEPA for another machine, by the recipes below recipes/plants."""
    over = f"plants/{plant}"
    fits = (Fit("jepa", (f"{over}/jepa",)), Fit("actor", (f"{over}/actor",)))
    return Made(fits, f"data/{plant}", (), (f"{over}/evaluate",))


def observed(entry: str, *over: str) -> Made:
    """An entry for the cart-pole with an observer on the device, by the recipes ``over`` recipes/observer.yaml."""
    return Made((Fit("observer", over, data="data/cartpole-noise"),), after=entry, decoder=False)


SUPERVISED = (*LARGE_DATA, "--trainer.max_epochs", "9", "--model.init_args.learning_rate", "2e-3")
GENERATIVE = (*LARGE_DATA, "--trainer.max_epochs", "12", "--trainer.check_val_every_n_epoch", "3")
PAPER_20_MS = ("--data.init_args.path", "data/paper-20ms", "--data.init_args.collect", "recipes/zoo/paper-data.yaml")
ENTRIES: dict[str, Made] = {
    "tsjepa-cartpole": of_width(256),
    "tsjepa-cartpole-d128": of_width(128),
    "tsjepa-cartpole-d64": of_width(64),
    "tsjepa-cartpole-d32": of_width(32),
    "tsjepa-cartpole-d16": Made((Fit("jepa", ("zoo/jepa", "zoo/d16")), Fit("actor", ("zoo/actor",)))),
    "tsjepa-cartpole-observer": observed("tsjepa-cartpole"),
    "tsjepa-cartpole-d16-observer": observed("tsjepa-cartpole-d16"),
    "tsjepa-cartpole-d16-last-command": observed("tsjepa-cartpole-d16", "last-command"),
    "supervised-cartpole-k2": Made((Fit("supervised", (), SUPERVISED),)),
    "supervised-cartpole-k4": Made((Fit("supervised", ("supervised-k4",), SUPERVISED),)),
    "autoencoder-cartpole": Made((Fit("autoencoder", (), GENERATIVE),)),
    "tsjepa-cartpole-paper": Made(
        (Fit("jepa", ("paper/jepa",), PAPER_20_MS), Fit("actor", ("paper/actor",), PAPER_20_MS)), "data/paper-20ms"
    ),
    "tsjepa-cartpole-appearance": Made(
        (Fit("jepa", ("appearance/jepa",)), Fit("actor", ("appearance/actor",))),
        "data/cartpole-appearance",
        (),
        ("appearance/evaluate",),
    ),
    "tsjepa-double-cartpole": of_plant("double_cartpole"),
    "tsjepa-reacher": of_plant("reacher"),
    "tsjepa-pendulum": of_plant("pendulum"),
}


def fits(made: Made, home: str, seed: int) -> dict[str, list[str]]:
    """The words of each fit's command after ``tsjepa``, by its recipe, with all that it leaves below ``home``."""
    steps: dict[str, list[str]] = {}
    runs = [f"{home}/{fit.recipe}" for fit in made.fits]
    first = None if made.after is None else run_of(ENTRIES[made.after], before(made, home))
    for fit, previous in zip(made.fits, (first, *runs), strict=False):
        start = [] if previous is None else ["--model.init_args.pretrained", f"{previous}/model"]
        steps[fit.recipe] = ["fit", *recipes((fit.recipe, *fit.over)), *fit.options, *start]
        steps[fit.recipe] += ["--trainer.default_root_dir", f"{home}/{fit.recipe}", "--seed_everything", str(seed)]
    return steps


def before(made: Made, home: str) -> str:
    """Where the entry ``made.after`` lies for the training seed in ``home``."""
    folder = Path(home)
    return (folder.parent.parent / str(made.after) / folder.name).as_posix()


def run_of(made: Made, home: str) -> str:
    """Folder of the last fit, which leaves the whole model."""
    return f"{home}/{made.fits[-1].recipe}"


def evaluation(made: Made, home: str, output: str) -> list[str]:
    """The words of the command that evaluates the model below ``home``."""
    words = ["evaluate", *recipes(("evaluate", *made.over)), "--model", f"{run_of(made, home)}/model"]
    return [*words, "--data", made.data, "--output", output, *made.evaluation]


def recipes(names: Sequence[str]) -> list[str]:
    """``--config`` for each, by its path below ``recipes`` without the ending."""
    return [word for name in names for word in ("--config", f"recipes/{name}.yaml")]
