"""Searches for a law of the cart-pole for fleets, whose machines are heard of late and seldom (CMA-ES).

    python tests/benchmarks/search_fleet_law.py            # eight minutes of one core

Each machine is one of 140 under channel_aware on 10 resource blocks. Who is heard when depends on the channels alone,
so the schedules are recorded once. What arrives has errors as large as those of an observer's embedding; between
updates the linear model predicts. The law is a regulator with saturating terms (tsjepa.plants.bent_lqr), begun at the
plant's expert, and its score over 400 slots under process noise is what CMA-ES (Hansen, arXiv 1604.00772) improves.
Three seeds are searched on and three others print what the law is worth; those of the evaluations take no part.
"""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
from cartpole_equations import Equations
from torch import Tensor
from tqdm import trange

from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop, run
from tsjepa.plants import CartPole
from tsjepa.plants.bent_lqr import BentLQR
from tsjepa.plants.cartpole import EXPERT, FAILURE_ANGLE, FAILURE_POSITION, MAX_FORCE, START_HALF_WIDTHS
from tsjepa.support.files import write_text
from tsjepa.support.provenance import machine, provenance

DEVICES, SLOTS, NOISE = 140, 400, 0.008
SEARCHED_ON, CHECKED_ON = (60, 61, 62), (63, 64, 65)
SEEN_STD = (0.002, 0.002, 0.008, 0.010)  # of what arrives: m, rad, m/s, rad/s
STATE_SCALE = (0.5, 0.2, 1.0, 1.0)
HEIGHT = 5.0  # newtons of a saturating term per unit of its parameter
FIRST_STEP = 0.25
RADIO = Radio(resource_blocks=10, codec="fp32", snr_target_db=10, snr_threshold_db=5, csi="perfect")
PLANT = CartPole(process_noise_std=NOISE)
EQUATIONS = Equations(PLANT)

Act = Callable[[Tensor], Tensor]


class World(NamedTuple):
    """What happens to the machines whatever the law: who is heard, starts, process noise, errors of what arrives."""

    delivered: Tensor  # [T, N] bool
    start: Tensor  # [N, 4]
    kicks: Tensor  # [T, N, 4]
    errors: Tensor  # [T + 1, N, 4]


def world(seeds: tuple[int, ...]) -> World:
    """Of the channels of several seeds, side by side."""
    heard = [run(Loop(PLANT, "hold", "channel_aware", DEVICES, SLOTS, RADIO), seed).delivered for seed in seeds]
    delivered = torch.cat(heard, 1)
    generator = torch.Generator().manual_seed(1000 + seeds[0])
    count = delivered.shape[1]
    start = (2 * torch.rand(count, 4, generator=generator) - 1) * torch.tensor(START_HALF_WIDTHS)
    kicks = NOISE * torch.randn(SLOTS, count, 2, generator=generator)
    errors = torch.randn(SLOTS + 1, count, 4, generator=generator) * torch.tensor(SEEN_STD)
    return World(delivered, start, torch.cat([torch.zeros_like(kicks), kicks], -1), errors)


def score(act: Act, laws: int, given: World, always: bool = False) -> tuple[Tensor, Tensor]:
    """Mean score and share of failures of each law, [P], of which ``act`` takes beliefs [P, N, 4] to forces [P, N].

    With ``always`` the true state arrives in every slot.
    """
    a, b = (matrix.float() for matrix in PLANT.linearised())
    state = given.start.expand(laws, *given.start.shape)
    belief = torch.zeros_like(state)
    informed = torch.zeros(state.shape[:2], dtype=torch.bool)
    failed, total, lost = torch.zeros_like(informed), torch.zeros(laws), torch.tensor([2.0, 1.0, 0.0, 0.0])
    for slot, heard in enumerate(given.delivered):
        arrives = torch.ones_like(heard) if always else heard
        seen = state if always else state + given.errors[slot]
        belief = torch.where(arrives[:, None], seen, belief)
        informed = informed | arrives
        force = torch.where(informed, act(belief), 0.0)
        state = torch.stack(EQUATIONS.step(state.unbind(-1), force), -1) + given.kicks[slot]
        belief = (belief @ a.mT + force[..., None] * b[:, 0]).clamp(-1e3, 1e3)
        failed |= (state[..., 0].abs() > FAILURE_POSITION) | (state[..., 1].abs() > FAILURE_ANGLE)
        state = torch.where(failed[..., None], lost, state)  # kept where it counts for nothing
        total += (PLANT.score(state) & ~failed).float().mean(1)
    return total / SLOTS, failed.float().mean(1)


class Laws:
    """Laws of one family from parameters [P, 6 + 5 h]: the expert's with gains, clip and limit scaled, and h terms."""

    def __init__(self, parameters: Tensor) -> None:
        expert = PLANT.experts()[EXPERT]
        self.gain = expert.gain[0].float() * torch.exp(parameters[:, :4])
        self.clip = expert.position_clip * torch.exp(parameters[:, 4])
        self.limit = MAX_FORCE * torch.exp(parameters[:, 5]).clamp(max=1)
        terms = parameters[:, 6:].unflatten(1, (-1, 5))
        self.heights, self.directions = HEIGHT * terms[..., 0], terms[..., 1:] / torch.tensor(STATE_SCALE)

    def __len__(self) -> int:
        return len(self.gain)

    def __call__(self, state: Tensor) -> Tensor:
        clip, limit = self.clip[:, None, None], self.limit[:, None]
        position = torch.minimum(torch.maximum(state[..., :1], -clip), clip)
        force = -(torch.cat([position, state[..., 1:]], -1) * self.gain[:, None]).sum(-1)
        bends = torch.tanh(torch.einsum("pni,phi->pnh", state, self.directions))
        force = force + (bends * self.heights[:, None]).sum(-1)
        return torch.minimum(torch.maximum(force, -limit), limit)

    def module(self) -> BentLQR:
        """The first of them as the package has it."""
        limit = (float(self.limit[0]),)
        parts = self.gain[:1], float(self.clip[0]), (-limit[0],), limit, self.directions[0], self.heights[:1]
        return BentLQR(*parts)


