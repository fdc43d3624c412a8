"""The Hugging Face Hub without a network: its own client on a cache that lies ready, and a Hub that is a folder."""

import shutil
import sys
from inspect import signature
from pathlib import Path
from types import SimpleNamespace

import huggingface_hub
import pytest
import torch
from tiny_controller import frames, tiny

import tsjepa
from tsjepa.models import SemanticController, entries, hub
from tsjepa.models.entries import WEIGHTS, DamagedEntryError

COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    return entries.save(tiny(), tmp_path_factory.mktemp("entry") / "tiny", {"score": 0.5}, "# A card\n")


@pytest.fixture
def remote(entry, tmp_path, monkeypatch):
    """Stands in for the Hub: ``remote.folder`` is what it holds, ``remote.asked`` what it was asked."""
    fake = SimpleNamespace(folder=shutil.copytree(entry, tmp_path / "remote"), asked=None)
    real = signature(huggingface_hub.snapshot_download)

    def snapshot_download(*arguments, **options):
        fake.asked = real.bind(*arguments, **options).arguments
        copy = tmp_path / "downloaded"
        shutil.rmtree(copy, ignore_errors=True)
        copy.mkdir()
        for path in fake.folder.iterdir():
            if path.name in options["allow_patterns"]:
                shutil.copy(path, copy)
        return str(copy)

    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot_download)
    return fake


@pytest.fixture
def cache(entry, tmp_path):
    """A cache as the Hub's client lays it out, with one commit, which the branch main points at."""
    repository = tmp_path / "cache" / "models--someone--tiny"
    (repository / "refs").mkdir(parents=True)
    (repository / "refs" / "main").write_text(COMMIT)
    shutil.copytree(entry, repository / "snapshots" / COMMIT)
    return tmp_path / "cache"


def same(first: SemanticController, second: SemanticController) -> bool:
    pairs = zip(first.state_dict().items(), second.state_dict().items(), strict=True)
    return all(one == other and torch.equal(a, b) for (one, a), (other, b) in pairs)


@pytest.mark.parametrize("revision", [None, "main", COMMIT])
def test_what_is_in_the_cache_loads_offline_by_the_real_client(cache, revision):
    options = {"cache_dir": cache, "local_files_only": True, "revision": revision}
    model = SemanticController.from_pretrained("someone/tiny", **options)
    assert same(model, tiny())
    assert torch.equal(model.encode(frames()), tiny().eval().encode(frames()))


@pytest.mark.parametrize(
    ("repository", "revision"), [("someone/absent", None), ("someone/tiny", "f" * 40), ("some--one/-", None)]
)
def test_what_is_not_in_the_cache_is_named(cache, repository, revision):
    with pytest.raises(FileNotFoundError, match=f"{repository}.*could not be fetched from the Hugging Face Hub: .+"):
        SemanticController.from_pretrained(repository, revision=revision, cache_dir=cache, local_files_only=True)


def test_revision_cache_and_token_reach_the_client_and_only_files_of_an_entry_are_asked_for(remote, tmp_path):
    (remote.folder / "pytorch_model.bin").write_bytes(b"never wanted")
    options = {"cache_dir": tmp_path, "local_files_only": True, "force_download": True, "token": "secret"}
    model = SemanticController.from_pretrained("someone/tiny", revision=COMMIT, **options)
    assert same(model, tiny())
    wanted = sorted(remote.asked.pop("allow_patterns"))
    assert wanted == ["README.md", "config.yaml", "manifest.json", "metrics.json", "model.safetensors"]
    assert remote.asked == {"repo_id": "someone/tiny", "revision": COMMIT, **options}


@pytest.mark.parametrize(
    ("address", "revision"), [("hf://someone/tiny", None), (f"hf://someone/tiny@{COMMIT}", COMMIT)]
)
def test_an_address_loads_wherever_a_name_does(remote, address, revision):
    assert same(tsjepa.load(address), tiny())
    assert (remote.asked["repo_id"], remote.asked["revision"]) == ("someone/tiny", revision)
    assert same(SemanticController.from_pretrained(address), tiny())


