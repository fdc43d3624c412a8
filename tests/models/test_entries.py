import hashlib
import json
import random
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import yaml
from safetensors.torch import load_file, save_file
from tiny_controller import frames, tiny, tiny_autoencoder, tiny_supervised

import tsjepa
from tsjepa.models import SemanticController, entries
from tsjepa.models.entries import CARD, CONFIG, MANIFEST, METRICS, WEIGHTS, DamagedEntryError
from tsjepa.support.description import describe
from tsjepa.support.spec import PlantSpec
from tsjepa.training.callbacks import ExportModel

GUARDED = (CONFIG, WEIGHTS, METRICS, MANIFEST)
CORRUPTIONS = 200


class Thumbnail(torch.nn.Module):
    """A stranger's encoder: every eighth pixel, projected to the unit sphere."""

    def __init__(self, frame_stack: int = 2, embedding_dim: int = 8) -> None:
        super().__init__()
        self.frame_stack, self.embedding_dim, self.frame_shape = frame_stack, embedding_dim, (frame_stack, 64, 128, 3)
        self.project = torch.nn.Linear(frame_stack * 8 * 16 * 3, embedding_dim)

    def forward(self, stacks: torch.Tensor) -> torch.Tensor:
        pixels = stacks[..., ::8, ::8, :].flatten(-4).float() / 255
        return torch.nn.functional.normalize(self.project(pixels), dim=-1)


def described(model) -> dict:
    """Class paths and arguments of a model's parts."""
    return describe(model, lambda kind: issubclass(kind, (torch.nn.Module, PlantSpec)))


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    return entries.save(tiny(), tmp_path_factory.mktemp("zoo") / "tiny", {"score": 0.5}, "# A card\n")


def test_what_was_saved_is_loaded_bit_for_bit_frozen_and_in_evaluation_mode(entry):
    saved, loaded = tiny(), tsjepa.load(entry)
    assert described(loaded) == described(saved) and loaded.plant == saved.plant
    assert loaded.state_dict().keys() == saved.state_dict().keys()
    assert all(torch.equal(value, saved.state_dict()[name]) for name, value in loaded.state_dict().items())
    assert not any(part.training for part in loaded.modules())
    assert not any(parameter.requires_grad for parameter in loaded.parameters())
    embedding = loaded.encode(frames())
    assert torch.equal(embedding, saved.eval().encode(frames()))
    assert embedding.shape == (3, 8)
    assert torch.equal(loaded.act(embedding), saved.act(embedding))
    assert torch.equal(loaded.predict(embedding, torch.ones(3, 1)), saved.predict(embedding, torch.ones(3, 1)))
    assert torch.equal(loaded.probe(embedding), saved.probe(embedding))
    assert torch.equal(loaded.decode(embedding), saved.decode(embedding))


@pytest.mark.parametrize("make", [tiny, tiny_supervised, tiny_autoencoder])
@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_every_kind_comes_back_as_what_it_was(tmp_path, make, dtype):
    saved = make().eval()
    loaded = tsjepa.load(entries.save(saved, tmp_path / "model", dtype=dtype))
    assert type(loaded) is type(saved)
    assert described(loaded.encoder) == described(saved.encoder)
    assert (loaded.kind, loaded.spec, loaded.plant) == (saved.kind, saved.spec, saved.plant)
    embedding = loaded.encode(frames())
    tolerance = 0 if dtype == "float32" else 0.01
    torch.testing.assert_close(embedding, saved.encode(frames()), rtol=0, atol=tolerance)
    assert saved.act(embedding).abs().max() < 20  # not the actuator's limit, at which all models are alike
    for part in ("act", "probe", "decode"):
        got, expected = (getattr(model, part)(embedding) for model in (loaded, saved))
        torch.testing.assert_close(got, expected, rtol=0, atol=tolerance * float(expected.abs().max()))
    if not loaded.has_predictor:
        with pytest.raises(ValueError, match="no predictor"):
            loaded.predict(embedding, torch.ones(3, 1))


def test_an_autoencoder_is_nothing_without_its_decoder(tmp_path):
    entry = entries.save(tiny_autoencoder(), tmp_path / "model")
    config = yaml.safe_load((entry / CONFIG).read_text())
    assert config["model"]["class_path"] == "tsjepa.models.autoencoder.AutoencoderController"
    weights = load_file(entry / WEIGHTS)
    rest = {name: value for name, value in weights.items() if not name.startswith("decoder.")}
    with pytest.raises(ValueError, match="not those of the model"):
        tsjepa.load(rewrite(entry, tmp_path / "copy", config, rest))


