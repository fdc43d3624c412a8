"""Who may import whom, without circles; and that a plant is stepped in one place."""

import ast
import graphlib
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "tsjepa"
# every room may use itself and the rooms before it in its line, and everybody may use support
PURE = ("plants", "radio", "models")
LINE = ("envs", "data", "training", "evaluation", "zoo")
TOP = ("live", "paper", "watch")  # beside each other
# who may step a plant or an environment beside plants/ and envs/: the loop of every evaluation, the recording, and the
# plant that a device owns, which steps in real time
ENVIRONMENT = ("step", "rollout", "step_and_maybe_reset")
STEPPING = {"evaluation/rollouts.py", "data/collect.py", "live/simulated.py"}


def allowed(room: str) -> set[str]:
    """The rooms below ``room``."""
    if room in (*PURE, "support"):
        return set()
    if room in LINE:
        return {*PURE, *LINE[: LINE.index(room)]}
    return {*PURE, *LINE} if room in TOP else {*PURE, *LINE, *TOP}


def imports(path: Path, of: str = "tsjepa") -> set[str]:
    """What a file imports ``of`` this package, anywhere in it; what type checkers alone import is left out."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {name for name in found if name.startswith(of)}


def modules() -> dict[str, Path]:
    """Every module by name; a package is its __init__."""
    names = {path: path.relative_to(PACKAGE.parent).with_suffix("").parts for path in PACKAGE.rglob("*.py")}
    return {".".join(part for part in parts if part != "__init__"): path for path, parts in names.items()}


def room_of(module: str) -> str:
    return [*module.split("."), ""][1]


def test_rooms_import_rooms_below_them_only():
    wrong = [
        f"{module} imports {name}"
        for module, path in modules().items()
        for name in imports(path)
        if room_of(module) and room_of(name) not in {"", "support", room_of(module), *allowed(room_of(module))}
    ]
    assert not wrong


def test_no_module_imports_itself_by_a_detour():
    known = modules()
    # a package's own __init__ runs before its modules, which may import each other
    graph = {
        module: {name for name in imports(path) if name in known and not f"{module}.".startswith(f"{name}.")}
        for module, path in known.items()
    }
    assert list(graphlib.TopologicalSorter(graph).static_order())


def test_plants_radio_and_models_know_neither_torchrl_nor_lightning():
    for room in PURE:
        for path in (PACKAGE / room).rglob("*.py"):
            assert not {name.split(".")[0] for name in imports(path, "")} & {"torchrl", "tensordict", "lightning"}, path


def test_plants_are_stepped_by_the_chain_and_by_the_recording_alone():
    assert {path for path in map(steps_a_plant, PACKAGE.rglob("*.py")) if path} <= STEPPING


def steps_a_plant(path: Path) -> str | None:
    """The file within the package, where it is outside plants/ and envs/ and steps a plant or an environment."""
    name = path.relative_to(PACKAGE).as_posix()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            receiver = ast.unparse(node.func.value)
            environment = node.func.attr in ENVIRONMENT and ("env" in receiver or "fleet" in receiver)
            if (node.func.attr == "advance" or environment) and not name.startswith(("plants/", "envs/")):
                return name
    return None


def test_a_file_that_steps_a_plant_would_be_found(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "PACKAGE", tmp_path)
    for text in ("plant.advance(physics)", "self.env.step(now)", "fleet.rollout(3)"):
        (tmp_path / "other.py").write_text(text)
        assert steps_a_plant(tmp_path / "other.py") == "other.py"
    (tmp_path / "other.py").write_text("optimizer.step()")
    assert steps_a_plant(tmp_path / "other.py") is None
