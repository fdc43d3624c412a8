"""One device in closed loop, from what it sends to its score: the rows of the figures without a fleet."""

from __future__ import annotations

from functools import lru_cache

import torch
from tensordict import TensorDictBase
from torch import Tensor

import tsjepa
from tsjepa.envs import Radio
from tsjepa.envs.transforms import Drive
from tsjepa.evaluation import rollouts
from tsjepa.evaluation.metrics import Run, normalized_score
from tsjepa.evaluation.rollouts import Loop, Watch, every
from tsjepa.models import Controller
from tsjepa.plants import Appearance, CartPole
from tsjepa.radio import IidLoss
from tsjepa.support.description import build

CURVE_STEP = 5  # slots between the recorded values of a curve
SAMPLING_INTERVAL = 0.02  # s; that of every entry but the printed recipe's
FRAME_HISTORY = 4  # what the supervised controller with four frames needs: with it all meet the same starts
SENT_AS = {"state": "{}", "embedding": "{}", "stack": "{}", "stream": "stream-{}", "video": "stream-{}"}
NEVER_FADES = -200.0  # dB, decode threshold of a link that only erasures cut


def loop_rows(point: dict) -> list[dict]:
    """Closed loops of a point, one row a seed.

    Args:
        point: ``model`` (an entry of the zoo, or None for the expert on the true state), ``sends`` ("state",
            "embedding", "stack" for all frames in one picture, "stream" for the newest frame alone, "video" for the
            same as H.264), ``codec``, ``quality`` (see :class:`Radio`), ``update_every`` (slots; 0 is once),
            ``between`` ("predict", "hold" or "zero"; None predicts if it can), ``seeds``, ``starts``, ``slots``,
            ``process_noise_std``, and where given ``loss``, the probability that an update is lost, and
            ``appearance``, what is drawn of each start's looks.

    Returns:
        ``score`` (normalised by the plant's ``optimal_policy``), ``failed`` (share), ``cost`` (quadratic),
        ``bits_per_slot``, and the curve ``in_box``, the share of starts in the box, averaged over every
        :data:`CURVE_STEP` slots.
    """
    loop, rows = loop_of(point), []
    optimal = optimal_of(loop, point["seeds"])
    for seed, best in enumerate(optimal):
        run = rollouts.run(loop, seed)
        rows.append(
            {
                "seed": seed,
                "score": normalized_score(run.raw_score(), best),
                "raw_score": float(run.raw_score().mean()),
                "failed": float(run.failed().float().mean()),
                "cost": float(run.quadratic_cost().mean()),
                "bits_per_slot": int(run.payload_bits.sum()) / run.payload_bits.numel(),
                "in_box": thinned(run.slot_score().mean(1)),
                "optimal_policy": loop.plant.normaliser,
            }
        )
    return rows


def command_rows(point: dict) -> list[dict]:
    """Command error over the actuator's range, one row a seed: ``nmae`` and its curve ``nmae_by_slot``.

    The expert drives and is the truth. A controller that predicts imagines, from its own commands, the loop that the
    expert really closes.

    Args:
        point: see :func:`loop_rows`.
    """
    loop, rows = loop_of(point), []
    (span,) = loop.plant.spec.action_range
    for seed in range(point["seeds"]):
        run = driven(loop, seed)
        error = (run.action - run.expert_action).abs().mean((1, 2)) / span
        rows.append({"seed": seed, "nmae": float(error.mean()), "nmae_by_slot": thinned(error)})
    return rows


def driven(loop: Loop, seed: int, watch: Watch | None = None) -> Run:
    """A run in which the expert drives; its ``action`` holds the commands of the loop's own controller."""
    expert = next(iter(loop.plant.experts().values()))
    return rollouts.run(loop, seed, watch, loop.env(seed).insert_transform(0, Drive(expert)))


def expert_embeddings(point: dict, seed: int, every_slots: int = CURVE_STEP) -> tuple[Tensor, Tensor]:
    """Embeddings [N, d] and states [N, n] of every so many slots of loops that the expert closes, slot by slot.

    Args:
        point: ``model``, ``starts``, ``slots``, ``process_noise_std``.
        seed: of the starts.
        every_slots: between two embeddings.
    """
    sent = {"sends": "embedding", "codec": "fp32", "between": "hold", "update_every": every_slots}
    embeddings, states = [], []

    def watch(slot: int, now: TensorDictBase) -> None:
        if slot % every_slots == 0:
            embeddings.append(now["embedding"])
            states.append(now["state"])

    driven(loop_of(point | sent), seed, watch)
    return torch.cat(embeddings), torch.cat(states)


def loop_of(point: dict) -> Loop:
    """The closed loop of a point, see :func:`loop_rows`; every controller meets the same starts."""
    model = None if point["model"] is None else load(point["model"])
    looks = appearance_of(point["appearance"]) if "appearance" in point else None
    loop = Loop(
        plant_of(SAMPLING_INTERVAL if model is None else model.spec.slot, point["process_noise_std"], looks),
        model or point["between"],
        num_devices=point["starts"],
        slots=point["slots"],
        radio=radio_of(point),
        frame_history=FRAME_HISTORY,
        between=point["between"] if model else None,
    )
    return every(loop, point["update_every"])


def radio_of(point: dict) -> Radio:
    """The link of one device: nothing is lost but by chance."""
    if point["sends"] not in SENT_AS:
        raise ValueError(f"A device cannot send {point['sends']!r}; choose from {', '.join(SENT_AS)}.")
    quality, loss = point.get("quality"), point.get("loss")
    return Radio(
        resource_blocks=point["starts"],
        codec=SENT_AS[point["sends"]].format(point["codec"]),
        quality=Radio.quality if quality is None else quality,
        snr_threshold_db=NEVER_FADES,
        loss=IidLoss(loss) if loss else None,
        lossless=not loss,
    )


def optimal_of(loop: Loop, seeds: int) -> Tensor:
    """Raw scores [seeds, I] of the plant's normaliser from the starts of ``loop``, kept for the next point."""
    model = loop.controller
    history = max(loop.frame_history, model.frame_history if isinstance(model, Controller) else 1)
    return _optimal(loop.plant, loop.num_devices, loop.slots, history, seeds)


@lru_cache(maxsize=16)
def _optimal(plant: CartPole, num_devices: int, slots: int, frame_history: int, seeds: int) -> Tensor:
    loop = Loop(plant, num_devices=num_devices, slots=slots, frame_history=frame_history)
    return rollouts.optimal_scores(loop, seeds)


@lru_cache(maxsize=4)
def load(model: str) -> Controller:
    """An entry of the zoo, kept for the next point."""
    return tsjepa.load(model)


@lru_cache(maxsize=8)
def plant_of(
    sampling_interval: float, process_noise_std: float = 0.0, appearance: Appearance | None = None
) -> CartPole:
    """The paper's plant, kept with its camera for the next point."""
    return CartPole(sampling_interval, process_noise_std, appearance=appearance)


def appearance_of(fields: dict) -> Appearance:
    """The appearance of plain values.

    Raises:
        ValueError: there is no such field, or its value cannot be.
    """
    return build({"class_path": "tsjepa.plants.Appearance", "init_args": fields}, lambda kind: kind is Appearance)


def thinned(curve: Tensor) -> list[float]:
    """A curve [T] averaged over every :data:`CURVE_STEP` slots; what is left over at its end is dropped."""
    return curve[: len(curve) // CURVE_STEP * CURVE_STEP].view(-1, CURVE_STEP).mean(1).tolist()
