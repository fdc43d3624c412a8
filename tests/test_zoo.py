import hashlib
import json
import random
import shutil
from pathlib import Path

import pytest
import torch

import tsjepa
from tsjepa import zoo
from tsjepa.models import Architecture, SemanticController
from tsjepa.zoo import CARD, CONFIG, MANIFEST, METRICS, WEIGHTS, DamagedEntryError

GUARDED = (CONFIG, WEIGHTS, METRICS, MANIFEST)
CORRUPTIONS = 200


def tiny(seed: int = 0) -> SemanticController:
    torch.manual_seed(seed)
    model = SemanticController(
        Architecture(
            frame_spacing=1,
            widths=(4, 8, 8),
            embedding_dim=8,
            predictor_hidden_dim=16,
            predictor_residual=False,
            actor_hidden_dims=(16, 8),
            sampling_interval=0.01,
        )
    )
    with torch.no_grad():
        for tensor in model.state_dict().values():
            if tensor.is_floating_point():
                tensor.uniform_(-0.5, 1.5).abs_()
    return model


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    return zoo.save(tiny(), tmp_path_factory.mktemp("zoo") / "tiny", {"score": 0.5}, "# A card\n")


def test_what_was_saved_is_loaded_bit_for_bit_frozen_and_in_evaluation_mode(entry):
    saved, loaded = tiny(), tsjepa.load(entry)
    assert loaded.architecture == saved.architecture
    assert loaded.state_dict().keys() == saved.state_dict().keys()
    assert all(torch.equal(value, saved.state_dict()[name]) for name, value in loaded.state_dict().items())
    assert not any(part.training for part in loaded.modules())
    assert not any(parameter.requires_grad for parameter in loaded.parameters())
    frames = torch.randint(0, 256, (3, 2, 64, 128, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    embedding = loaded.encode(frames)
    assert torch.equal(embedding, saved.eval().encode(frames))
    assert embedding.shape == (3, 8)
    assert torch.equal(loaded.act(embedding), saved.act(embedding))
    assert torch.equal(loaded.predict(embedding, torch.ones(3, 1)), saved.predict(embedding, torch.ones(3, 1)))
    assert torch.equal(loaded.probe(embedding), saved.probe(embedding))


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
            zoo.verify(copy)


def test_the_card_may_be_edited(entry, tmp_path):
    copy = shutil.copytree(entry, tmp_path / "copy")
    (copy / CARD).write_text("another card")
    tsjepa.load(copy)


def test_an_unknown_name_lists_the_known_ones(monkeypatch, entry, tmp_path):
    monkeypatch.setattr(zoo, "zoo_folder", lambda: entry.parent)
    assert zoo.names() == ["tiny"]
    assert tsjepa.load("tiny").architecture == tiny().architecture
    with pytest.raises(FileNotFoundError, match=r"no model 'tinny'.*one of tiny"):
        tsjepa.load("tinny")


def test_a_setting_of_another_version_is_named(entry, tmp_path):
    copy = shutil.copytree(entry, tmp_path / "copy")
    (copy / CONFIG).write_text((copy / CONFIG).read_text() + "wings: 2\n")
    manifest = json.loads((copy / MANIFEST).read_text())
    manifest["sha256"][CONFIG] = hashlib.sha256((copy / CONFIG).read_bytes()).hexdigest()
    (copy / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(ValueError, match="does not know: wings"):
        tsjepa.load(copy)


def test_saving_over_an_entry_replaces_it_whole_or_not_at_all(tmp_path, monkeypatch):
    folder = zoo.save(tiny(0), tmp_path / "model")
    before = tsjepa.load(folder).state_dict()

    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(zoo, "save_file", interrupted)
        with pytest.raises(KeyboardInterrupt):
            zoo.save(tiny(1), folder)
    assert all(torch.equal(value, before[name]) for name, value in tsjepa.load(folder).state_dict().items())
    zoo.save(tiny(1), folder)
    after = tiny(1).state_dict()
    assert all(torch.equal(value, after[name]) for name, value in tsjepa.load(folder).state_dict().items())
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
