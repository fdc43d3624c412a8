"""No trajectory that a model may learn from, or a figure is tuned on, starts where the evaluation starts."""

import pytest
import tiny_controller

from tsjepa.data.collect import Split, collect
from tsjepa.evaluation import rollouts
from tsjepa.evaluation.rollouts import Loop, every
from tsjepa.models import entries
from tsjepa.paper import frame_change, tsne
from tsjepa.plants import CartPole
from tsjepa.support.seeds import HELD_OUT

SEEDS = (0, 1, 7, 1000, 1001, HELD_OUT - 1, HELD_OUT, HELD_OUT + 1, 2**40)  # that somebody gives by hand
EVALUATION = range(HELD_OUT, HELD_OUT + 10_000)


@pytest.fixture
def drawn(monkeypatch):
    """The streams that cart-poles have drawn starts from, by what they were drawn for; and how to note them."""
    streams, real = {}, CartPole.start

    def noting(purpose: str, do):
        def start(plant, seed, device, episode):
            streams.setdefault(purpose, set()).add(seed)
            return real(plant, seed, device, episode)

        with monkeypatch.context() as patch:
            patch.setattr(CartPole, "start", start)
            do()
        streams[purpose].discard(0)  # an environment looks at a start of stream 0 to learn its shapes

    return streams, noting


@pytest.mark.slow
def test_collected_and_drawn_for_figures_never_meet_the_evaluation(drawn, tmp_path):
    streams, noting = drawn
    model = str(entries.save(tiny_controller.tiny(), tmp_path / "model"))
    splits = {"train": Split(1), "test": Split(1, coverage=False)}
    loop = every(Loop(CartPole(), num_devices=2, slots=2), 1)
    for seed in SEEDS:
        folder = str(tmp_path / f"data-{seed}")
        noting(f"collect {seed}", lambda seed=seed, folder=folder: collect(folder, CartPole(), splits, 2, seed=seed))
        noting("evaluate", lambda seed=seed: rollouts.run(loop, seed % 1000))
    point = {"model": model, "trajectories": 2, "slots": 6}
    for seed in range(5):
        noting(f"t-SNE {seed}", lambda seed=seed: tsne.trajectories(point | {"every": 5}, seed))
        noting(f"colours {seed}", lambda seed=seed: tsne.two_colours(entries.load(model), 2, seed))
        noting(f"frame change {seed}", lambda seed=seed: frame_change.consecutive_frames(0.2, seed, 2, 1))
    held_out = streams.pop("evaluate")
    assert held_out == {HELD_OUT + seed % 1000 for seed in SEEDS}
    assert held_out < set(EVALUATION)
    assert all(streams.values())
    assert not set.union(*streams.values()) & set(EVALUATION)
    # nor do two of them share a stream: every split, data set and figure has its own
    assert len(set.union(*streams.values())) == sum(map(len, streams.values()))
    assert all(len(streams[f"collect {seed}"]) == len(splits) for seed in SEEDS)


def test_streams_that_differ_draw_other_starts():
    """All 64 bits of a stream count: a short key would bring two of them together again."""
    import numpy as np

    device, plant = np.arange(4), CartPole()
    starts = {plant.start(stream, device, 0 * device).tobytes() for stream in (1, 1 + 2**32, 1 + 2**62, 2**33)}
    assert len(starts) == 4
