"""Every sensible part of the chain satisfies its specs: batch shapes, SerialEnv, clones and partial resets."""

from functools import partial

import pytest
import torch
from chains import camera, embed, state_chain, whole_chain
from linear_fleet import LinearFleet, render
from torchrl.envs import Compose, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tsjepa.envs.transforms import (
    Acknowledge,
    Actuator,
    Camera,
    Channel,
    Codec,
    Delay,
    Encode,
    Energy,
    Estimator,
    HoldCommand,
    Scheduler,
    Uplink,
)
from tsjepa.envs.transforms.delay import ACKNOWLEDGED
from tsjepa.envs.transforms.uplink import AT_BASE_STATION
from tsjepa.radio import GilbertElliott, IidLoss
from tsjepa.radio.codecs import FloatCodec, ImageCodec
from tsjepa.radio.delay import UniformDelay
from tsjepa.radio.energy import EnergyModel
from tsjepa.radio.links import McsLink

CHAINS = {
    "channel": lambda: [Channel()],
    "correlated": lambda: [Channel(max_doppler_hz=10.0)],
    "no fading": lambda: [Channel(fading="none", snr_target_db=10.0)],
    "iid loss": lambda: [Channel(loss=IidLoss(0.2)), Uplink(in_key=None)],
    "bursts": lambda: [Channel(loss=GilbertElliott(0.1, 0.3)), Uplink(in_key=None)],
    "literal": lambda: [Channel.paper_literal(), Scheduler("channel_aware_literal", 1), Uplink(in_key=None)],
    "scheduler alone": lambda: [Scheduler("round_robin", resource_blocks=1)],
    "without channel": lambda: [Scheduler("max_age", resource_blocks=1), Uplink(in_key=None)],
    "delayed": lambda: state_chain(Scheduler("opportunistic", 2, csi="delayed", csi_delay=3)),
    "statistical": lambda: state_chain(Scheduler("whittle", 2, csi="statistical")),
    "units": lambda: state_chain(Scheduler("proportional_fair", payload_bits=64, units=3)),
    "uplink alone": lambda: [Uplink(in_key=None)],
    "camera alone": lambda: [camera()],
    "single device": lambda: [camera(), Encode(embed, 12), Codec(FloatCodec(16)), Uplink()],
    "drop": lambda: state_chain(when_lost="drop", aoi_reset="scheduled"),
    "oracle": lambda: state_chain(Scheduler("oracle", 2), lossless=True),
    "hold": lambda: [Channel(), Scheduler("random", 1), Uplink(in_key=None), HoldCommand()],
    "frames": lambda: [
        Channel(),
        Scheduler("max_weight", 2),
        camera(),
        Codec(ImageCodec("png", height=4, width=8), in_key="pixels"),
        Uplink(),
        Encode(embed, 12, in_key="received", mask_key="delivered"),
        Estimator(lambda z, u: z, in_key="embedding", blend=0.5),
    ],
    "whole": whole_chain,
    "repetition": lambda: [Channel(repetition_s=0.008), Uplink(in_key=None, repeats=True), Energy(EnergyModel())],
    "block errors": lambda: [Channel(), Codec(FloatCodec(), in_key="state"), Uplink(mcs=McsLink(5))],
    "delays": lambda: [
        Channel(max_doppler_hz=5.0),
        Scheduler("max_age", 2, outcome_keys=ACKNOWLEDGED),
        Codec(FloatCodec(), in_key="state"),
        Uplink(in_key=None, keys=AT_BASE_STATION),
        Acknowledge(0.2, AT_BASE_STATION[0]),
        Delay(UniformDelay(0, 3), horizon=3),
        Actuator(0.3, UniformDelay(0, 2), every=2),
        Estimator(lambda z, u: z, horizon=3),
    ],
}


def make_env(name, batch_size=(4,)):
    lengths = torch.arange(1, batch_size[-1] + 1)
    return TransformedEnv(LinearFleet(batch_size, lengths), Compose(*CHAINS[name]()))


@pytest.mark.parametrize("batch_size", [(4,), (2, 3)])
@pytest.mark.parametrize("name", CHAINS)
def test_specs(name, batch_size):
    check_env_specs(make_env(name, batch_size), break_when_any_done="both")


@pytest.mark.parametrize("name", ["channel", "delayed", "units", "hold", "frames", "whole"])
def test_specs_in_a_serial_env(name):
    check_env_specs(SerialEnv(2, partial(make_env, name)), break_when_any_done="both")


@pytest.mark.parametrize("name", ["delayed", "bursts", "whole"])
def test_a_clone_of_the_chain_replays_it(name):
    env = make_env(name)
    cloned = TransformedEnv(LinearFleet((4,), torch.arange(1, 5)), env.transform.clone())
    check_env_specs(cloned)
    env, cloned = make_env(name), TransformedEnv(LinearFleet((4,), torch.arange(1, 5)), env.transform.clone())
    cloned = TransformedEnv(LinearFleet((4,), torch.arange(1, 5)), Compose(*[t.clone() for t in env.transform]))
    policy = lambda td: td.set("action", -td["state"][..., :1])  # noqa: E731
    first = env.rollout(12, policy, break_when_any_done=False)
    second = cloned.rollout(12, policy, break_when_any_done=False)
    assert (first == second).all()


def test_a_rollout_can_branch_from_a_saved_tensordict():
    """All state is in the tensordict: stepping a copy of it on gives the same future."""
    env = TransformedEnv(LinearFleet((5,)), Compose(*whole_chain(Scheduler("round_robin", 2))))
    policy = lambda td: td.set("action", torch.full((5, 1), 0.3))  # noqa: E731
    start = env.rollout(6, policy)[..., -1]["next"].exclude("reward")
    future = [env.rollout(5, policy, auto_reset=False, tensordict=start.clone()) for _ in range(2)]
    assert (future[0] == future[1]).all()


def test_a_missing_neighbour_is_named():
    with pytest.raises(KeyError, match="put a Codec"):
        TransformedEnv(LinearFleet(), Uplink()).reset()
    with pytest.raises(KeyError, match="put a Channel"):
        TransformedEnv(LinearFleet(), Scheduler("max_age", payload_bits=64)).reset()
    with pytest.raises(KeyError, match="put an Uplink"):
        TransformedEnv(LinearFleet(), HoldCommand()).reset()
    with pytest.raises(ValueError, match="frame_history of 5"):
        TransformedEnv(LinearFleet(), Camera(render, (4, 8), frame_stack=3, frame_spacing=2)).reset()


def test_bad_arguments_are_rejected():
    with pytest.raises(ValueError, match="either resource_blocks"):
        Scheduler("max_age")
    with pytest.raises(ValueError, match="either resource_blocks"):
        Scheduler("max_age", resource_blocks=2, payload_bits=64)
    with pytest.raises(ValueError, match="unknown csi"):
        Scheduler("max_age", 2, csi="none")
    with pytest.raises(ValueError, match="unknown fading"):
        Channel(fading="rice")
    with pytest.raises(ValueError, match="max_doppler_hz"):
        Channel(max_doppler_hz=-1.0)
    with pytest.raises(ValueError, match="when_lost"):
        Uplink(when_lost="retry")
    with pytest.raises(ValueError, match="aoi_reset"):
        Uplink(aoi_reset="sent")
    with pytest.raises(ValueError, match="blend"):
        Estimator(lambda z, u: z, blend=0.0)
    with pytest.raises(ValueError, match="frame_stack"):
        Camera(render, (4, 8), frame_stack=0)
