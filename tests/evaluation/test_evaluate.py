import json

import cv2
import pytest
import tiny_controller
import tiny_data
import torch
from tensordict import TensorDict

from tsjepa import cli
from tsjepa.data.storage import METADATA
from tsjepa.envs import Radio
from tsjepa.evaluation import evaluate as evaluation_command
from tsjepa.evaluation.conditions import warn_of_another_renderer
from tsjepa.evaluation.evaluate import evaluate
from tsjepa.evaluation.films import imagine
from tsjepa.evaluation.open_loop import command_error, probed_prediction_error
from tsjepa.evaluation.simulate import simulate
from tsjepa.evaluation.summary import ERRORS, FIRST_LOST, table
from tsjepa.models import entries
from tsjepa.plants import CartPole, build_plant
from tsjepa.zoo.deploy import graphs
from tsjepa.zoo.export import export

pytestmark = pytest.mark.slow  # every test starts a process, trains or closes loops

SMALL = {"periods": (1, 5, 0), "seeds": 2, "starts_per_seed": 6, "slots": 50}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return str(entries.save(tiny_controller.tiny(), tmp_path_factory.mktemp("model") / "tiny"))


@pytest.fixture(scope="module")
def evaluation(model, tmp_path_factory):
    """The result, and the folder of its files."""
    folder = tmp_path_factory.mktemp("evaluation")
    return evaluate(model, output=str(folder), **SMALL, video=False), folder


def rows_of(result: dict) -> dict:
    return {(row["controller"], row["update_every"]): row for row in result["closed_loop"]}


def test_every_controller_has_a_row_with_its_score_and_its_bits(evaluation):
    result, folder = evaluation
    rows = rows_of(result)
    assert set(rows) == {
        ("expert, perfect feedback", 1),
        ("expert, plan sent once", "once"),
        *((name, period) for name in ("expert, hold last", "expert, zero") for period in (5, "once")),
        *(("TS-JEPA", period) for period in (1, 5, "once")),
    }
    perfect = rows["expert, perfect feedback", 1]
    assert perfect["command_nmae"] == 0
    assert perfect["failures"] == 0
    assert rows["expert, zero", "once"]["normalized_score"] < 0.5 < perfect["normalized_score"]
    assert all(len(row["score_by_slot"]) == 50 for row in rows.values())
    assert rows["TS-JEPA", 5]["bits_per_step"] == pytest.approx(32 * tiny_controller.DIM / 5)
    assert rows["expert, zero", 5]["bits_per_step"] == pytest.approx(4 * 32 / 5)
    # nothing disturbs these plants
    planned = rows["expert, plan sent once", "once"]["normalized_score"]
    assert planned == pytest.approx(perfect["normalized_score"], abs=0.02)
    assert len(result["optimal_score_by_slot"]) == 50
    once = rows["TS-JEPA", "once"]
    assert len(once[ERRORS]) == 50
    assert 0 <= once[FIRST_LOST] < 50
    assert FIRST_LOST not in rows["TS-JEPA", 5]
    assert {path.name for path in folder.iterdir()} == {"evaluation.json", "score.png", "horizon.png"}


def test_a_result_says_all_that_it_depends_on(evaluation, model):
    result, folder = evaluation
    assert json.loads((folder / "evaluation.json").read_text()) == json.loads(json.dumps(result))
    assert (result["seeds"], result["starts_per_seed"], result["slots"]) == ([0, 1], 6, 50)
    assert (result["frame_history"], result["codec"], result["blend"]) == (2, "fp32", 1.0)
    assert result["model_sha256"] == entries.fingerprint(model)
    assert result["optimal_policy"] == CartPole.normaliser
    assert result["camera"]["gl_renderer"] == CartPole().camera()["gl_renderer"]
    assert isinstance(build_plant(result["plant"]), CartPole)


def test_a_model_with_figures_is_evaluated_as_they_were_measured_and_without_a_data_set(model, tmp_path, capsys):
    loaded = entries.load(model)
    plant = {"class_path": "tsjepa.plants.CartPole", "init_args": {"process_noise_std": 0.1}}
    measured = {"seeds": [0, 1], "starts_per_seed": 6, "slots": 90, "frame_history": 4, "plant": plant}
    entry = entries.save(loaded, tmp_path / "entry", measured)
    arguments = ["evaluate", str(entry), "--output", str(tmp_path / "out"), "--periods=[5]", "--video=false"]
    assert cli.main(arguments) == 0
    result = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert {key: result[key] for key in measured if key != "plant"} == {
        k: v for k, v in measured.items() if k != "plant"
    }
    assert result["plant"]["init_args"]["process_noise_std"] == [0.1, 0.1]
    assert "open_loop" not in result
    assert "because no data set is given" in capsys.readouterr().out


