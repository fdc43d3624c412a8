"""Searches for a law of the cart-pole that scores more than its regulators, by gradient through the exact equations.

    python tests/benchmarks/search_expert.py            # about four minutes of one core
    python tests/benchmarks/search_expert.py --plans    # and a plan for every start alone, which no law has to reach

The law is a regulator with saturating terms (tsjepa.plants.bent_lqr), begun at the plant's expert. Its score over 100
slots is made smooth, and the width of the box's edge shrinks while the search goes on. Half of the roll-outs have
process noise. Validation starts choose the law; the held-out starts of the evaluations take no part.

The plans are the forces of 100 slots for each of the evaluation's 5 x 100 starts, without noise and improved by the
same gradient from the law's own: model-predictive control with the exact model over the whole episode. They are local
optima, so the best possible score is at least theirs.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from cartpole_equations import Equations
from torch import Tensor
from tqdm import trange

from tsjepa.evaluation.rollouts import HELD_OUT
from tsjepa.plants import CartPole
from tsjepa.plants.bent_lqr import BentLQR
from tsjepa.plants.cartpole import BOX_ANGLE, BOX_POSITION, MAX_FORCE, START_HALF_WIDTHS
from tsjepa.support.files import write_text
from tsjepa.support.provenance import machine, provenance

SLOTS, NOISE = 100, 0.008
VALIDATION_SEEDS, TEST_SEEDS, STARTS = (50, 51, 52), range(5), 100
WIDEST, NARROWEST = 0.06, 0.008  # of the box's edge, m and rad
MARGIN = 0.003  # the smooth box is this much smaller than the real one
STATE_SCALE = (0.5, 0.2, 1.0, 1.0)
RATES = {"gain": 1.0, "position_clip": 0.01, "directions": 0.05, "heights": 0.4}
PLANT = CartPole()
EQUATIONS = Equations(PLANT)


def starts(seeds) -> tuple[Tensor, ...]:
    """States of the evaluation's starts: x, theta, x_dot, theta_dot, each [N]."""
    device, episode = np.arange(STARTS), np.zeros(STARTS, np.int64)
    return tuple(torch.from_numpy(np.concatenate([PLANT.start(HELD_OUT + seed, device, episode) for seed in seeds]).T))


def smooth_score(state: tuple[Tensor, ...], width: float) -> Tensor:
    """Of a slot, [N]: 1 well within the box, 0 well outside, less what it costs to come near to a failure."""
    inside = torch.sigmoid((BOX_POSITION - MARGIN - state[0].abs()) / width)
    upright = torch.sigmoid((BOX_ANGLE - MARGIN - state[1].abs()) / width)
    danger = torch.relu(state[1].abs() - 0.6).square() + torch.relu(state[0].abs() - 1.5).square()
    return inside * upright - 5 * danger


def true_score(path: list[tuple[Tensor, ...]]) -> Tensor:
    """Mean score [N] of the states after each slot; nothing counts from a failure on."""
    states = torch.stack([torch.stack(state, -1) for state in path])
    fallen = PLANT.failed(states).cummax(0).values
    return (PLANT.score(states) & ~fallen).double().mean(0)


def kicked(state: tuple[Tensor, ...], noise: Tensor | float, generator: torch.Generator) -> tuple[Tensor, ...]:
    """The state with noise on both velocities."""
    draws = (noise * torch.randn(value.shape, generator=generator, dtype=value.dtype) for value in state[2:])
    return *state[:2], *(value + draw for value, draw in zip(state[2:], draws, strict=True))


def drive(
    law, state: tuple[Tensor, ...], noise: Tensor | float, generator: torch.Generator
) -> list[tuple[Tensor, ...]]:
    """States after each slot under ``law``, from states [N, 4] to forces [N]."""
    path = []
    for _ in range(SLOTS):
        state = kicked(EQUATIONS.step(state, law(torch.stack(state, -1))), noise, generator)
        path.append(state)
    return path


def beginning(terms: int, generator: torch.Generator) -> BentLQR:
    """The plant's expert with terms that add nothing yet."""
    expert, spec = PLANT.experts()["expert"], PLANT.spec
    directions = 0.7 * torch.randn(terms, 4, generator=generator, dtype=torch.float64) / torch.tensor(STATE_SCALE)
    heights = torch.zeros(1, terms, dtype=torch.float64)
    return BentLQR(expert.gain, float(expert.position_clip), spec.action_low, spec.action_high, directions, heights)


