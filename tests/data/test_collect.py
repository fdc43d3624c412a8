import json

import numpy as np
import pytest
import torch

from tsjepa.data.collect import Coverage, Split, collect
from tsjepa.data.storage import METADATA, content_hash, open_split, read_metadata
from tsjepa.evaluation.conditions import warn_of_another_renderer
from tsjepa.plants import Appearance, CartPole, Reacher
from tsjepa.plants.renderer import Renderer

PLANT = CartPole()
SPLITS = {"train": Split(3), "test": Split(2, coverage=False)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return collect(str(tmp_path_factory.mktemp("data") / "tiny"), PLANT, SPLITS, slots=30, seed=7)


def test_each_frame_shows_the_state_beside_it(folder):
    split = open_split(folder, "train")
    assert split.batch_size == (3, 31)
    assert torch.equal(split["scene"][1, :, :2], split["state"][1, :, :2])
    assert np.array_equal(split["pixels"][1].numpy(), PLANT.render(split["scene"][1].numpy()))


def test_the_plain_split_is_the_expert_and_the_other_is_not(folder):
    plain, covered = open_split(folder, "test"), open_split(folder, "train")
    assert torch.equal(plain["expert_action"], PLANT.experts()["expert"](plain["state"].clone(), torch.zeros(1)))
    assert torch.equal(plain["action"][:, :-1], plain["expert_action"][:, :-1])
    assert (covered["action"][:, :-1] - covered["expert_action"][:, :-1]).abs().mean() > 1
    assert (plain["action"][:, -1] == 0).all()


def test_a_warm_up_runs_without_force_and_the_expert_takes_over_after_it(tmp_path):
    split = open_split(collect(str(tmp_path / "warm"), PLANT, SPLITS, slots=6, warmup_slots=2, seed=7), "test")
    assert (split["action"][:, :2] == 0).all()
    assert torch.equal(split["action"][:, 2:-1], split["expert_action"][:, 2:-1])


def test_a_late_trajectory_rests_for_a_draw_of_its_own_and_then_has_the_expert(tmp_path):
    splits = {"late": Split(40, coverage=False, late_slots=5), "early": Split(40, coverage=False)}
    folder = collect(str(tmp_path / "late"), PLANT, splits, slots=12, warmup_slots=1, seed=7)
    split = open_split(folder, "late")
    heard = (split["action"] != 0).squeeze(-1).int().argmax(1)
    assert set(heard.tolist()) == {1, 2, 3, 4, 5, 6}
    for episode, slot in enumerate(heard):
        assert torch.equal(split["action"][episode, slot:-1], split["expert_action"][episode, slot:-1])
    early = open_split(folder, "early")["action"]
    assert (early[:, 0] == 0).all() and (early[:, 1:-1] != 0).all()
    with pytest.raises(ValueError, match="late_slots"):
        collect(str(tmp_path / "never"), PLANT, {"late": Split(1, late_slots=-1)}, slots=3)


def test_its_metadata_says_who_drew_the_pictures_and_a_model_that_meets_another_is_warned(folder, capsys):
    camera = read_metadata(folder)["camera"]
    assert camera == json.loads(json.dumps(PLANT.camera()))
    assert camera["gl_renderer"]
    warn_of_another_renderer({"gl_renderer": "another"}, read_metadata(folder))
    assert camera["gl_renderer"] in capsys.readouterr().err


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(folder, tmp_path):
    again = collect(str(tmp_path / "again"), PLANT, SPLITS, slots=30, seed=7)
    other = collect(str(tmp_path / "other"), PLANT, SPLITS, slots=30, seed=8)
    assert content_hash(again) == content_hash(folder) == read_metadata(folder)["sha256"]
    assert content_hash(other) != content_hash(folder)


def test_it_does_not_overwrite_unless_told(folder):
    with pytest.raises(FileExistsError, match="--overwrite"):
        collect(str(folder), PLANT, SPLITS, slots=30)


def test_an_interrupted_collection_leaves_nothing_that_loads(tmp_path, monkeypatch):
    rendered = 0

    def fail_later(self, qpos, colors=None):
        nonlocal rendered
        rendered += 1
        if rendered > 2:
            raise KeyboardInterrupt
        return np.zeros((len(qpos), self.height, self.width, 3), np.uint8)

    with monkeypatch.context() as patch:
        patch.setattr(Renderer, "render", fail_later)
        with pytest.raises(KeyboardInterrupt):
            collect(str(tmp_path / "cut"), PLANT, SPLITS, slots=10)
    with pytest.raises(FileNotFoundError, match="tsjepa collect"):
        read_metadata(tmp_path / "cut")
    collect(str(tmp_path / "cut"), PLANT, SPLITS, slots=10)
    assert open_split(tmp_path / "cut", "test").batch_size == (2, 11)


def test_a_truncated_or_missing_file_is_named(tmp_path):
    folder = collect(str(tmp_path / "hurt"), PLANT, SPLITS, slots=10)
    pixels = folder / "train" / "pixels.memmap"
    pixels.write_bytes(pixels.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"train/pixels\.memmap has"):
        open_split(folder, "test")
    pixels.unlink()
    with pytest.raises(ValueError, match="has no bytes"):
        open_split(folder, "test")


def test_another_format_and_a_wrong_split_are_refused(folder, tmp_path):
    with pytest.raises(KeyError, match="no split 'valid'"):
        open_split(folder, "valid")
    metadata = json.loads((folder / METADATA).read_text())
    (tmp_path / METADATA).write_text(json.dumps({**metadata, "format": 99}))
    with pytest.raises(ValueError, match="format 99"):
        read_metadata(tmp_path)


def test_coverage_noise_has_the_stated_memory_and_spread():
    noise = Coverage(noise_memory=0.8, noise_std=0.075).noise(PLANT, 400, 100, torch.Generator().manual_seed(0))
    late = noise[:, 40:, 0]
    assert abs(late.std() - 1.5 / (1 - 0.64) ** 0.5) < 0.1  # .075 of the half range of 20 N
    assert abs((late[:, 1:] * late[:, :-1]).mean() / late.square().mean() - 0.8) < 0.02


def test_set_points_change_now_and_then():
    goals = PLANT.goals(400, 100, torch.Generator().manual_seed(0))[..., 0]
    changes = (goals[:, 1:] != goals[:, :-1]).float().mean(0)
    assert torch.equal(changes.nonzero()[:, 0] + 1, torch.tensor([25, 50, 75]))
    assert abs(changes[24] - 0.7) < 3 * (0.21 / 400) ** 0.5
    assert goals.abs().max() <= 0.8 and goals.std() > 0.2


def test_a_split_may_have_a_length_of_its_own_and_a_plant_its_set_points(tmp_path):
    splits = {"train": Split(2), "starts": Split(3, slots=4)}
    folder = collect(str(tmp_path / "arm"), Reacher(), splits, slots=9)
    assert open_split(folder, "train").batch_size == (2, 10)
    starts = open_split(folder, "starts")
    assert starts.batch_size == (3, 5) and starts["action"].shape[-1] == 2
    expert = Reacher().experts()["expert"]
    assert torch.equal(starts["expert_action"], expert(starts["state"].clone(), starts["reference"].clone()))
    assert read_metadata(folder)["plant"]["class_path"] == "tsjepa.plants.Reacher"


def test_views_are_one_trajectory_in_two_appearances(tmp_path):
    plant = CartPole(appearance=Appearance(colors=True, light=(0.5, 1.5), shift_pixels=(1.0, 1.0), distractors=2))
    splits = {"train": Split(3, views=2), "test": Split(2)}
    folder = collect(str(tmp_path / "looks"), plant, splits, slots=8, seed=7)
    split = open_split(folder, "train")
    first, second = split[::2], split[1::2]
    assert split.batch_size == (6, 9) and read_metadata(folder)["splits"]["train"]["views"] == 2
    for key in ("state", "action", "expert_action", "reference"):
        assert torch.equal(first[key], second[key])
    assert not torch.equal(first["state"][0], first["state"][1])
    assert torch.equal(first["scene"][..., :2], first["state"][..., :2])
    assert torch.equal(second["scene"][..., :2], first["scene"][..., :2])
    looks = split["scene"][..., 2:]
    assert torch.equal(looks, looks[:, :1].expand_as(looks))  # an episode keeps its own
    assert (looks[0::2] != looks[1::2]).all() and (looks[0] != looks[2]).all()
    for episode in (2, 3):
        assert np.array_equal(split["pixels"][episode].numpy(), plant.render(split["scene"][episode].numpy()))
    # the machine itself does not know how it looks
    plain = open_split(collect(str(tmp_path / "plain"), PLANT, {"train": Split(3)}, slots=8, seed=7), "train")
    assert torch.equal(plain["state"], first["state"])


def test_a_split_without_views_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"splits\.train\.views is 0"):
        collect(str(tmp_path / "none"), PLANT, {"train": Split(2, views=0)}, slots=8)


def test_pictures_of_another_size_than_the_spec_says_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(CartPole, "render", lambda self, scene: np.zeros((len(scene), 32, 128, 3), np.uint8))
    with pytest.raises(ValueError, match=r"draws pictures of shape \[32, 128, 3\]; its spec says \[64, 128, 3\]"):
        collect(str(tmp_path / "low"), PLANT, {"train": Split(1)}, slots=2)
