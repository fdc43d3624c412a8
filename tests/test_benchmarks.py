"""The benchmarks run, at a size at which their figures mean nothing; `make bench` begins with it."""

import importlib.util
import json
import operator
import subprocess
import sys

import pytest
import tiny
import tiny_controller

from tsjepa.models import entries

HOME = tiny.ROOT / "tests" / "benchmarks"


def in_a_process(script: str, folder, *options: str) -> dict:
    """What a benchmark writes that measures the memory of its own process."""
    output = folder / "out" / "result.json"
    command = [sys.executable, str(HOME / script), *options, "--output", str(output)]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return json.loads(output.read_text())


@pytest.fixture
def script(monkeypatch):
    """A benchmark's module, as it is imported when the script runs."""
    monkeypatch.syspath_prepend(str(HOME))
    return importlib.import_module


def main_of(module, monkeypatch, *options: str) -> None:
    monkeypatch.setattr("sys.argv", [module.__name__, *options])
    module.main()


@pytest.fixture
def run(tmp_path, script, monkeypatch):
    """Runs a benchmark in ``tmp_path``; what it writes."""

    def measured(name: str, *options: str) -> dict:
        output = tmp_path / "out" / "result.json"
        monkeypatch.chdir(tmp_path)
        main_of(script(name), monkeypatch, *options, "--output", str(output))
        return json.loads(output.read_text())

    return measured


@pytest.mark.benchmark
def test_camera(run):
    result = run("camera", "--devices", "3", "--rounds", "2", "--frames", "20")
    assert result["devices"] == 3
    assert set(result["frames_per_second"]) == {"fleet", "stock", "bare"}
    assert all(values["min"] > 0 and values["rounds"] == 2 for values in result["frames_per_second"].values())
    for other in ("stock", "bare"):
        ratio = result[f"fleet_over_{other}"]
        assert 0 < ratio["min"] <= ratio["median"] <= ratio["max"]


@pytest.mark.benchmark
def test_training_step(tmp_path):
    for name in ("recipes/jepa.yaml", "recipes/data.yaml"):
        tiny.write(tmp_path, name, tiny.shrink(tiny.load(name)))
    small = ["--steps", "4", "--warmup", "0", "--threads", "1", "--data.init_args.frames_per_batch", "16"]
    result = in_a_process("training_step.py", tmp_path, *small)
    assert result["samples_per_step"] == 16
    assert result["training_over_resident"]["median"] > 0
    assert result["gigaflop_per_step"] > 0
    assert result["training_over_flop_floor"]["median"] > 0
    assert 0 < result["peak_memory_gib"] < 6


@pytest.mark.benchmark
def test_commits(run):
    """This checkout beside itself."""
    result = run("commits", "--old", str(tiny.ROOT), "--only", "network", "--rounds", "1", "--threads", "1")
    assert result["network"]["new_over_old"]["median"] > 0
    assert result["network"]["old"]["rounds"] == 1


@pytest.mark.benchmark
def test_memory(tmp_path):
    result = in_a_process("memory.py", tmp_path, "--devices", "50", "--slots", "600")
    assert result["episodes"] == 300
    assert result["growth_percent"] < 2


@pytest.mark.benchmark
def test_loading(run):
    result = run("loading", "--rounds", "1", "--entries", "tsjepa-cartpole")
    assert set(result["seconds_to_load"]) == {"tsjepa-cartpole"}
    assert result["seconds_to_load"]["tsjepa-cartpole"]["min"] > 0


@pytest.mark.benchmark
def test_latency(tmp_path, run):
    model = str(entries.save(tiny_controller.tiny(), tmp_path / "model"))
    result = run("latency", "--model", model, "--rounds", "3", "--devices", "1", "7")
    assert result["payload_bits"] == 8 * 8
    assert result["frame_bits"] == 8 * 2 * 64 * 128 * 3
    assert 0 < result["device_memory"]["of_which_python_and_onnx_runtime_mib"] < result["device_memory"]["peak_mib"]
    assert set(result["controller"]) == {"1", "7"}
    # a hidden layer of 16 on 8 + 1 and an actor of 16 and 8 on 8
    multiplied = 9 * 16 + 16 * 8 + 8 * 16 + 16 * 8 + 8
    assert result["controller"]["7"]["megaflop"] == 2 * 7 * multiplied / 1e6
    for row in (result["device"], *result["controller"].values()):
        assert row["floor_milliseconds"]["rounds"] == 3
        assert all(row[name]["min"] > 0 for name in ("floor_milliseconds", "onnx_over_floor", "eager_over_onnx"))