def search(steps: int, terms: int, batch: int, seed: int) -> BentLQR:
    """The law that validated best."""
    generator = torch.Generator().manual_seed(seed)
    law = beginning(terms, generator)
    parts = dict(law.named_buffers())
    groups = [{"params": [parts[name].requires_grad_()], "lr": rate, "rate": rate} for name, rate in RATES.items()]
    optimizer = torch.optim.Adam(groups)
    half_widths = torch.tensor(START_HALF_WIDTHS, dtype=torch.float64)
    noise = torch.zeros(batch, dtype=torch.float64)
    noise[batch // 2 :] = NOISE

    def leaky(state: Tensor) -> Tensor:
        wanted = law.unsaturated(state)[:, 0]
        given = wanted.clamp(-MAX_FORCE, MAX_FORCE)
        # the same force, but a little of the gradient where the actuator saturates
        return given + 0.05 * (wanted - wanted.detach()) * (given != wanted)

    best, kept = 0.0, None
    progress = trange(steps, desc="search", unit="step")
    for step in progress:
        share = step / steps
        width = WIDEST * (NARROWEST / WIDEST) ** min(1.0, share / 0.7)
        for group in optimizer.param_groups:
            group["lr"] = group["rate"] * (1.01 - share)
        state = tuple(((2 * torch.rand(batch, 4, generator=generator, dtype=torch.float64) - 1) * half_widths).T)
        path = drive(leaky, state, noise, generator)
        loss = -torch.stack([smooth_score(after, width) for after in path]).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(list(parts[name] for name in RATES), 1.0)
        optimizer.step()
        if (step + 1) % 40 == 0 or step + 1 == steps:
            score, failures = validated(law)
            progress.set_postfix(score=f"{score:.4f}", failures=failures)
            if failures == 0 and score > best:
                best, kept = score, {name: tensor.detach().clone() for name, tensor in law.named_buffers()}
    law = beginning(terms, generator)
    if kept is not None:
        law.load_state_dict({name: kept[name] for name in law.state_dict()})
    return law


@torch.no_grad()
def validated(law: BentLQR) -> tuple[float, int]:
    """Mean score with and without noise on the validation starts, and how many fail."""
    score, failures = 0.0, 0
    for noise in (0.0, NOISE):
        path = drive(lambda state: law(state)[:, 0], starts(VALIDATION_SEEDS), noise, torch.Generator().manual_seed(1))
        score += float(true_score(path).mean()) / 2
        failures += int(torch.stack([PLANT.failed(torch.stack(state, -1)) for state in path]).any(0).sum())
    return score, failures


def plans(law: BentLQR, steps: int) -> list[float]:
    """Mean score of the best plan found for each of the evaluation's starts, by seed, without noise."""
    begin, forces = starts(TEST_SEEDS), []
    with torch.no_grad():
        path = drive(lambda state: forces.append(law(state)[:, 0]) or forces[-1], begin, 0.0, torch.Generator())
        best = true_score(path)
    raw = torch.atanh(torch.stack(forces).div(MAX_FORCE).clamp(-0.98, 0.98)).requires_grad_()
    optimizer = torch.optim.Adam([raw], lr=0.02)
    progress = trange(steps, desc="plans", unit="step")
    for step in progress:
        width = 0.02 * (0.003 / 0.02) ** min(1.0, step / (0.7 * steps))
        optimizer.param_groups[0]["lr"] = 0.02 * (1.01 - step / steps)
        state, path = begin, []
        for force in MAX_FORCE * torch.tanh(raw):
            state = EQUATIONS.step(state, force)
            path.append(state)
        loss = -torch.stack([smooth_score(after, width) for after in path]).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        best = torch.maximum(best, true_score([tuple(x.detach() for x in after) for after in path]))
        progress.set_postfix(score=f"{float(best.mean()):.4f}")
    return best.view(len(TEST_SEEDS), STARTS).mean(1).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=600, help="of the search")
    parser.add_argument("--terms", type=int, default=16, help="saturating terms of the law")
    parser.add_argument("--batch", type=int, default=192, help="roll-outs a step")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plans", type=int, nargs="?", const=300, default=0, help="steps of the plans for each start")
    parser.add_argument("--output", type=Path, default=Path("runs/search-expert/law.json"))
    arguments = parser.parse_args()
    law = search(arguments.steps, arguments.terms, arguments.batch, arguments.seed)
    score, failures = validated(law)
    result = {"made_by": provenance(), "machine": machine(), "validation_score": score, "validation_failures": failures}
    result["law"] = {name: tensor.tolist() for name, tensor in law.named_buffers() if name in RATES}
    if arguments.plans:
        result["plans_score_by_seed"] = plans(law, arguments.plans)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    write_text(arguments.output, json.dumps(result, indent=1) + "\n")
    print(f"Validation score {score:.4f}, {failures} failures; the law is in {arguments.output}.")


if __name__ == "__main__":
    main()