def test_an_entry_holds_the_figures_and_the_card(entry):
    assert json.loads((entry / METRICS).read_text()) == {"score": 0.5}
    assert (entry / CARD).read_text() == "# A card\n"
    assert sorted(path.name for path in entry.iterdir()) == sorted((*GUARDED, CARD))


def flip(path: Path, draw: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
    path.write_bytes(content)


def truncate(path: Path, draw: random.Random) -> None:
    path.write_bytes(path.read_bytes()[: draw.randrange(path.stat().st_size)])


def rename(path: Path, draw: random.Random) -> None:
    path.rename(path.with_name(f"{path.name}.{draw.randrange(10)}"))


def remove(path: Path, draw: random.Random) -> None:
    path.unlink()


@pytest.mark.parametrize("corrupt", [flip, truncate, rename, remove])
def test_a_damaged_entry_is_never_loaded(entry, tmp_path, corrupt):
    draw = random.Random(corrupt.__name__)
    for trial in range(CORRUPTIONS // 4):
        name = GUARDED[trial % len(GUARDED)]
        copy = tmp_path / f"copy{trial}"
        shutil.copytree(entry, copy)
        corrupt(copy / name, draw)
        try:
            with pytest.raises(DamagedEntryError, match="fetch the entry anew"):
                tsjepa.load(copy)
        except BaseException:
            print(f"trial {trial}: {corrupt.__name__} of {name}")
            raise


def test_a_manifest_that_is_cut_anywhere_is_refused(entry, tmp_path):
    copy = shutil.copytree(entry, tmp_path / "copy")
    whole = (entry / MANIFEST).read_bytes()
    for length in range(len(whole)):
        (copy / MANIFEST).write_bytes(whole[:length])
        with pytest.raises(DamagedEntryError):
            entries.verify(copy)


def test_the_card_may_be_edited_damaged_and_lost(entry, tmp_path):
    copy = shutil.copytree(entry, tmp_path / "copy")
    (copy / CARD).write_text("another card ±", encoding="utf-8")
    assert tsjepa.load(copy).card == "another card ±"
    (copy / CARD).write_bytes(b"another card \xff")
    assert tsjepa.load(copy).card.startswith("another card ")
    (copy / CARD).unlink()
    assert tsjepa.load(copy).card == ""


def test_an_unknown_name_is_told_the_nearest_known_one_or_where_they_are_listed(monkeypatch, entry, tmp_path):
    monkeypatch.setattr(entries, "zoo_folder", lambda: entry.parent)
    assert entries.names() == ["tiny"]
    assert described(tsjepa.load("tiny")) == described(tiny())
    with pytest.raises(FileNotFoundError, match=r"no model 'tinny' - did you mean tiny\?$"):
        tsjepa.load("tinny")
    with pytest.raises(FileNotFoundError, match=r"no model 'xyzzy': give the folder .* that `tsjepa zoo` lists\.$"):
        tsjepa.load("xyzzy")


def rewrite(entry: Path, folder: Path, config: dict, weights: dict[str, torch.Tensor] | None = None) -> Path:
    """A whole entry with another configuration, or other weights, than ``save`` would write."""
    copy = shutil.copytree(entry, folder)
    (copy / CONFIG).write_text(yaml.safe_dump(config))
    if weights is not None:
        save_file(weights, copy / WEIGHTS)
    digests = {name: hashlib.sha256((copy / name).read_bytes()).hexdigest() for name in entries.HASHED}
    (copy / MANIFEST).write_text(json.dumps({"sha256": digests}))
    return copy


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c.update(format=1), "has the format 1; this version reads 2"),
        (lambda c: c.pop("format"), "has the format 1"),
        (lambda c: c.pop("model"), "has the format 2"),
        (lambda c: c["model"]["init_args"].update(wings=2), "does not know: wings"),
        (lambda c: c["model"].update(class_path="tsjepa.models.Oracle"), "tsjepa.models.Oracle cannot be imported"),
        (lambda c: c["model"].update(class_path="tsjepa.models.rollout"), "no class that can be used here"),
        (lambda c: c["model"].update(class_path="os.system"), "not this package's own"),
        (lambda c: c["model"]["init_args"]["encoder"]["init_args"].update(widths=[4, 8, 16]), "not those of the model"),
    ],
)
def test_a_whole_entry_of_another_version_is_refused_in_one_sentence(entry, tmp_path, change, said):
    config = yaml.safe_load((entry / CONFIG).read_text())
    change(config)
    with pytest.raises(ValueError, match=said):
        tsjepa.load(rewrite(entry, tmp_path / "copy", config))