def test_other_sets_of_starts_are_chosen_by_their_first_number(evaluation, model, tmp_path):
    usual, options = rows_of(evaluation[0]), {**SMALL, "periods": (5,), "video": False, "output": str(tmp_path)}
    shifted = evaluate(model, first_seed=1, **options)
    assert shifted["seeds"] == [1, 2] and shifted["starts"] == "2 seeds x 6"
    before, after = (rows["expert, hold last", 5]["per_seed"] for rows in (usual, rows_of(shifted)))
    # the second of the usual sets is the first of these
    assert after[0] == before[1] and after[1] not in before
    entry = str(entries.save(entries.load(model), tmp_path / "entry", {"seeds": [7, 8, 9]}))
    assert evaluate(entry, **options | {"seeds": None})["seeds"] == [7, 8, 9]
    with pytest.raises(ValueError, match="first_seed"):
        evaluate(model, first_seed=-1, **options)


def test_the_plant_may_be_another_one(model, tmp_path):
    plant = CartPole(start_half_widths=(0.01, 0.01, 0.0, 0.0))
    options = {**SMALL, "periods": (1,), "slots": 5, "video": False, "output": str(tmp_path)}
    near = evaluate(model, plant, **options)
    assert rows_of(near)["expert, perfect feedback", 1]["raw_score"] == 1.0
    noisy = evaluate(model, plant, process_noise_std=3.0, **options)
    assert rows_of(noisy)["expert, perfect feedback", 1]["raw_score"] < 1.0
    assert noisy["plant"]["init_args"]["process_noise_std"] == [3.0, 3.0]


def test_a_model_of_a_recording_needs_data_or_a_plant(tmp_path):
    recorded = tiny_controller.tiny()
    recorded.plant = None
    entry = str(entries.save(recorded, tmp_path / "model"))
    with pytest.raises(ValueError, match="trained on a recording: give --data"):
        evaluate(entry, output=str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()
    plant = CartPole(start_half_widths=(0.01, 0.01, 0.0, 0.0))
    result = evaluate(entry, plant, str(tmp_path / "out"), **{**SMALL, "periods": (1,), "slots": 5}, video=False)
    assert ("TS-JEPA", 1) in rows_of(result)


@pytest.mark.parametrize(("codec", "bits"), [("fp16", 16), ("int8", 8), ("int4", 4)])
def test_the_models_updates_are_sent_by_the_codec_and_its_bits_are_counted(model, tmp_path, codec, bits):
    near = CartPole(start_half_widths=(0.01, 0.01, 0.0, 0.0))
    options = {**SMALL, "periods": (5,), "starts_per_seed": 2, "slots": 10, "video": False, "output": str(tmp_path)}
    exact, coded = (rows_of(evaluate(model, near, codec=name, **options)) for name in ("fp32", codec))
    own = ("TS-JEPA", 5)
    assert coded[own]["bits_per_step"] == pytest.approx(bits * tiny_controller.DIM / 5)
    assert coded[own]["command_nmae"] != exact[own]["command_nmae"]
    # the expert's state is sent as it is
    assert coded["expert, zero", 5] == exact["expert, zero", 5]


@pytest.mark.slow
def test_the_same_evaluation_gives_the_same_figures_and_a_film(model, tmp_path):
    small = {**SMALL, "periods": (5,)}
    first = evaluate(model, output=str(tmp_path / "first"), **small)
    again = evaluate(model, output=str(tmp_path / "again"), **small, video=False)
    assert first["closed_loop"] == again["closed_loop"]
    capture = cv2.VideoCapture(str(tmp_path / "first" / "loop.mp4"))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 50
    assert capture.read()[1].shape == (3 * 64 + 12, 4 * 3 * 128, 3)
    assert cv2.imread(str(tmp_path / "first" / "inside.png")).shape == (5 * (3 * 64 + 12), 4 * 3 * 128, 3)


def test_a_model_without_an_actor_is_scored_on_data_alone(tmp_path, capsys):
    made = tiny_controller.tiny()
    made.actor = None
    folder = str(entries.save(made, tmp_path / "model"))
    for command in (
        lambda: evaluate(folder, output=str(tmp_path / "out"), **SMALL),
        lambda: simulate(2, controller=folder, radio=Radio(resource_blocks=1), output=str(tmp_path / "fleet")),
        lambda: graphs(entries.load(folder)),
        lambda: export(folder, "mine", folder=str(tmp_path / "zoo")),
    ):
        with pytest.raises(ValueError, match="no actor yet"):
            command()
    assert {path.name for path in tmp_path.iterdir()} == {"model"}
    data = str(tiny_data.write(tmp_path / "data", test=3))
    result = evaluate(folder, output=str(tmp_path / "out"), data=data, **SMALL)
    assert "closed_loop" not in result
    assert {"skill_over_copying", "probe_rmse"} <= result["open_loop"].keys() - {"command_nmae"}
    assert "this model has no actor yet" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["supervised", "autoencoder"])
