"""Plants as plain values: through YAML and back, by class path, trusted or refused."""

from __future__ import annotations

import json
import re
import sys

import numpy as np
import pytest
import yaml

from tsjepa.data.collect import Split, collect
from tsjepa.plants import CartPole, DoubleCartPole, Mixed, Pendulum, Reacher, build_plant, describe_plant
from tsjepa.plants.plant import check_plant
from tsjepa.plants.policies import Rest

CHANGED = [
    CartPole(0.01, process_noise_std=(0.1, 0.2), random_colors=True, set_point_step=0.5, set_point_slots=40),
    DoubleCartPole(0.01, start_half_widths=(0.1, 0.0, 0.0, 0.1, 0.1, 0.1)),
    Pendulum(process_noise_std=0.3),
    Reacher(goal_slots=0),
]


class Stranger(CartPole):
    """Somebody else's plant."""


class Forgetful(CartPole):
    """Does not keep its argument."""

    def __init__(self, colour: str = "red") -> None:
        super().__init__()


@pytest.mark.parametrize("plant", CHANGED, ids=lambda plant: type(plant).__name__)
def test_a_plant_comes_back_from_yaml_as_it_was(plant):
    description = describe_plant(plant)
    assert description["class_path"] == f"tsjepa.plants.{type(plant).__name__}"
    again = build_plant(yaml.safe_load(yaml.safe_dump(description)))
    assert type(again) is type(plant) and again.spec == plant.spec
    assert describe_plant(again) == description
    device, episode, slot = np.arange(5), np.ones(5, np.int64), np.full(5, 60)
    start = plant.start(3, device, episode)
    np.testing.assert_array_equal(again.start(3, device, episode), start)
    np.testing.assert_array_equal(again.scene(start, 3, device, episode), plant.scene(start, 3, device, episode))
    action = np.zeros((5, plant.spec.action_dim))
    after = [one.advance(start, action, 3, device, episode, slot) for one in (plant, again)]
    np.testing.assert_array_equal(*after)
    references = [one.references(3, device, episode, slot) for one in (plant, again)]
    assert references[0] is references[1] is None or np.array_equal(*references)


@pytest.mark.parametrize(
    "plant", [CartPole(), Mixed([CartPole(), CartPole(0.02)]), *CHANGED], ids=lambda plant: type(plant).__name__
)
def test_those_that_are_there_give_what_their_specs_say(plant):
    check_plant(plant)


@pytest.mark.parametrize(
    ("method", "gives", "said"),
    [
        (
            "experts",
            lambda self: {"lqr": Rest((0.0,))},
            "has no expert 'reference LQR'; there are ['lqr']: call one so",
        ),
        ("experts", lambda self: {}, "has no expert 'reference LQR'; there are []"),
        (
            "experts",
            lambda self: {"reference LQR": Rest((0.0, 0.0))},
            "gives an array of shape [2, 2]; it has to be [2, 1]",
        ),
        ("state", lambda self, physics: physics[:, :3], "gives an array of shape [2, 3]; it has to be [2, 4]"),
        ("score", lambda self, state, reference=None: state > 0, "gives an array of shape [2, 4]; it has to be [2]"),
        ("references", lambda self, *keys: np.zeros((2, 3)), "gives an array of shape [2, 3]; it has to be [2, 1]"),
    ],
)
def test_a_plant_that_is_not_as_its_spec_says_is_refused_before_anything_is_written(tmp_path, method, gives, said):
    with pytest.raises(ValueError, match=rf"(?=.*\b{method}\b).*{re.escape(said)}"):
        collect(str(tmp_path / "set"), type("Own", (CartPole,), {method: gives})(), {"train": Split(2)}, slots=3)
    assert not list(tmp_path.glob("set*"))


def test_arguments_may_be_overridden():
    description = describe_plant(CartPole(set_point_step=0.5))
    plant = build_plant(description, process_noise_std=0.05, sampling_interval=0.01)
    assert (plant.spec.slot, plant.set_point_step, plant.process_noise_std.tolist()) == (0.01, 0.5, [0.05, 0.05])
    assert build_plant({"class_path": "tsjepa.plants.CartPole"}).spec == CartPole().spec


@pytest.mark.parametrize(
    ("description", "said"),
    [
        ({}, "described by a class_path"),
        ("tsjepa.plants.CartPole", "described by a class_path"),
        ({"class_path": "os.system"}, "not this package's own"),
        ({"class_path": "tsjepa.plants.Chariot"}, "cannot be imported"),
        ({"class_path": "tsjepa.plants.PlantSpec"}, "no class that can be used here"),
        ({"class_path": "tsjepa.plants.build_plant"}, "no class that can be used here"),
        ({"class_path": "tsjepa.plants.CartPole", "init_args": {"wings": 2}}, "does not know: wings"),
    ],
)
def test_what_is_no_plant_is_refused_in_one_sentence(description, said):
    with pytest.raises(ValueError, match=said):
        build_plant(description)


def test_a_strangers_plant_is_built_where_it_is_trusted():
    description = describe_plant(Stranger(0.01))
    assert description["class_path"] == f"{Stranger.__module__}.Stranger"
    with pytest.raises(ValueError, match=r"trusted=True"):
        build_plant(description)
    assert isinstance(build_plant(description, trusted=True), Stranger)


class Demanding(CartPole):
    """Needs an argument, which has to be a number."""

    def __init__(self, length) -> None:
        super().__init__()
        self.length = float(length)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({}, r"\.Demanding lacks its settings length: give them in its init_args\.$"),
        ({"length": [1]}, r"\.Demanding cannot be made of its settings: TypeError: float\(\) argument must be"),
    ],
)
def test_a_strangers_plant_that_cannot_be_made_is_refused_in_one_sentence(arguments, said):
    with pytest.raises(ValueError, match=said):
        build_plant({"class_path": f"{__name__}.Demanding", "init_args": arguments}, trusted=True)


def test_workers_that_draw_a_recording_build_the_strangers_plant_that_was_stepped():
    from tsjepa.data.collect import plant_of

    assert isinstance(plant_of(json.dumps(describe_plant(Stranger()))), Stranger)


def test_an_argument_that_is_not_kept_is_named():
    with pytest.raises(ValueError, match=r"does not keep its argument 'colour': set self.colour"):
        describe_plant(Forgetful())


def test_the_room_is_imported_without_mujoco_and_dm_control():
    import subprocess

    code = "import sys, tsjepa.plants; print([n for n in ('mujoco', 'dm_control', 'torchrl') if n in sys.modules])"
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert finished.stdout.strip() == "[]", finished.stderr