@pytest.mark.parametrize(
    "address", ["hf://tiny", "hf://someone/tiny/model", "hf://@main", "hf://some one/tiny", "hf://"]
)
def test_another_address_is_refused(remote, address):
    with pytest.raises(ValueError, match="is no address on the Hub"):
        tsjepa.load(address)
    assert remote.asked is None


def test_nothing_is_fetched_unless_asked_for(remote, tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="no model 'someone/tiny'"):
        tsjepa.load("someone/tiny")
    (tmp_path / "runs" / "actor").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match="no model 'runs/actor'"):
        SemanticController.from_pretrained("runs/actor")
    with pytest.raises(FileNotFoundError, match="no model 'tinny'"):
        SemanticController.from_pretrained("tinny")
    entries.save(tiny(1), "someone/tiny")
    assert same(SemanticController.from_pretrained("someone/tiny"), tiny(1))
    with pytest.raises(ValueError, match=r"on this machine and has no revision 'v1'"):
        SemanticController.from_pretrained("someone/tiny", revision="v1")
    assert remote.asked is None


def test_a_download_that_was_tampered_with_is_refused(remote):
    weights = bytearray((remote.folder / WEIGHTS).read_bytes())
    weights[-1] ^= 1
    (remote.folder / WEIGHTS).write_bytes(weights)
    with pytest.raises(DamagedEntryError, match="is not the file that the manifest names"):
        SemanticController.from_pretrained("someone/tiny")


def test_a_pin_refuses_even_a_whole_entry_of_somebody_else(remote, entry):
    pin = entries.fingerprint(entry)
    assert same(SemanticController.from_pretrained("someone/tiny", sha256=pin), tiny())
    entries.save(tiny(1), remote.folder)
    with pytest.raises(DamagedEntryError, match=f"not {pin}"):
        SemanticController.from_pretrained("someone/tiny", sha256=pin)


def test_an_entry_of_another_class_is_refused(entry):
    class Other(SemanticController):
        pass

    with pytest.raises(TypeError, match="holds a SemanticController"):
        Other.from_pretrained(entry)


def test_a_saved_model_keeps_weights_figures_and_card(entry, tmp_path):
    folder = SemanticController.from_pretrained(entry).save_pretrained(tmp_path / "saved")
    assert entries.fingerprint(folder) == entries.fingerprint(entry)
    assert (folder / entries.CARD).read_text() == "# A card\n"
    half = SemanticController.from_pretrained(entry).save_pretrained(tmp_path / "half", dtype="float16")
    assert (half / WEIGHTS).stat().st_size < (entry / WEIGHTS).stat().st_size


def test_a_pushed_model_can_be_pulled(remote, entry, monkeypatch):
    asked = {}

    class Interface:
        def __init__(self, token=None):
            asked["token"] = token

        def create_repo(self, *arguments, **options):
            asked["create"] = signature(huggingface_hub.HfApi.create_repo).bind(self, *arguments, **options).kwargs
            return SimpleNamespace(repo_id=arguments[0])

        def upload_folder(self, **options):
            signature(huggingface_hub.HfApi.upload_folder).bind(self, **options)
            asked["upload"] = options
            shutil.rmtree(remote.folder)
            shutil.copytree(options["folder_path"], remote.folder)
            return SimpleNamespace(commit_url=f"https://huggingface.co/{options['repo_id']}/commit/{COMMIT}")

    monkeypatch.setattr(huggingface_hub, "HfApi", Interface)
    model = tiny(2)
    url = model.push_to_hub("someone/tiny", revision="next", private=True, token="secret", create_pr=True)
    assert url == f"https://huggingface.co/someone/tiny/commit/{COMMIT}"
    assert asked["token"] == "secret"
    assert asked["create"] == {"private": True, "exist_ok": True}
    folder = asked["upload"].pop("folder_path")
    assert not Path(folder).exists()
    expected = {"repo_id": "someone/tiny", "revision": "next", "create_pr": True, "commit_message": "Upload tiny"}
    assert asked["upload"] == expected
    assert same(SemanticController.from_pretrained("someone/tiny"), model)


def test_without_the_client_one_sentence_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(ModuleNotFoundError, match=r"needs the package huggingface_hub: pip install 'tsjepa\[hub\]'"):
        hub.download("someone/tiny", entries.FILES)