@pytest.mark.benchmark
def test_experts(tmp_path, script, monkeypatch):
    small = ["--seeds", "2", "--starts", "3", "--entries", "1", "--output", str(tmp_path)]
    main_of(script("experts"), monkeypatch, *small)
    result = json.loads((tmp_path / "experts.json").read_text())
    kinds = {(row["expert"], row["held_slots"], row["noise"]) for row in result["rows"]}
    assert len(kinds) == len(result["rows"]) == 12
    assert all(row["starts"] == 6 and 0 <= row["failures"] <= 6 for row in result["rows"])
    (card,) = result["cards"]
    # a better normaliser makes every score smaller
    assert card["every 1"]["searched"][0] < card["every 1"]["card"][0]
    assert "| searched law | 1 |" in (tmp_path / "experts.md").read_text()


@pytest.mark.benchmark
def test_hierarchy(tmp_path, script, monkeypatch):
    small = ["--steps", "2", "--training_seeds", "2", "--seeds", "2", "--starts", "2", "--sizes", "2", "3"]
    small += ["--fleet_seeds", "1", "--episodes", "2", "1", "--work", str(tmp_path / "work"), "--output", str(tmp_path)]
    main_of(script("hierarchy"), monkeypatch, *small)
    result = json.loads((tmp_path / "hierarchy.json").read_text())
    rows = result["rows"]
    assert {row["kind"] for row in rows.values()} == {"flat", "strides", "strides, no agreement", "flat, as shipped"}
    flat, strides = rows["flat, 0"]["parameters"], rows["strides, 0"]["parameters"]
    assert abs(strides - flat) < 0.01 * flat
    # of the predictors only the shipped one has learnt anything
    assert rows["flat, as shipped, 0"]["errors"]["10"][0] < rows["flat, 0"]["errors"]["10"][0]
    assert "Strides less flat" in (tmp_path / "hierarchy.md").read_text()
    before = (tmp_path / "work" / "rows.journal").read_bytes()
    main_of(script("hierarchy"), monkeypatch, *small)
    assert (tmp_path / "work" / "rows.journal").read_bytes() == before


def rows(script, part: str, result: dict) -> list[list[str]]:
    """What the table shows of a result: name, figure, peer or limit, ratio, target, met."""
    return [row.cells() for row in script("table").PARTS[part](result)]


@pytest.mark.benchmark
def test_fleet(tmp_path, script, run):
    model = str(entries.save(tiny_controller.tiny(), tmp_path / "model"))
    small = ["--devices", "1", "3", "--batch", "4", "--rounds", "2", "--steps", "6", "--threads", "1"]
    result = run("fleet", "--model", model, *small)
    # the stem on 16 x 32 patches of 96 channels, three blocks that halve the sides, a projection
    multiplied = 16 * 32 * 9 * 96 * 4
    for positions, before, after in ((8 * 16, 4, 4), (4 * 8, 4, 8), (2 * 4, 8, 8)):
        multiplied += positions * (9 * before * after + 9 * after * after + before * after)
    multiplied += 2 * 4 * 8 * 8
    assert result["encoder_megaflop"] == 2 * multiplied / 1e6
    assert result["frame_bytes_per_observation"] == 2 * 64 * 128 * 3
    assert [row["devices"] for row in result["fleet"]] == [1, 3]
    assert all(row["fleet_over_alone"]["min"] > 0 and row["fleet_over_alone"]["rounds"] == 2 for row in result["fleet"])
    encoding = result["encoding"]
    assert all(encoding[way]["over_one_by_one"]["min"] > 0 for way in ("batched", "bfloat16"))
    assert 0.999 < encoding["least_cosine_of_bfloat16"] < 1.00001
    assert len(rows(script, "fleet", result)) == 8
    # at three times one by one, or at what the FLOPs allow
    for ratio, share, met in ((3.0, 0.5, "yes"), (2.9, 0.9, "yes"), (2.9, 0.89, "no")):
        for name, value in (("over_one_by_one", ratio), ("over_float32_floor", share)):
            encoding["batched"][name] = {"median": value, "min": value, "max": value, "rounds": 2}
        assert rows(script, "fleet", result)[4][-1] == met


