"""One device in closed loop, from what it sends to its score: the rows of the figures without a fleet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple
from functools import lru_cache

import torch
from torch import Tensor

from tsjepa.envs.payload import state_codec
from tsjepa.plants import CartPole
from tsjepa.evaluation.closed_loop import Starts, is_update, run, true_state_policy
from tsjepa.evaluation.metrics import normalized_score

COMMAND_RANGE = 40.0
from tsjepa.paper.senders import make_sender
from tsjepa.radio.codecs import payload_bits

CURVE_STEP = 5  # slots between the recorded values of a curve
SAMPLING_INTERVAL = 0.02  # s; that of every entry but the printed recipe's
FRAME_HISTORY = 4  # what the supervised controller with four frames needs: with it all meet the same starts


def loop_rows(point: dict) -> list[dict]:
    """Closed loops of a point, one row a seed.

    Args:
        point: ``model`` (an entry of the zoo, or None for the expert on the true state), ``sends``, ``codec``,
            ``quality`` (see :func:`make_sender`), ``update_every`` (slots; 0 is once), ``between`` ("predict", "hold"
            or "zero"), ``seeds``, ``starts``, ``slots``, ``process_noise_std``, and where given ``loss``, the
            probability that an update is lost.

    Returns:
        ``score`` (normalised), ``failed`` (share), ``cost`` (quadratic), ``bits_per_slot``, and the curve ``in_box``,
        the share of starts in the box, averaged over every :data:`CURVE_STEP` slots.
    """
    rows = []
    for seed in range(point["seeds"]):
        starts, policy = starts_of(point, seed), RemotePolicy(point, seed)
        loop = run(starts, policy)
        rows.append(
            {
                "seed": seed,
                "score": normalized_score(loop.raw_score(), optimal_scores(*astuple(starts))),
                "raw_score": float(loop.raw_score().mean()),
                "failed": float(loop.failed().float().mean()),
                "cost": float(loop.quadratic_cost().mean()),
                "bits_per_slot": policy.bits / (point["starts"] * point["slots"]),
                "in_box": thinned(loop.in_box().float().mean(1)),
            }
        )
    return rows


def command_rows(point: dict) -> list[dict]:
    """Command error over 40 N of a point's controller, one row a seed: ``nmae`` and its curve ``nmae_by_slot``.

    The expert drives and is the truth. A controller that predicts imagines, from its own commands, the loop that the
    expert really closes.

    Args:
        point: see :func:`loop_rows`.
    """
    rows = []
    for seed in range(point["seeds"]):
        starts = starts_of(point, seed)
        error = command_error(starts, RemotePolicy(point, seed, expert_camera(*astuple(starts))))
        rows.append({"seed": seed, "nmae": float(error.mean()), "nmae_by_slot": thinned(error)})
    return rows


def starts_of(point: dict, seed: int) -> Starts:
    """The starts of one seed of a point; every controller with the same frame history has the same ones."""
    model = None if point["model"] is None else load(point["model"])
    interval = SAMPLING_INTERVAL if model is None else model.spec.slot
    history = FRAME_HISTORY if model is None else max(FRAME_HISTORY, model.frame_history)
    return Starts(seed, point["starts"], point["slots"], history, interval, point["process_noise_std"])


@lru_cache(maxsize=4)
def load(model: str):
    """An entry of the zoo, kept for the next point."""
    import tsjepa

    return tsjepa.load(model)


@lru_cache(maxsize=64)
def optimal_scores(*starts) -> Tensor:
    """Raw scores [N] of the optimal policy with perfect feedback on the same starts and noise.

    It is the reference LQR, which over the evaluation starts is the better of the two that we have.
    """
    from tsjepa.plants.expert import reference_lqr

    starts = Starts(*starts)
    scores = run(starts, true_state_policy(reference_lqr(starts.sampling_interval), 1)).raw_score()
    if not scores.any():
        raise ValueError(
            f"None of {starts.count} starts is in the box within {starts.slots} slots even with perfect feedback, so "
            "scores cannot be normalised; raise starts or slots."
        )
    return scores


def command_error(starts: Starts, policy: Callable) -> Tensor:
    """Distance of the policy's commands to the expert's over 40 N [T], averaged over starts that the expert drives."""
    expert, commands = CartPole().experts()["expert"], []

    def driver(slot: int, observation) -> Tensor:
        commands.append(policy(slot, observation))
        return expert(observation["state"])

    _, action = run(starts, driver)
    return (torch.stack(commands) - action).abs().mean((1, 2)) / COMMAND_RANGE


@torch.no_grad()
def expert_embeddings(point: dict, seed: int) -> Tensor:
    """Embeddings [N, d] of every :data:`CURVE_STEP`-th slot of loops that the expert closes from a seed's starts."""
    from tsjepa.plants.expert import Expert

    starts, model = starts_of(point, seed), load(point["model"])
    camera, expert, seen = expert_camera(*astuple(starts)), Expert(starts.sampling_interval), []

    def driver(slot: int, observation) -> Tensor:
        if slot % CURVE_STEP == 0:
            seen.append(model.encode(camera.stacks(model, slot, observation)))
        return expert(observation["state"])

    run(starts, driver)
    return torch.cat(seen)


