"""Drive: the plant obeys the expert, and the chain behind it sees what the policy commands."""

import torch
from torchrl.envs.utils import check_env_specs

from tsjepa.envs import make_env
from tsjepa.envs.transforms import Drive
from tsjepa.plants import CartPole

LEFT = -3.0  # newtons


def stepped(controller: str, drive: bool):
    """One step under a constant command, and the expert."""
    plant = CartPole(set_point_step=0.5)
    env = make_env(plant, 3, "round_robin", controller=controller, seed=1)
    expert = plant.experts()["reference LQR"]
    if drive:
        env.insert_transform(0, Drive(expert))
    return env.step(env.reset().set("action", torch.full((3, 1), LEFT))), expert


def test_the_plant_gets_the_experts_command_for_its_state_and_set_point():
    now, expert = stepped("linear", drive=True)
    again = make_env(CartPole(set_point_step=0.5), 3, "round_robin", controller="linear", seed=1)
    alone = again.reset()
    driven = again.step(alone.set("action", expert(alone["state"], alone["reference"])))
    assert torch.equal(now["next", "state"], driven["next", "state"])
    assert not torch.equal(now["next", "state"], stepped("linear", drive=False)[0]["next", "state"])


def test_what_stands_behind_it_sees_the_policys_own_command():
    for controller, key in (("linear", "belief"), ("hold", "held_command")):
        driven, _ = stepped(controller, drive=True)
        assert torch.equal(driven["action"], torch.full((3, 1), LEFT))
        assert driven.get("own_action", None) is None and driven["next"].get("own_action", None) is None
        delivered = driven["delivered"]
        obeyed, _ = stepped(controller, drive=False)
        unheard = ~driven["next", "delivered"] if controller == "linear" else torch.ones_like(delivered)
        assert torch.equal(driven["next", key][unheard], obeyed["next", key][unheard])


def test_its_specs_are_those_of_the_chain():
    plant = CartPole()
    check_env_specs(make_env(plant, 2, seed=0).insert_transform(0, Drive(plant.experts()["expert"])))