def test_shares_of_the_floor(script):
    fleet = script("fleet")
    # 10 embeddings a second of 5 operations each, where 200 operations a second are possible
    assert fleet.shares([10.0, 4.0], [200.0, 20.0], flops=5) == [0.25, 1.0]
    assert fleet.ratios([6.0, 1.0], [2.0, 4.0]) == [3.0, 0.25]


@pytest.mark.benchmark
def test_collection(tmp_path, script, run):
    tiny.write(tmp_path, "recipes/data.yaml", tiny.shrink(tiny.load("recipes/data.yaml")))
    result = run("collection", "--rounds", "1", "--bare-frames", "20")
    assert (result["trajectories"], result["frames"]) == (6 * 2, 6 * 2 * 61)
    assert result["of_which_start_seconds"]["median"] > 0
    assert result["frames_per_second"]["bare"]["min"] > 0
    figures = {"seconds": {"median": 30.0}, "of_which_start_seconds": {"median": 10.0}}
    rates = {"frames_per_second": {"collection": {"median": 1800.0}, "bare": {"median": 2000.0}}}
    ratio = {"collection_over_bare": {"median": 0.9, "min": 0.85, "max": 1.25, "rounds": 3}}
    (cells,) = rows(script, "collection", result | figures | rates | ratio)
    assert cells[1:] == [
        "30.0 s, 10.0 s of them to start; 1,800 frames/s",
        "bare render loop: 2,000",
        "0.9 (0.85 to 1.25)",
        "",
        "",
    ]


def test_least_collection(script):
    collection = script("collection")
    recipe = {"slots": 9, "splits": {"train": {"episodes": 5, "coverage": False}, "test": {"episodes": 2}}}
    assert collection.frames_of(recipe) == 70
    assert collection.frames_of(collection.least(recipe)) == 20
    assert collection.least(recipe)["splits"]["train"] == {"episodes": 1, "coverage": False}


@pytest.mark.benchmark
def test_quality(tmp_path, script, run):
    for name in ("jepa", "actor", "data", "evaluate"):
        tiny.write(tmp_path, f"recipes/{name}.yaml", tiny.shrink(tiny.load(f"recipes/{name}.yaml")))
    result = run("quality", "--epochs", "1", "--threads", "1", "--recipes", "recipes")
    (trained,) = result["runs"]
    assert set(trained["seconds"]) == {"collect_and_fit", "fit_actor", "evaluate"}
    spent = trained["seconds"]["collect_and_fit"] + trained["seconds"]["fit_actor"]
    assert trained["seconds_to_train"] == pytest.approx(spent)
    assert trained["starts"] == 12
    assert 0 <= trained["normalized_score"] < 0.9
    assert result["seconds_to_score"] == {"0.9": None, "0.95": None}
    assert [cells[1::4] for cells in rows(script, "quality", result)] == [["not reached", ""], ["not reached", "no"]]


def test_seconds_to_a_score_are_those_of_the_fastest_run_that_reaches_it(script):
    scored = ((0.89, 100), (0.93, 300), (0.95, 450), (0.97, 700))
    runs = [{"normalized_score": score, "seconds_to_train": seconds} for score, seconds in scored]
    quality = script("quality")
    assert [quality.seconds_to(score, runs) for score in (0.9, 0.95, 0.98)] == [300, 450, None]
    assert quality.seconds_to(0.9, []) is None


@pytest.mark.benchmark
def test_network(tmp_path, script, run):
    result = run("network", "--slots", "4", "--threads", "1")
    assert set(result["channel_aware_on_one_thread"]) == {"100", "1000", "10000", "100000"}
    assert all(rate["min"] > 0 for rate in result["device_slots_per_second"].values())
    text = (tmp_path / "out" / "result.txt").read_text()
    assert "pure network mode, I = 1000" in text
    assert all(f"  {scheduler} " in text for scheduler in result["device_slots_per_second"])
    assert len(rows(script, "network", result)) >= 6


