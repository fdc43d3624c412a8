import pytest
import torch
from tiny_controller import DIM, tiny
from torch.nn import functional as F

from tsjepa.envs.payload import embedding_codec
from tsjepa.evaluation.evaluate import evaluate
from tsjepa.models import entries
from tsjepa.radio.codecs import payload_bits


@pytest.fixture(scope="module")
def model():
    model = tiny()
    model.code_low.fill_(-0.5)
    model.code_high.fill_(0.9)
    return model


@pytest.mark.parametrize(("name", "bits", "step"), [("fp32", 32, 0), ("fp16", 16, 2**-11), ("int8", 8, 1.4 / 255)])
def test_what_is_received_is_what_was_sent_to_within_half_a_step_and_of_unit_length(model, name, bits, step):
    codec = embedding_codec(name, model)
    sent = F.normalize(torch.rand(50, DIM, generator=torch.Generator().manual_seed(1)) - 0.3, dim=-1)
    assert -0.5 < sent.min() < sent.max() < 0.9
    packets = codec.encode(sent)
    received = codec.decode(packets)
    assert (payload_bits(packets) == bits * DIM).all()
    torch.testing.assert_close(received.norm(dim=-1), torch.ones(50))
    # the length of what is decoded is off by at most half a step per dimension, times the square root of d
    assert ((received - sent).norm(dim=-1) <= step * DIM**0.5 + 1e-6).all()


def test_a_model_without_ranges_says_what_to_do():
    untrained = tiny()
    untrained.code_low.fill_(torch.nan)
    for name in ("int8", "int4"):
        with pytest.raises(ValueError, match=rf"codec {name} needs ranges.*FitCodec"):
            embedding_codec(name, untrained)
    embedding_codec("fp16", untrained)


@pytest.mark.parametrize(("name", "bits"), [("fp16", 16), ("int8", 8), ("int4", 4)])
def test_the_evaluation_sends_by_the_codec_and_counts_its_bits(model, tmp_path, name, bits):
    entry = str(entries.save(model, tmp_path / "model"))
    near = {"class_path": "tsjepa.plants.CartPole", "init_args": {"start_half_widths": [0.05, 0.05, 0.1, 0.1]}}
    small = {"plant": near, "periods": (5,), "seeds": 2, "starts_per_seed": 2, "slots": 10, "video": False}
    exact, coded = (evaluate(entry, output=str(tmp_path), codec=codec, **small) for codec in ("fp32", name))
    assert coded["codec"] == name
    pairs = zip(exact["closed_loop"], coded["closed_loop"], strict=True)
    rows = {row["controller"]: (row, other) for row, other in pairs}
    row, other = rows["TS-JEPA"]
    assert (row["bits_per_step"], other["bits_per_step"]) == (32 * DIM / 5, bits * DIM / 5)
    assert other["command_nmae"] != row["command_nmae"]
    assert other["command_nmae"] == pytest.approx(row["command_nmae"], rel=0.05)
    for name in ("expert, zero", "expert, hold last"):
        assert rows[name][0]["quadratic_cost"] == rows[name][1]["quadratic_cost"]
