"""What a fresh installation gets: pins, commands, package data, make targets."""

import ast
import importlib.metadata
import inspect
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PINS = {canonicalize_name(pin.name): pin.specifier for pin in map(Requirement, PROJECT["dependencies"])}
EXTRAS = {
    canonicalize_name(Requirement(pin).name)
    for name, pins in PROJECT["optional-dependencies"].items()
    if name != "test"
    for pin in pins
}
TARGETS = [
    "setup",
    "train-jepa",
    "train-actor",
    "data",
    "evaluate",
    "demo",
    "test",
    "test-fast",
    "lint",
    "help",
]
TARGETS += ["train-supervised", "train-autoencoder", "figures", "figures-check", "report", "faults", "audit", "bench"]
TARGETS += ["types", "docs", "wheel", "zoo"]
MODULE_NAMES = {
    "cv2": "opencv-python-headless",
    "dm_env": "dm-control",
    "OpenGL": "pyopengl",
    "PIL": "pillow",
    "rerun": "rerun-sdk",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}

needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


@pytest.mark.parametrize(
    ("package", "good", "bad"),
    [
        ("mujoco", "3.17.0", "4.0.0"),
        ("dm-control", "1.0.50", "1.0.51"),
        ("tensordict", "0.14.3", "0.15.0"),
        ("torchrl", "0.14.1", "0.15.0"),
        ("lightning", "2.6.6", "2.7.0"),
        ("torch", "2.13.0+cpu", "2.14.0"),
    ],
)
def test_pins_admit_the_pair_that_works_and_not_the_one_that_breaks(package, good, bad):
    assert PINS[package].contains(good)
    assert not PINS[package].contains(bad)


@pytest.mark.parametrize("package", PINS)
def test_installed_packages_satisfy_the_pins(package):
    assert PINS[package].contains(importlib.metadata.version(package), prereleases=True)


def test_every_import_is_a_declared_dependency():
    imported = set()
    for path in (ROOT / "tsjepa").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                imported.add(node.module.split(".")[0])
    foreign = imported - set(sys.stdlib_module_names) - {"tsjepa"}
    assert {canonicalize_name(MODULE_NAMES.get(name, name)) for name in foreign} <= set(PINS) | EXTRAS


@pytest.mark.parametrize("command", ["tsjepa", "lightning"])
def test_commands_are_ours(command):
    script = Path(sys.executable).parent / command
    assert "from tsjepa.cli import" in script.read_text()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path)


def test_wheel_holds_code_model_recipes_and_zoo(wheel):
    names = set(wheel.namelist())
    tracked = subprocess.run(
        ["git", "ls-files", "tsjepa", "recipes", "checkpoints"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()
    assert {"tsjepa/recipes/jepa.yaml", "tsjepa/py.typed"} <= names
    assert {name if name.startswith("tsjepa/") else f"tsjepa/{name}" for name in tracked} <= names
    assert not any(name.startswith("tests/") for name in names)


@pytest.mark.slow
def test_the_package_index_would_take_the_wheel(wheel):
    done = subprocess.run(
        [sys.executable, "-m", "twine", "check", "--strict", wheel.filename], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12"])
def test_every_module_compiles_on_every_supported_python(wheel, tmp_path, version):
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version} here")
    wheel.extractall(tmp_path)
    compiled = subprocess.run([python, "-m", "compileall", "-q", tmp_path], capture_output=True, text=True)
    assert compiled.returncode == 0, compiled.stdout
    alone = [
        python,
        "-S",
        "-c",
        "import tsjepa; print(tsjepa.__all__)",
    ]  # what others wrote is imported when it is used
    assert subprocess.run(alone, cwd=tmp_path, capture_output=True, text=True, check=True).stdout == "['load']\n"


def interpreter(version: str) -> str | None:
    """A Python of this version on the path or of pyenv's."""
    places = [shutil.which(f"python{version}"), *Path.home().glob(f".pyenv/versions/{version}.*/bin/python")]
    for python in filter(None, places):
        probe = [str(python), "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if subprocess.run(probe, capture_output=True, text=True).stdout.strip() == version:
            return str(python)
    return None


def test_the_change_log_begins_with_this_version():
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()


def embeddings() -> dict[str, list[float]]:
    """The first numbers of what every entry of the zoo makes of the same noise, by the entry's name."""
    import torch

    import tsjepa
    from tsjepa.models import entries

    result = {}
    for name in entries.names():
        model = tsjepa.load(name)
        shape = (1, *model.encoder.frame_shape)
        noise = torch.randint(0, 256, shape, dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
        result[name] = model.encode(noise)[0, :8].tolist()
    return result


@pytest.mark.slow
def test_every_entry_loads_from_the_wheel_alone(wheel, tmp_path):
    wheel.extractall(tmp_path / "installed")
    (tmp_path / "elsewhere").mkdir()
    program = (
        f"{inspect.getsource(embeddings)}\nimport json, tsjepa\nprint(json.dumps([tsjepa.__file__, embeddings()]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path / "elsewhere",
        env=os.environ | {"PYTHONPATH": str(tmp_path / "installed")},
        check=True,
        capture_output=True,
        text=True,
    )
    loaded_from, found = json.loads(done.stdout)
    assert Path(loaded_from) == tmp_path / "installed" / "tsjepa" / "__init__.py"
    expected = embeddings()
    assert set(found) == set(expected) >= {"tsjepa-cartpole"}
    for name, numbers in expected.items():
        assert found[name] == pytest.approx(numbers, abs=1e-6)


def make(*arguments: str) -> subprocess.CompletedProcess:
    """Run make as from a shell, also where these tests are run by make themselves."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    return subprocess.run(["make", *arguments], cwd=ROOT, env=environment, capture_output=True, text=True)


@needs_make
def test_make_help_lists_the_targets():
    assert sorted(line.split()[0] for line in make("help").stdout.splitlines()) == sorted(TARGETS)


@needs_make
def test_make_train_jepa_runs_the_whole_chain_with_the_recipe_asked_for():
    printed = make("-n", "train-jepa", "OVER=recipes/smoke").stdout
    steps = [
        printed.index(step)
        for step in ("recipes/smoke/jepa.yaml", "recipes/smoke/actor.yaml", "recipes/smoke/evaluate.yaml")
    ]
    assert steps == sorted(steps)


@needs_make
def test_make_setup_brings_its_pip_up_to_date_before_it_installs(tmp_path):
    lines = make("-n", "setup", f"VENV={tmp_path / 'venv'}").stdout.splitlines()
    installs = [line for line in lines if "pip install" in line]
    assert "--upgrade 'pip>=24'" in installs[0]  # pip 22 and 23 look for a solution for a quarter of an hour
    assert "-e '.[test]'" in installs[1]


@needs_make
def test_make_says_which_python_it_needs(tmp_path):
    done = make("setup", f"VENV={tmp_path / 'venv'}", "PYTHON=/nonexistent/python")
    assert done.returncode != 0
    assert "needs Python 3.10, 3.11 or 3.12" in done.stderr