@pytest.mark.benchmark
def test_radio(script, run):
    small = ["--devices", "2", "--slots", "2", "--rounds", "1", "--network-slots", "2", "--beside", str(tiny.ROOT)]
    result = run("radio", *small)
    assert result["network"]["ours_over_other"]["min"] > 0.05  # the same package twice, at a size that means nothing
    (row,) = result["fleet"]
    assert set(row["device_steps_per_second"]) == {"channel_aware", "expected_urgency", "urgency"}
    assert [cells[0] for cells in rows(script, "radio", result)] == [
        "network alone, I = 1000, one thread",
        "fleet by urgency, all devices drawn and encoded, I = 2",
    ]


@pytest.mark.benchmark
def test_calibration(tmp_path, script, monkeypatch):
    calibration = script("calibration")
    sizes = {"NETWORKS": 3, "DEVICES": 6, "BLOCKS": 2, "WARM_UP": 2, "SLOTS": 20, "KNOWLEDGE": ("perfect", "acks")}
    for name, value in sizes.items():
        monkeypatch.setattr(calibration, name, value)
    monkeypatch.setattr(calibration, "FLEET", dict.fromkeys(calibration.FLEET, 12))
    main_of(calibration, monkeypatch, "--control", "--seeds", "2", "--output", str(tmp_path))
    found = json.loads((tmp_path / "calibration.json").read_text())["rows"]
    assert [(row["csi"], row["channel"]) for row in found[:2]] == [("perfect", "independent"), ("acks", "independent")]
    assert len(found) == 2 * len(calibration.CHANNELS)
    # whoever knows the SNR of the slot, and of no other loss, is right every time
    assert found[0]["predicted"] == found[0]["realised"] == 1 and found[0]["interval_95"] == 0
    assert all(0 < row["realised"] <= 1 for row in found)
    # a schedule by age alone does not ask what is known of the links
    assert all(row["control"]["max_age"] > 0 for row in found)
    assert found[0]["control"]["max_age"] == found[1]["control"]["max_age"]
    lines = (tmp_path / "calibration.md").read_text().splitlines()
    assert sum(line.startswith("| ") for line in lines) == 1 + len(found)
    assert all(line.count("|") == 10 for line in lines if line.startswith("|"))


@pytest.mark.benchmark
def test_downlink(tmp_path, script, monkeypatch):
    downlink = script("downlink")
    for name, value in {"SILENT": (0, 2), "LOSSES": (0.3,), "BUFFERS": {"hold": 1, "buffer of 4": 4}}.items():
        monkeypatch.setattr(downlink, name, value)
    small = ["--seeds", "2", "--starts", "5", "--slots", "140", "--output", str(tmp_path)]
    main_of(downlink, monkeypatch, *small)
    found = json.loads((tmp_path / "downlink.json").read_text())["rows"]
    assert [(row["silent_slots"], row["loss"]) for row in found] == [(0, 0), (2, 0), (0, 0.3)]
    scores = [{name: sum(values) / 2 for name, values in row["scores"].items()} for row in found]
    assert {name.split(", ")[1] for name in scores[0]} == {"hold", "buffer of 4"}
    # the true state's linear prediction is nearly exact without noise, so that a buffer loses nothing
    for name in ("true state, buffer of 4", "true state, hold"):
        assert scores[0][name] > 0.5
    assert abs(scores[1]["true state, buffer of 4"] - scores[0]["true state, hold"]) < 0.1
    scored, differs = (tmp_path / "downlink.md").read_text().split("## ")[1:]
    for part, first in ((scored, f"{scores[0]['true state, hold']:.3f}"), (differs, "+0.000 ± 0.000")):
        lines = [line.split(" | ") for line in part.splitlines() if line.startswith("| ")]
        assert len(lines) == 1 + len(found)
        assert lines[1][lines[0].index("true state, hold")].startswith(first)


def test_peers_that_are_not_installed_are_left_out_with_the_reason(script):
    assert script("peers").missing("no-such-package")["left_out"].startswith("no-such-package is not installed")
    assert script("peers").missing("torch") is None