def test_a_strangers_encoder_is_stored_and_loads_where_it_is_trusted(tmp_path):
    given = tiny()
    parts = {"predictor": given.predictor, "probe": given.probe, "decoder": given.decoder}
    model = SemanticController(Thumbnail(), given.actor, 1, given.spec, **parts).eval()
    folder = entries.save(model, tmp_path / "model")
    config = yaml.safe_load((folder / CONFIG).read_text())
    encoder = config["model"]["init_args"]["encoder"]
    assert encoder == {
        "class_path": f"{Thumbnail.__module__}.Thumbnail",
        "init_args": {"frame_stack": 2, "embedding_dim": 8},
    }
    with pytest.raises(ValueError, match=r"Thumbnail is not this package's own: add --trust"):
        tsjepa.load(folder)
    loaded = tsjepa.load(folder, trusted=True)
    assert type(loaded.encoder) is Thumbnail
    embedding = model.encode(frames())
    assert torch.equal(loaded.encode(frames()), embedding) and torch.equal(loaded.act(embedding), model.act(embedding))


def test_an_encoder_that_forgets_its_arguments_is_named_before_anything_is_written(tmp_path):
    class Forgetful(Thumbnail):
        def __init__(self, brightness: float = 1.0) -> None:
            super().__init__()

    model = tiny()
    model.encoder = Forgetful()
    with pytest.raises(ValueError, match=r"Forgetful cannot be stored.*does not keep its argument 'brightness'"):
        entries.save(model, tmp_path / "model")
    assert not list(tmp_path.iterdir())
    module = SimpleNamespace(controller=lambda: model)
    with pytest.raises(ValueError, match=r"Forgetful cannot be stored"):  # nor is it trained first
        ExportModel().on_fit_start(None, module)


def test_a_model_of_a_recording_has_no_plant_and_one_without_states_no_probe(tmp_path):
    given = tiny()
    model = SemanticController(given.encoder, given.actor, 1, given.spec, given.predictor)
    loaded = tsjepa.load(entries.save(model.eval(), tmp_path / "model"))
    assert loaded.plant is None and loaded.probe is None
    with pytest.raises(ValueError, match="no decoder"):
        loaded.decode(loaded.encode(frames()))


def test_the_folder_of_a_fit_stands_for_its_model_once_it_has_one(tmp_path):
    run = tmp_path / "run"
    (run / "checkpoints").mkdir(parents=True)
    (run / "checkpoints" / "last.ckpt").touch()
    (run / "config.yaml").write_text("trainer: {}")  # which an entry has as well
    with pytest.raises(FileNotFoundError, match=r"has left no model: go on with it .* --ckpt_path last"):
        entries.load(run)
    tiny().save_pretrained(run / "model")
    assert entries.load(run).entry_sha256 == entries.fingerprint(run / "model")


def test_a_model_without_an_actor_is_stored_predicts_and_says_that_it_does_not_act(tmp_path):
    model = tiny()
    model.actor = None
    found = entries.load(model.save_pretrained(tmp_path / "jepa"))
    embedding, command = torch.randn(2, 8), torch.zeros(2, 1)
    assert torch.equal(found.predict(embedding, command), model.eval().predict(embedding, command))
    assert not found.acts
    with pytest.raises(ValueError, match=r"no actor yet.* recipes/actor\.yaml"):
        found.act(embedding)


def test_parts_that_control_nothing_may_lack_and_say_so_and_no_others(entry, tmp_path):
    config, weights = yaml.safe_load((entry / CONFIG).read_text()), load_file(entry / WEIGHTS)
    bare = {name: value for name, value in weights.items() if not name.startswith(("decoder.", "code_"))}
    model = tsjepa.load(rewrite(entry, tmp_path / "bare", config, bare))
    embedding = model.encode(frames())
    assert torch.equal(model.act(embedding), tsjepa.load(entry).act(embedding))
    assert model.code_low.isnan().all()
    with pytest.raises(ValueError, match="decoder of this model was never trained"):
        model.decode(embedding)
    for lost in ("decoder.project.weight", "code_low"):
        rest = {name: value for name, value in weights.items() if name != lost}
        if lost == "code_low":
            rest["code_lower"] = weights[lost]
        with pytest.raises(ValueError, match="not those of the model"):
            tsjepa.load(rewrite(entry, tmp_path / lost, config, rest))
    with pytest.raises(ValueError, match="not those of the model"):
        tsjepa.load(rewrite(entry, tmp_path / "actorless", config, {n: v for n, v in bare.items() if n[:5] != "actor"}))


