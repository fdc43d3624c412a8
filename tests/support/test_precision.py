import copy
import os
import subprocess
import sys

import pytest
import torch

from tsjepa.models import Encoder
from tsjepa.support import precision
from tsjepa.support.precision import BFLOAT16, FLOAT32, Precision, candidates, choose, describe, memory_format_of

CPU = torch.device("cpu")
LAST32, FIRST32 = Precision(FLOAT32, "channels_last"), Precision(FLOAT32, "contiguous")
LAST16, FIRST16 = Precision(BFLOAT16, "channels_last"), Precision(BFLOAT16, "contiguous")


@pytest.fixture
def encoder():
    torch.manual_seed(0)
    return Encoder(widths=(8, 8, 8), embedding_dim=16)


def with_units(monkeypatch, flags: list[str]) -> None:
    """A processor with these instruction sets, on which torch would compute bfloat16 in one way or another."""
    for name in precision.LIMITS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(precision, "cpu_flags", lambda: flags)
    monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", lambda: True)


@pytest.mark.parametrize("flags", [["avx2", "avx512_bf16"], ["amx_bf16"], ["arm_bf16"]])
def test_bfloat16_comes_first_where_there_are_units(monkeypatch, flags):
    with_units(monkeypatch, flags)
    assert candidates(CPU) == [LAST16, FIRST16, LAST32, FIRST32]


@pytest.mark.parametrize("limit", ["AVX2", "AVX512_CORE", "AVX512_CORE_VNNI"])
def test_bfloat16_is_no_choice_where_it_is_emulated(monkeypatch, limit):
    with_units(monkeypatch, ["avx2", "avx512_f"])  # torch says "supported" of it: it emulates
    assert candidates(CPU) == [LAST32, FIRST32]
    with_units(monkeypatch, ["avx2", "avx512_f", "avx512_bf16"])
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", limit)
    assert candidates(CPU) == [LAST32, FIRST32]


@pytest.mark.slow
def test_under_the_limits_of_an_avx2_machine_it_is_float32():
    program = (
        "import torch\nfrom tsjepa.models import Encoder\nfrom tsjepa.support.precision import choose\n"
        "print(choose(Encoder(widths=(8, 8, 8), embedding_dim=16), torch.device('cpu')).trainer)"
    )
    limits = {"ONEDNN_MAX_CPU_ISA": "AVX2", "ATEN_CPU_CAPABILITY": "avx2", "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", program], env=os.environ | limits, capture_output=True, text=True)
    assert done.stdout.strip() == FLOAT32, done.stderr


@pytest.mark.parametrize(
    ("seconds", "chosen"),
    [
        ({LAST16: 1.0, FIRST16: 2.0, LAST32: 3.0, FIRST32: 3.0}, LAST16),
        ({LAST16: 1.0, FIRST16: 0.8, LAST32: 3.0, FIRST32: 3.0}, FIRST16),
        ({LAST16: 2.0, FIRST16: 2.0, LAST32: 1.0, FIRST32: 1.2}, LAST32),
        # so little more than the fastest is noise: the likeliest choice stays, and runs repeat
        ({LAST16: 1.08, FIRST16: 1.0, LAST32: 3.0, FIRST32: 3.0}, LAST16),
    ],
)
def test_the_fastest_is_chosen_unless_the_likeliest_is_as_good(monkeypatch, encoder, seconds, chosen):
    monkeypatch.setattr(precision, "candidates", lambda device: list(seconds))
    monkeypatch.setattr(precision, "seconds_a_step", lambda *arguments: seconds)
    assert choose(encoder, CPU) == chosen


def test_one_interrupted_step_does_not_choose(monkeypatch, encoder):
    """Steps that use the measurement's time up at once, of which one of the fastest way was interrupted."""
    steps = [0.1, 0.1, 9.0, 2.0, 1.0, 2.0, 1.0, 2.0]
    clock = iter([time for seconds in steps for time in (0.0, seconds)])
    monkeypatch.setattr(precision, "_now", lambda device: next(clock))
    assert precision.seconds_a_step(encoder, [LAST32, FIRST32], CPU) == {LAST32: 1.0, FIRST32: 2.0}


def test_measuring_changes_neither_the_encoder_nor_a_stream_nor_the_threads(encoder):
    before, stream, threads = copy.deepcopy(encoder.state_dict()), torch.get_rng_state(), torch.get_num_threads()
    seconds = precision.seconds_a_step(encoder, [LAST32, FIRST32], CPU)
    assert all(value > 0 for value in seconds.values())
    assert all(torch.equal(value, before[name]) for name, value in encoder.state_dict().items())
    assert all(parameter.grad is None for parameter in encoder.parameters())
    assert torch.equal(torch.get_rng_state(), stream)
    assert torch.get_num_threads() == threads
    assert memory_format_of(encoder) == "channels_last"


def test_what_has_no_encoder_is_not_measured(monkeypatch):
    monkeypatch.setattr(precision, "seconds_a_step", None)
    assert choose(None, CPU) == candidates(CPU)[0]
    assert choose(torch.nn.Linear(2, 2), CPU) == candidates(CPU)[0]


def test_the_memory_format_changes_no_embedding(encoder):
    frames = torch.randint(0, 256, (3, 2, 64, 128, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    expected = encoder(frames)
    encoder.to(memory_format=torch.contiguous_format)
    assert memory_format_of(encoder) == "contiguous"
    seen = []
    encoder.stages[0].conv1.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    torch.testing.assert_close(encoder(frames), expected)
    assert seen[0].is_contiguous()


def test_the_description_names_the_choice_and_the_limits(monkeypatch):
    monkeypatch.delenv("ATEN_CPU_CAPABILITY", raising=False)
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", "AVX2")
    text = describe(FIRST32, CPU)
    assert text.startswith("32-true, contiguous, on ") and text.endswith(", ONEDNN_MAX_CPU_ISA=AVX2")