@pytest.mark.benchmark
def test_a_trainer_takes_turns(tmp_path, script, monkeypatch):
    for name in ("recipes/jepa.yaml", "recipes/data.yaml"):
        tiny.write(tmp_path, name, tiny.shrink(tiny.load(name)))
    monkeypatch.chdir(tmp_path)
    peers, turns = script("peers"), script("turns")
    small = ["--data.init_args.frames_per_batch", "16"]
    trainer = turns.Contender(peers.ours, "recipes/jepa.yaml", 1, small, target=peers.train)
    # more steps than an epoch has
    assert all(trainer.rate(steps) > 0 for steps in (1, 30))
    trainer.stop()
    assert trainer.process.exitcode == 0


def test_a_contender_that_dies_is_named(script):
    with pytest.raises(RuntimeError, match="truediv ended with status 1"):
        script("turns").Contender(operator.truediv, 1, 0)


@pytest.mark.benchmark
@pytest.mark.skipif(importlib.util.find_spec("lightly") is None, reason="the extra bench is not installed")
def test_peers(tmp_path, script):
    for name in ("recipes/jepa.yaml", "recipes/data.yaml"):
        tiny.write(tmp_path, name, tiny.shrink(tiny.load(name)))
    small = ["--rounds", "2", "--steps", "2", "--devices", "3", "--frames", "20", "--threads", "1"]
    result = in_a_process("peers.py", tmp_path, *small, "--data.init_args.frames_per_batch", "16")
    assert result["training"]["ours_over_lightly"]["min"] > 0
    assert result["environment"]["fleet_over_swm"]["rounds"] == 2
    assert len(rows(script, "peers", result)) == 3


def test_a_command_that_fails_stops_the_benchmark(tmp_path, script):
    with pytest.raises(SystemExit, match=r"tsjepa no-such-command ended with status 2: .*there is no command"):
        script("command").seconds_to_run(tmp_path, "no-such-command")


@pytest.mark.parametrize(
    ("value", "at_most", "met"), [(3.0, False, "yes"), (2.9, False, "no"), (3.0, True, "yes"), (3.1, True, "no")]
)
def test_a_target_is_met_or_not(script, value, at_most, met):
    Row = script("table").Row
    sign = "≤" if at_most else "≥"
    assert Row("a", "b", target=3, value=value, at_most=at_most).cells() == ["a", "b", "", "", f"{sign} 3", met]
    assert Row("a", "b", target=3, value=None, at_most=at_most).cells()[-1] == "no"
    assert Row("a", "b", value=value).cells()[-1] == ""


def test_table(tmp_path, script):
    origin = {
        "made_by": {"command": "memory.py", "commit": "abc", "date": "2026-01-02"},
        "machine": {"processor": "P", "cores": 2, "load_average": 0.1},
    }
    memory = {"devices": 1000, "slots": 10_000, "resident_mb_after_a_tenth": 500.0, "growth_percent": 2.5}
    loading = {"limit_s": 2.0, "seconds_to_load": {"quick": {"median": 0.5}, "slow": {"median": 1.5}}}
    for name, figures in (("memory", memory), ("loading", loading)):
        (tmp_path / f"{name}.json").write_text(json.dumps(origin | figures))
    lines = script("table").table(tmp_path).splitlines()
    assert "| loading the slowest of 2 zoo entries, slow | 1.50 s |  |  | ≤ 2 s | yes |" in lines[2]
    assert lines[3] == (
        "| memory growth in per cent, 1,000 devices for 10,000 slots | 2.5 | 500.0 MB after a tenth |  | ≤ 2 % | no "
        "| abc |"
    )
    made = "- memory.json: abc, 2026-01-02, 2 cores of P, load average 0.1 at the end; "
    assert made + "`python tests/benchmarks/memory.py`" in lines
    assert lines[-1].startswith("- not measured: camera.json, collection.json, ")


def test_the_table_reads_what_is_recorded(script):
    text = script("table").table(tiny.ROOT / "docs" / "results")
    assert "| camera, fleet of 64 |" in text
    assert all(line.count("|") == 8 for line in text.splitlines() if line.startswith("|"))