def thinned(curve: Tensor) -> list[float]:
    """A curve [T] averaged over every :data:`CURVE_STEP` slots; what is left over at its end is dropped."""
    return curve[: len(curve) // CURVE_STEP * CURVE_STEP].view(-1, CURVE_STEP).mean(1).tolist()


class Camera:
    """The frames of one loop, of which each is rendered once however many stacks it is in."""

    def __init__(self) -> None:
        self.plant, self.frames = CartPole(), {}

    def stacks(self, model, slot: int, observation) -> Tensor:
        """Frames uint8 [N, kappa, H, W, 3] that a model stacks; the plants may keep more than it needs.

        Args:
            model: a controller.
            slot: of the loop.
            observation: of the plants in this slot.
        """
        spacing, kappa = model.frame_spacing, model.frame_stack
        slots = [slot - spacing * back for back in reversed(range(kappa))]
        missing = [wanted for wanted in slots if wanted not in self.frames]
        if missing:
            # the last of the remembered positions is that of this slot
            scene = observation["scene"][:, [wanted - slot - 1 for wanted in missing]]
            rendered = torch.from_numpy(self.plant.render(scene.flatten(0, 1).numpy())).unflatten(0, scene.shape[:2])
            self.frames |= dict(zip(missing, rendered.unbind(1), strict=True))
        return torch.stack([self.frames[wanted] for wanted in slots], 1)


@lru_cache(maxsize=8)
def expert_camera(*starts) -> Camera:
    """The camera on a loop that the expert closes from these starts, kept for the next controller that watches it."""
    return Camera()


class RemotePolicy:
    """The controller at the far end of a link: an update every so many slots, and what it does in between.

    ``bits`` counts what was sent, over all starts.

    Args:
        point: see :func:`loop_rows`.
        seed: of the losses.
        camera: on the loop, if not its own.
    """

    def __init__(self, point: dict, seed: int, camera: Camera | None = None) -> None:
        self.model = model = None if point["model"] is None else load(point["model"])
        self.period, self.between, self.loss = point["update_every"], point["between"], point.get("loss", 0.0)
        if self.between not in ("predict", "hold", "zero"):
            raise ValueError(f"Between updates a controller cannot {self.between!r}; choose predict, hold or zero.")
        self.bits, self.draws = 0, torch.Generator().manual_seed(seed)
        if model is None:
            self.codec, self.expert = state_codec(point["codec"], CartPole().spec), CartPole().experts()["expert"]
        else:
            self.sender = make_sender(model, point["sends"], point["codec"], point.get("quality"))
            self.camera = camera or Camera()

    @torch.no_grad()
    def __call__(self, slot: int, observation) -> Tensor:
        count = len(observation["state"])
        if slot == 0:
            # a controller that has heard nothing yet sends no force
            self.command, self.informed = torch.zeros(count, 1), torch.zeros(count, dtype=torch.bool)
        elif self.between == "predict":
            self.belief = self.model.predict(self.belief, self.command)
            self.command = torch.where(self.informed[:, None], self.model.act(self.belief), 0.0)
        elif self.between == "zero":
            self.command = torch.zeros(count, 1)
        if is_update(slot, self.period):
            arrived = torch.rand(count, generator=self.draws) >= self.loss
            self._receive(slot, observation, arrived)
        return self.command

    def _receive(self, slot: int, observation, arrived: Tensor) -> None:
        if self.model is None:
            packets = self.codec.encode(observation["state"])
            bits, command = payload_bits(packets), self.expert(self.codec.decode(packets))
        else:
            received, bits = self.sender.send(self.camera.stacks(self.model, slot, observation), slot == 0)
            self.belief = received if slot == 0 else torch.where(arrived[:, None], received, self.belief)
            command = self.model.act(received)
        self.command = torch.where(arrived[:, None], command, self.command)
        self.informed |= arrived
        self.bits += int(bits.sum())