def test_a_baseline_holds_its_command_and_has_no_figures_of_predictions(kind, tmp_path, capsys):
    made = getattr(tiny_controller, f"tiny_{kind}")()
    made.decoder.fitted.fill_(False) if kind == "supervised" else None
    result = evaluate(str(entries.save(made, tmp_path / "model")), output=str(tmp_path / "out"), **SMALL)
    rows = {row["update_every"]: row for row in result["closed_loop"] if row["controller"] == kind}
    assert set(rows) == {1, 5, "once"}
    assert FIRST_LOST not in rows["once"]
    assert rows[5]["bits_per_step"] == pytest.approx(32 * tiny_controller.DIM / 5)
    assert ("decoder of this model was never trained" in capsys.readouterr().out) == (kind == "supervised")
    assert (tmp_path / "out" / "loop.mp4").exists() == (kind == "autoencoder")


def test_the_printed_table_has_every_row_and_the_open_loop():
    watched = {"state": "elbow", "limit": 0.1, "unit": "rad"}
    row = {"controller": "TS-JEPA", "update_every": "once", "normalized_score": 0.5, "interval_95": 0.1}
    row |= {"raw_score": 0.2, "failures": 3, "starts": 9, "command_nmae": 0.01, "bits_per_step": 5.0}
    row |= {"watched": watched, FIRST_LOST: 12}
    printed = table({"closed_loop": [row], "open_loop": {"effective_rank": 7.5}}).splitlines()
    assert "0.500 ± 0.100" in printed[1]
    assert printed[2:] == ["  probed elbow more than 0.1 rad off: from slot 12", "effective_rank: 7.5"]
    assert table({"closed_loop": [row | {FIRST_LOST: None}]}).splitlines()[-1].endswith("never")


@pytest.mark.parametrize(
    ("record", "warned"),
    [
        (None, False),
        ({}, False),
        ({"camera": {"gl_renderer": "softpipe"}}, True),
        ({"camera": {"gl_renderer": "llvmpipe"}}, False),
        ({"data_sets": [{"camera": {"gl_renderer": "softpipe"}}]}, True),
    ],
)
def test_pictures_of_another_renderer_are_warned_of_in_one_line(record, warned, capsys):
    warn_of_another_renderer({"gl_renderer": "llvmpipe"}, record)
    said = capsys.readouterr().err
    assert said.count("\n") == warned
    assert ("softpipe" in said) == warned


def test_imagining_lets_the_model_drive_itself_towards_its_set_points():
    class Model(torch.nn.Module):
        def act(self, belief, reference):
            return 2 * belief + reference

        def predict(self, belief, command):
            return belief + command

    ones = torch.ones(2, 1)
    assert torch.equal(imagine(Model(), ones, 3, 0 * ones), torch.full((2, 1), 27.0))
    assert torch.equal(imagine(Model(), ones, 2, ones), torch.full((2, 1), 13.0))


def test_one_seed_gives_no_interval_and_is_refused(model, tmp_path):
    with pytest.raises(ValueError, match="seeds is 1; it has to be at least 2"):
        evaluate(model, output=str(tmp_path), **{**SMALL, "seeds": 1})
    with pytest.raises(ValueError, match="periods is empty"):
        evaluate(model, output=str(tmp_path), **{**SMALL, "periods": []})


