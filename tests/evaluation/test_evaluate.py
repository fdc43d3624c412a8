import json

import cv2
import pytest
import torch
from tensordict import TensorDict

from tsjepa.evaluation.evaluate import FIRST_SLOT, angle_figures, evaluate, table
from tsjepa.evaluation.open_loop import probed_prediction_error
from tsjepa.evaluation.pictures import imagine
from tsjepa.models import Architecture, AutoencoderArchitecture, AutoencoderController, SemanticController, entries


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    torch.manual_seed(0)
    sizes = Architecture(widths=(4, 8, 8), embedding_dim=16, predictor_hidden_dim=32, actor_hidden_dims=(32, 16))
    model = SemanticController(sizes)
    model.decoder.fitted.fill_(True)
    return str(entries.save(model, tmp_path_factory.mktemp("model") / "tiny"))


@pytest.fixture(scope="module", params=["supervised", "autoencoder"])
def baseline(request, tmp_path_factory):
    torch.manual_seed(0)
    if request.param == "supervised":
        sizes = Architecture(4, widths=(4, 8, 8), embedding_dim=16, actor_hidden_dims=(32, 16), has_predictor=False)
        model = SemanticController(sizes)
    else:
        model = AutoencoderController(AutoencoderArchitecture(widths=(4, 8, 8), embedding_dim=16))
        model.law.gain.fill_(-10.0)
        model.law.position_clip.fill_(0.5)
    return request.param, str(entries.save(model, tmp_path_factory.mktemp("baseline") / request.param))


def options(output, **changes):
    return {
        "output": str(output),
        "data": None,
        "periods": (1, 5, 0),
        "seeds": 2,
        "starts_per_seed": 6,
        "slots": 80,
        **changes,
    }


def test_every_controller_has_a_row_with_its_score_and_its_bits(model, tmp_path, capsys):
    result = evaluate(model, **options(tmp_path, video=False))
    rows = {(row["controller"], row["update_every"]): row for row in result["closed_loop"]}
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
    assert all(len(row["score_by_slot"]) == 80 for row in rows.values())
    assert rows["TS-JEPA", 5]["bits_per_step"] == 32 * 16 / 5
    assert rows["expert, zero", 5]["bits_per_step"] == 4 * 32 / 5
    # nothing disturbs these plants
    planned = rows["expert, plan sent once", "once"]["normalized_score"]
    assert planned == pytest.approx(perfect["normalized_score"], abs=0.02)
    assert len(result["optimal_score_by_slot"]) == 80
    once = rows["TS-JEPA", "once"]
    assert len(once["angle_error_by_slot"]) == 80
    assert 0 <= once[FIRST_SLOT] < 80
    assert FIRST_SLOT not in rows["TS-JEPA", 5]
    written = json.loads((tmp_path / "evaluation.json").read_text())
    assert written["closed_loop"] == result["closed_loop"]
    printed = capsys.readouterr().out
    assert table(result) in printed
    assert {path.name for path in tmp_path.iterdir()} == {"evaluation.json", "score.png", "horizon.png"}


def test_the_same_evaluation_gives_the_same_figures_and_a_film(model, tmp_path):
    first = evaluate(model, **options(tmp_path / "first", periods=(5,)))
    again = evaluate(model, **options(tmp_path / "again", periods=(5,), video=False))
    assert first["closed_loop"] == again["closed_loop"]
    film = tmp_path / "first" / "loop.mp4"
    capture = cv2.VideoCapture(str(film))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 80
    assert capture.read()[1].shape == (3 * 64 + 12, 4 * 3 * 128, 3)
    assert cv2.imread(str(tmp_path / "first" / "inside.png")).shape == (5 * (3 * 64 + 12), 4 * 3 * 128, 3)


def test_a_baseline_holds_its_command_and_has_no_figures_of_predictions(baseline, tmp_path, capsys):
    name, entry = baseline
    result = evaluate(entry, **options(tmp_path, slots=20, starts_per_seed=2))
    rows = {row["update_every"]: row for row in result["closed_loop"] if row["controller"] == name}
    assert set(rows) == {1, 5, "once"}
    assert FIRST_SLOT not in rows["once"]
    assert rows[5]["bits_per_step"] == 32 * 16 / 5
    frames = rows[5].get("bits_per_step_as_frames")
    assert frames == (pytest.approx(4 * 64 * 128 * 24 / 5) if name == "supervised" else None)
    assert "decoder of this model was never trained" in capsys.readouterr().out
    assert not (tmp_path / "loop.mp4").exists()


def test_angle_figures_name_the_first_slot_whose_mean_error_is_too_large():
    errors = torch.tensor([[0.0, 0.02], [0.0, 0.09], [0.02, 0.1], [0.0, 0.0]])
    figures = angle_figures(errors)
    assert figures[FIRST_SLOT] == 2
    assert figures["angle_error_by_slot"] == pytest.approx([0.01, 0.045, 0.06, 0.0])
    assert angle_figures(errors[:2])[FIRST_SLOT] is None


def test_imagining_lets_the_model_drive_itself():
    class Model:
        def act(self, belief):
            return 2 * belief

        def predict(self, belief, command):
            return belief + command

    assert torch.equal(imagine(Model(), torch.ones(2, 1), 3), torch.full((2, 1), 27.0))


def test_one_seed_gives_no_interval_and_is_refused(model, tmp_path):
    with pytest.raises(ValueError, match="seeds is 1; it has to be at least 2"):
        evaluate(model, **options(tmp_path, seeds=1, video=False))


class Line(torch.nn.Module):
    """A model whose embedding is the state itself and moves by the command."""

    def predictor(self, embedding, command):
        return embedding + command

    def probe(self, embedding):
        return embedding


def test_probed_prediction_error_of_a_perfect_prediction_and_of_a_copy():
    action = torch.ones(2, 30, 1)
    state = torch.arange(30.0).repeat(2, 1)[..., None].expand(2, 30, 4)
    embedded = TensorDict({"embedding": state, "state": state, "action": action}, batch_size=[2, 30])
    predicted, copied = probed_prediction_error(Line(), embedded, longest=10)
    torch.testing.assert_close(predicted, torch.zeros(10))
    deviation = state.flatten(0, 1).std(0)[0]
    torch.testing.assert_close(copied, torch.arange(1.0, 11.0) / deviation)
