"""A device that remembers sends its belief, as worked out by hand; a memory that keeps nothing changes nothing."""

import pytest
import tiny_controller
import torch
from linear_fleet import LinearFleet
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tsjepa.envs.settings import Radio, Requests
from tsjepa.envs.transforms import Channel, Codec, Encode, Estimator, Observe, Scheduler, Uplink
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.models import Observer
from tsjepa.plants import CartPole
from tsjepa.radio.codecs import FloatCodec

PLANT = CartPole()


def correct(belief, command, embedding):
    return 0.5 * belief + 0.2 * command + 0.3 * embedding


def chain(lengths=None, begin=None):
    """A fleet whose state stands for what is seen."""
    encode = Encode(lambda state: 2 * state, 2, in_key="state")
    sends = [Channel(snr_target_db=8.0), encode, Observe(correct, begin), Scheduler("channel_aware", 2)]
    estimator = Estimator(lambda belief, action: 0.9 * belief)
    return TransformedEnv(LinearFleet((6,), lengths), Compose(*sends, Codec(FloatCodec()), Uplink(), estimator))


def policy(tensordict):
    return tensordict.set("action", torch.sin(tensordict["slot"] + torch.arange(6.0)).unsqueeze(-1))


def test_its_specs_hold():
    check_env_specs(chain())


def test_a_device_believes_what_follows_from_its_last_belief_and_sends_that():
    data = chain().rollout(20, policy, break_when_any_done=False)
    belief = 2 * data["state"][:, 0]
    for slot in range(20):
        if slot:
            belief = correct(belief, data["action"][:, slot - 1], 2 * data["state"][:, slot])
        torch.testing.assert_close(data["embedding"][:, slot], belief)
        heard = data["delivered"][:, slot]
        torch.testing.assert_close(data["received"][heard, slot], belief[heard])
    assert 0 < data["delivered"].float().mean() < 1


def test_a_new_episode_begins_with_what_is_seen():
    data = chain(lengths=[7, 50, 50, 50, 50, 50]).rollout(12, policy, break_when_any_done=False)
    torch.testing.assert_close(data["embedding"][0, 7], 2 * data["state"][0, 7])
    others = correct(data["embedding"][1:, 6], data["action"][1:, 6], 2 * data["state"][1:, 7])
    torch.testing.assert_close(data["embedding"][1:, 7], others)


def test_only_those_that_start_begin_with_their_warm_up():
    data = chain([7, 50, 50, 50, 50, 50], lambda scene: scene.flatten(1)[:, :2] + 5).rollout(
        12, policy, break_when_any_done=False
    )
    torch.testing.assert_close(data["embedding"][:, 0], data["scene"][:, 0].flatten(1)[:, :2] + 5)
    torch.testing.assert_close(data["embedding"][0, 7], data["scene"][0, 7].flatten()[:2] + 5)
    others = correct(data["embedding"][1:, 6], data["action"][1:, 6], 2 * data["state"][1:, 7])
    torch.testing.assert_close(data["embedding"][1:, 7], others)


def test_what_is_missing_in_front_of_it_is_named():
    with pytest.raises(KeyError, match="put a Camera and an Encode before it"):
        TransformedEnv(LinearFleet((6,)), Compose(Observe(correct))).reset()


@pytest.mark.parametrize(
    ("scheduler", "requests"), [("channel_aware", None), ("urgency", Requests(bits=4)), ("round_robin", None)]
)
def test_an_observer_that_takes_every_embedding_as_it_is_changes_nothing(scheduler, requests):
    """It makes every device look in every slot, which must not show."""
    model = tiny_controller.tiny()
    radio = Radio(resource_blocks=2, codec="fp32", requests=requests)
    runs = []
    for observer in (None, Observer(tiny_controller.DIM, gain=1.0)):
        model.observer = observer
        runs.append(run(Loop(PLANT, model, scheduler, num_devices=5, slots=15, radio=radio), 0))
    for name in ("state", "action", "delivered", "age"):
        torch.testing.assert_close(getattr(runs[1], name), getattr(runs[0], name), atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize(("spacing", "history"), [(1, 2), (1, 4), (2, 3), (2, 6)])
def test_an_episode_starts_with_what_the_warm_up_has_shown(spacing, history):
    model = tiny_controller.tiny(frame_spacing=spacing)
    model.observer = Observer(tiny_controller.DIM, gain=0.3)
    loop = Loop(PLANT, model, "none", num_devices=3, slots=2, frame_history=history)
    now = loop.env(0).reset()
    pictures = torch.from_numpy(PLANT.render(now["scene"].flatten(0, 1).numpy())).unflatten(0, (3, history))
    belief = model.encode(pictures[:, [0, spacing]])
    for first in range(1, history - spacing):
        belief = model.correct(belief, torch.zeros(3, 1), model.encode(pictures[:, [first, first + spacing]]))
    torch.testing.assert_close(now["device_belief"], belief, atol=1e-5, rtol=1e-5)


def test_what_a_controller_hears_of_is_what_the_device_has_watched_meanwhile():
    model = tiny_controller.tiny()
    model.observer = Observer(tiny_controller.DIM, gain=0.3)
    seen, told = [], []

    def watch(slot, now):
        seen.append(model.encode(torch.from_numpy(PLANT.render(now["scene"][0, -2:].numpy()))[None]))
        told.append((now["belief"][:1], now["action"][:1]))

    run(every(Loop(PLANT, model, "none", num_devices=1, slots=11), 10), 0, watch)
    belief = seen[0]
    for slot in range(1, 11):
        belief = model.correct(belief, told[slot - 1][1], seen[slot])
    torch.testing.assert_close(told[10][0], belief, atol=1e-5, rtol=1e-5)
    assert not torch.allclose(told[10][0], seen[10], atol=1e-3)