def test_a_device_that_is_not_there_and_a_plant_that_does_not_fit_are_said_in_one_sentence(model, tmp_path, capsys):
    for options, said in (
        (["--device", "cuda:99"], "The device 'cuda:99' cannot be used here"),
        (["--plant", "{class_path: tsjepa.plants.CartPole, init_args: {sampling_interval: 0.01}}"], "slot in seconds"),
    ):
        assert cli.main(["evaluate", model, "--output", str(tmp_path), *options]) == 2
        complaint = capsys.readouterr().err
        assert said in complaint
        assert complaint.count("\n") == 1


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ({"frame": [64, 64]}, r"frames of shape \[64, 64\], and the model was trained with \[64, 128\]"),
        ({"action_low": [-1, -1], "action_high": [1, 1], "action_names": [], "action_units": []}, "commands of shape"),
        ({"state_names": [], "state_units": [], "state_scale": [], "watched": None}, None),
        ({"state_names": ["x"], "state_units": [], "state_scale": [], "watched": None}, r"states of shape \[1\]"),
    ],
)
def test_data_of_another_machine_are_refused_before_the_loops_are_closed(model, tmp_path, monkeypatch, spec, said):
    data = tiny_data.write(tmp_path / "data", slots=4, test=1)
    metadata = json.loads((data / METADATA).read_text())
    (data / METADATA).write_text(json.dumps(metadata | {"spec": metadata["spec"] | spec}))
    monkeypatch.setattr(evaluation_command, "closed_loops", lambda *_: pytest.fail("loops are closed"))
    with pytest.raises(ValueError, match=said) if said else pytest.raises(pytest.fail.Exception, match="loops"):
        evaluate(model, data=str(data), output=str(tmp_path / "out"), **SMALL)


def test_data_without_a_test_split_are_refused_before_the_loops_are_closed(model, tmp_path, monkeypatch):
    data = tiny_data.write(tmp_path / "data", slots=4, train=1)
    monkeypatch.setattr(evaluation_command, "closed_loops", lambda *_: pytest.fail("loops are closed"))
    with pytest.raises(KeyError, match="no split 'test'; it has train"):
        evaluate(model, data=str(data), output=str(tmp_path / "out"), **SMALL)


class Line(torch.nn.Module):
    """A model whose embedding is the state itself and moves by the command."""

    spec = CartPole().spec

    def predictor(self, embedding, command):
        return embedding + command

    def probe(self, embedding):
        return embedding

    def act(self, embedding, reference):
        return embedding[:, :1] + reference


def test_probed_prediction_error_of_a_perfect_prediction_and_of_a_copy():
    action = torch.ones(2, 30, 1)
    state = torch.arange(30.0).repeat(2, 1)[..., None].expand(2, 30, 4)
    embedded = TensorDict({"embedding": state, "state": state, "action": action}, batch_size=[2, 30])
    predicted, copied = probed_prediction_error(Line(), embedded, longest=10)
    torch.testing.assert_close(predicted, torch.zeros(10))
    deviation = state.flatten(0, 1).std(0)[0]
    torch.testing.assert_close(copied, torch.arange(1.0, 11.0) / deviation)


def test_states_that_never_change_say_nothing_about_a_prediction():
    state = torch.arange(30.0).repeat(2, 1)[..., None].expand(2, 30, 4)
    still = torch.cat([state[..., :2], torch.full((2, 30, 2), 3.0)], -1)  # where the probe reads what moves
    values = {"embedding": state, "state": still, "action": torch.ones(2, 30, 1)}
    predicted, copied = probed_prediction_error(Line(), TensorDict(values, batch_size=[2, 30]), longest=10)
    torch.testing.assert_close(predicted, torch.zeros(10))
    torch.testing.assert_close(copied, torch.arange(1.0, 11.0) / state.flatten(0, 1).std(0)[0])


def test_commands_are_compared_with_the_experts_or_else_with_those_of_the_recording():
    values = {"embedding": torch.zeros(3, 4), "action": torch.full((3, 1), 4.0)}
    rows = TensorDict(values, batch_size=[3])
    assert command_error(Line(), rows) == {"command_nmae": pytest.approx(4 / 40), "command_nmae_to": "action"}
    rows["expert_action"] = torch.full((3, 1), -8.0)
    expected = {"command_nmae": pytest.approx(8 / 40), "command_nmae_to": "expert_action"}
    assert command_error(Line(), rows) == expected
    rows["reference"] = torch.full((3, 1), 2.0)
    assert command_error(Line(), rows)["command_nmae"] == pytest.approx(10 / 40)