def test_16_bits_hold_the_weights_to_a_half_step_and_the_statistics_exactly(entry, tmp_path):
    model = tiny()
    with torch.no_grad():
        model.actor.layers[0].bias[0] = 1e5  # beyond the range of float16
    folder = entries.save(model, tmp_path / "half", dtype="float16")
    assert (folder / WEIGHTS).stat().st_size < (entry / WEIGHTS).stat().st_size
    stored, loaded = load_file(folder / WEIGHTS), tsjepa.load(folder).state_dict()
    trained = {name for name, _ in model.named_parameters()} - {"actor.layers.0.bias"}
    for name, value in model.state_dict().items():
        assert loaded[name].dtype == value.dtype
        if name in trained:
            assert stored[name].dtype == torch.float16
            assert torch.equal(loaded[name], value.half().float())
            assert (loaded[name] - value).abs().max() <= 1.5 * 2**-11
        else:
            assert stored[name].dtype == value.dtype
            assert torch.equal(loaded[name], value)
    assert {"encoder.stem.1.running_var", "code_low", "predictor.command_std", "probe.state_mean"} <= set(
        stored
    ) - trained
    again = entries.save(tsjepa.load(folder), tmp_path / "again", dtype="float16")
    assert entries.fingerprint(again) == entries.fingerprint(folder)
    with pytest.raises(ValueError, match="not as 'int8'"):
        entries.save(model, tmp_path / "wrong", dtype="int8")


def test_a_fingerprint_pins_an_entry(entry, tmp_path):
    pin = entries.fingerprint(entry)
    assert torch.equal(tsjepa.load(entry, sha256=pin.upper()).code_low, tiny().code_low)
    other = entries.save(tiny(1), tmp_path / "other")
    with pytest.raises(DamagedEntryError, match=f"has the SHA-256 {entries.fingerprint(other)}, not {pin}"):
        tsjepa.load(other, sha256=pin)


def test_figures_and_card_travel_with_the_model(entry):
    model = tsjepa.load(entry)
    assert (model.metrics, model.card) == ({"score": 0.5}, "# A card\n")


def test_saving_over_an_entry_replaces_it_whole_or_not_at_all(tmp_path, monkeypatch):
    folder = entries.save(tiny(0), tmp_path / "model")
    before = tsjepa.load(folder).state_dict()

    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(entries, "save_file", interrupted)
        with pytest.raises(KeyboardInterrupt):
            entries.save(tiny(1), folder)
    assert all(torch.equal(value, before[name]) for name, value in tsjepa.load(folder).state_dict().items())
    entries.save(tiny(1), folder)
    after = tiny(1).state_dict()
    assert all(torch.equal(value, after[name]) for name, value in tsjepa.load(folder).state_dict().items())
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_neither_weights_nor_figures_that_are_not_finite_are_stored(tmp_path, value):
    model = tiny()
    entries.save(model, tmp_path / "tiny", {"score": 0.5})
    before = {path.name: path.read_bytes() for path in (tmp_path / "tiny").iterdir()}
    with pytest.raises(ValueError, match=r"tiny/metrics\.json is not written: result\.rows\[1\] in it is not finite"):
        entries.save(model, tmp_path / "tiny", {"rows": [1.0, value]})
    with torch.no_grad():
        model.actor.layers[0].weight[0, 0] = value
    with pytest.raises(ValueError, match=r"The model is not stored: its weight actor\.layers\.0\.weight is not finite"):
        entries.save(model, tmp_path / "tiny")
    assert {path.name: path.read_bytes() for path in (tmp_path / "tiny").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["tiny"]


def test_a_fit_stores_its_model_with_a_figure_that_is_no_number_as_null(tmp_path):
    metrics = {"loss": torch.tensor(0.5), "rank": torch.tensor(float("nan"))}
    trainer = SimpleNamespace(
        is_global_zero=True, callback_metrics=metrics, precision="32-true", default_root_dir=tmp_path
    )
    module = tiny()
    module.controller = lambda: module
    ExportModel().on_fit_end(trainer, module)
    stored = json.loads((tmp_path / "model" / METRICS).read_text())
    assert (stored["loss"], stored["rank"]) == (0.5, None)


@pytest.mark.parametrize("there", ["thesis.tex", "README.md", "config.yaml"])
def test_a_folder_of_something_else_is_not_replaced(tmp_path, there):
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / there).write_text("mine")
    with pytest.raises(FileExistsError, match="work is there and is no stored model: choose a folder"):
        entries.save(tiny(), tmp_path / "work")
    assert (tmp_path / "work" / there).read_text() == "mine"
    (tmp_path / "empty").mkdir()
    assert entries.load(entries.save(tiny(), tmp_path / "empty"))