class Evolution:
    """CMA-ES with the defaults of arXiv 1604.00772 (weights of the worse half left out), for the largest value.

    Args:
        mean: first centre [D].
        step: first step size.
        generator: of the samples.
    """

    def __init__(self, mean: Tensor, step: float, generator: torch.Generator) -> None:
        size = len(mean)
        self.mean, self.step, self.generator, self.generation = mean, step, generator, 0
        self.population = 8 + 2 * int(3 * math.log(size))
        parents = self.population // 2
        weights = math.log(parents + 0.5) - torch.arange(1, parents + 1).float().log()
        self.weights = weights / weights.sum()
        self.mass = float(1 / self.weights.square().sum())
        self.path_rate = (self.mass + 2) / (size + self.mass + 5)
        self.damping = 1 + 2 * max(0.0, math.sqrt((self.mass - 1) / (size + 1)) - 1) + self.path_rate
        self.shape_rate = (4 + self.mass / size) / (size + 4 + 2 * self.mass / size)
        self.rank_one = 2 / ((size + 1.3) ** 2 + self.mass)
        self.rank_many = min(1 - self.rank_one, 2 * (self.mass - 2 + 1 / self.mass) / ((size + 2) ** 2 + self.mass))
        self.expected = math.sqrt(size) * (1 - 1 / (4 * size) + 1 / (21 * size * size))
        self.shape, self.path, self.shape_path = torch.eye(size), torch.zeros(size), torch.zeros(size)

    def ask(self) -> Tensor:
        """Samples [population, D]."""
        values, vectors = torch.linalg.eigh(self.shape)
        self.roots, self.vectors = values.clamp(min=1e-12).sqrt(), vectors
        draws = torch.randn(self.population, len(self.mean), generator=self.generator)
        self.moves = draws @ (vectors * self.roots).mT
        return self.mean + self.step * self.moves

    def tell(self, values: Tensor) -> None:
        """Moves towards the samples with the largest of the ``values`` [population]."""
        best = self.moves[values.argsort(descending=True)[: len(self.weights)]]
        move = self.weights @ best
        self.generation += 1
        self.mean = self.mean + self.step * move
        whitened = self.vectors @ ((self.vectors.mT @ move) / self.roots)
        pull = math.sqrt(self.path_rate * (2 - self.path_rate) * self.mass)
        self.path = (1 - self.path_rate) * self.path + pull * whitened
        length = float(self.path.norm())
        fades = math.sqrt(1 - (1 - self.path_rate) ** (2 * self.generation))
        steady = length / fades < (1.4 + 2 / (len(move) + 1)) * self.expected
        pull = math.sqrt(self.shape_rate * (2 - self.shape_rate) * self.mass)
        self.shape_path = (1 - self.shape_rate) * self.shape_path + steady * pull * move
        self.step *= math.exp(self.path_rate / self.damping * (length / self.expected - 1))
        spread = torch.einsum("k,ki,kj->ij", self.weights, best, best)
        kept = 1 - self.rank_one - self.rank_many
        self.shape = (
            kept * self.shape + self.rank_one * self.shape_path.outer(self.shape_path) + self.rank_many * spread
        )


@torch.no_grad()
def search(generations: int, terms: int, seed: int) -> tuple[Laws, dict[str, float]]:
    """The centre of the last generation, and what it and the plant's regulators are worth on the seeds to check on."""
    searched, checked = world(SEARCHED_ON), world(CHECKED_ON)
    normaliser = law_of(PLANT.normaliser)
    optimal = float(score(normaliser, 1, checked, always=True)[0])
    generator = torch.Generator().manual_seed(seed)
    begin = torch.zeros(6 + 5 * terms)
    begin[6:] = 0.3 * torch.randn(5 * terms, generator=generator)
    begin[6::5] = 0.0  # no height: the search begins at the expert
    evolution = Evolution(begin, FIRST_STEP, generator)
    progress = trange(generations, desc="search", unit="generation")
    for _ in progress:
        laws = Laws(evolution.ask())
        values, _ = score(laws, len(laws), searched)
        evolution.tell(values)
        progress.set_postfix(raw_score=f"{float(values.mean()):.4f}", step=f"{evolution.step:.3f}")
    found = Laws(evolution.mean[None])
    worth = {}
    for name, law in {EXPERT: law_of(EXPERT), PLANT.normaliser: normaliser, "found": found}.items():
        value, failures = score(law, 1, checked)
        worth |= {name: float(value) / optimal, f"{name}, failed": float(failures)}
    return found, worth


def law_of(name: str) -> Act:
    """One of the plant's experts, from beliefs to forces."""
    expert = PLANT.experts()[name]
    return lambda belief: expert(belief)[..., 0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generations", type=int, default=150)
    parser.add_argument("--terms", type=int, default=4, help="saturating terms of the law")
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--output", type=Path, default=Path("runs/search-fleet-law/law.json"))
    arguments = parser.parse_args()
    found, worth = search(arguments.generations, arguments.terms, arguments.seed)
    result = {"made_by": provenance(), "machine": machine(), "normalised_score": worth}
    result["law"] = {name: tensor.tolist() for name, tensor in found.module().named_buffers()}
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    write_text(arguments.output, json.dumps(result, indent=1) + "\n")
    print(", ".join(f"{name} {value:.4f}" for name, value in worth.items()))
    print(f"The law is in {arguments.output}.")


if __name__ == "__main__":
    main()
