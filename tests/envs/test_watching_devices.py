"""What devices say of their urgency and what a controller expects, against the same worked out by hand."""

import pytest
import torch
from linear_fleet import A, B, LinearFleet
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tsjepa.envs.transforms import (
    AgeCost,
    Channel,
    Codec,
    Estimator,
    ExpectedGain,
    HoldCommand,
    Scheduler,
    Twin,
    Uplink,
    Urgency,
    linear_model,
)
from tsjepa.radio.codecs import FloatCodec
from tsjepa.radio.expected_error import expected_gain, learn, situation, start_record
from tsjepa.radio.urgency import UrgencyCode

GAIN, RANGE, REST = torch.tensor([[3.0, 1.0]]), 40.0, 0.1
CODE = UrgencyCode(4, full_scale=1.0, smallest=0.001)


def law(state, reference=None):
    return state @ GAIN.mT / RANGE


def beyond(state):
    return state[..., 0].abs() > 1.5


def twin(**changes):
    values = {"predict": linear_model(A, B), "failed": beyond, "holds": False}
    return Twin(law=law, rest=torch.tensor([REST]), action_range=torch.tensor([RANGE]), **{**values, **changes})


def policy(tensordict):
    """Disturbs the plant by what the controller does not know: the slot's number on top of its own command."""
    push = 0.3 * torch.sin(tensordict["slot"] + torch.arange(tensordict.shape[0])).unsqueeze(-1)
    return tensordict.set("action", push - law(tensordict["belief"]) * RANGE)


def wrong_model(belief, action):
    """Misses the push, so that errors grow."""
    return belief @ A.mT - 0.1 * law(belief) * torch.tensor([0.0, RANGE])


def rollout(*transforms, lengths=None, slots=40, end=None, with_policy=policy):
    chain = [Channel(snr_target_db=8.0), *transforms, Codec(FloatCodec(), in_key="state"), Uplink()]
    env = TransformedEnv(LinearFleet((6,), lengths), Compose(*chain, end or Estimator(wrong_model)))
    return env.rollout(slots, with_policy, break_when_any_done=False)


def said(data, delay=0, code=None):
    """Urgency [I, T] by hand from what a rollout of one episode shows."""
    slots, requests, urgency = data.shape[1], [torch.zeros(6).double()] * delay, []
    for slot in range(slots):
        told = torch.full((6, 1), REST)
        if slot:
            belief = wrong_model(data["belief"][:, slot - 1], data["action"][:, slot - 1])
            told = torch.where(data["informed"][:, slot - 1, None], law(belief), told)
            requests = [request.masked_fill(data["delivered"][:, slot - 1], 0) for request in requests]
        error = (law(data["state"][:, slot]) - told).abs()[:, 0].double()
        error = error.masked_fill(beyond(data["state"][:, slot]), 0)
        requests.append(code.decode(code.encode(error)) if code else error)
        urgency.append(requests.pop(0))
    return torch.stack(urgency, 1)


def test_a_device_knows_how_wrong_its_controller_is():
    data = rollout(Urgency(twin(predict=wrong_model), "state"), Scheduler("genie", 1))
    torch.testing.assert_close(data["true_error"], said(data), atol=1e-6, rtol=1e-5)
    assert torch.equal(data["urgency"], data["true_error"]) and (data["signalling_bits"] == 0).all()
    assert data["delivered"].any() and (data["true_error"] > 0).float().mean() > 0.5


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_requests_are_coded_late_and_cleared_on_delivery(delay):
    data = rollout(Urgency(twin(predict=wrong_model), "state", CODE, delay), Scheduler("urgency", 2))
    torch.testing.assert_close(data["urgency"], said(data, delay, CODE), atol=1e-6, rtol=1e-5)
    assert set(data["urgency"].unique().tolist()) <= set(CODE.levels().tolist())
    if delay:
        after = data["delivered"][:, :-1]
        assert after.any() and (data["urgency"][:, 1:][after] == 0).all()
    assert (data["signalling_bits"] == 4).all()


@pytest.mark.parametrize("delay", [0, 1])
def test_for_a_first_contact_devices_ask_until_they_are_heard(delay):
    lengths = [40, 40, 40, 40, 40, 9]
    urgency = Urgency(twin(predict=wrong_model), "state", CODE, delay, first_contact=True)
    data = rollout(urgency, Scheduler("first_contact", 1), lengths=lengths)
    watched = rollout(Urgency(twin(predict=wrong_model), "state", CODE, 0), Scheduler("first_contact", 1))
    for device in range(6):
        heard = False
        for slot in range(40):
            fresh = device == 5 and slot % 9 == 0
            heard = not fresh and (heard or (slot > 0 and bool(data["delivered"][device, slot - 1])))
            assert data["signalling_bits"][device, slot] == (0 if heard else 4)
            if heard:
                assert data["urgency"][device, slot] == 0
    first = data["urgency"][:, delay]
    assert torch.equal(first, watched["urgency"][:, 0].masked_fill(data["delivered"][:, 0] & (delay > 0), 0))
    assert first.max() > 0 and (data["true_error"][:, -1] > 0).any()


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("change", [1, 3])
def test_where_only_changes_are_said_the_base_station_keeps_to_what_it_heard(delay, change):
    """Slot by slot and device by device, in plain numbers, beside what a device that speaks in every slot would say."""
    urgency = Urgency(twin(predict=wrong_model), "state", CODE, delay, change=change)
    data = rollout(urgency, Scheduler("urgency", 2))
    codes = CODE.encode(data["true_error"])
    for device in range(6):
        heard, on_the_way = 0, [0] * delay
        for slot in range(40):
            if slot and data["delivered"][device, slot - 1]:
                heard, on_the_way = 0, [0] * delay
            speaks = abs(int(codes[device, slot]) - heard) >= change
            heard = int(codes[device, slot]) if speaks else heard
            on_the_way.append(heard)
            assert data["signalling_bits"][device, slot] == (4 + 3 if speaks else 0)  # 3 bits name one of 6 devices
            assert data["urgency"][device, slot] == CODE.levels()[on_the_way.pop(0)]
    silent = data["signalling_bits"] == 0
    assert silent.any() and not silent.all() and (codes[silent] > 0).any()


def test_with_a_right_model_only_the_unheard_are_urgent():
    data = rollout(Urgency(twin(), "state"), Scheduler("genie", 1), end=Estimator(linear_model(A, B)))
    informed = torch.cat((torch.zeros(6, 1, dtype=torch.bool), data["informed"][:, :-1]), 1)
    assert (data["true_error"][informed] < 1e-5).all()
    unheard = ~informed & ~beyond(data["state"])
    wanted = (law(data["state"]) - REST).abs()[..., 0].double()
    torch.testing.assert_close(data["true_error"][unheard], wanted[unheard])


def test_the_most_urgent_is_served_first_and_the_lost_one_is_not():
    still = lambda tensordict: tensordict.set("action", torch.zeros(6, 1))  # noqa: E731
    data = rollout(Urgency(twin(), "state"), Scheduler("genie", 1), slots=1, with_policy=still)
    # states grow with the index: 0.1, -0.2 times 1 to 6; the channel of this seed lets 4 be heard
    able = data["snr"][:, 0] >= 10**0.5
    wanted = data["true_error"][:, 0].masked_fill(~able, -1)
    assert data["scheduled"][:, 0].nonzero().item() == wanted.argmax().item()
    lost = rollout(Urgency(twin(failed=lambda state: state[..., 0] > 0.35), "state"), Scheduler("genie", 1))
    assert (lost["true_error"][lost["state"][..., 0] > 0.35] == 0).all()


@pytest.mark.parametrize(("between", "holds"), [("hold", True), ("zero", False)])
def test_of_a_held_command_the_urgency_is_its_distance_to_the_right_one(between, holds):
    expert = lambda tensordict: tensordict.set("action", -law(tensordict["received"]) * RANGE)  # noqa: E731
    urgency = Urgency(twin(predict=None, holds=holds), "state")
    data = rollout(urgency, Scheduler("genie", 1), end=HoldCommand(between), with_policy=expert)
    held = data["held_command"][:, 1:] / RANGE if holds else torch.full((6, 39, 1), REST)
    error = (law(data["state"][:, 1:]) - held).abs()[..., 0].double()
    torch.testing.assert_close(
        data["true_error"][:, 1:], error.masked_fill(beyond(data["state"][:, 1:]), 0), atol=1e-6, rtol=1e-5
    )


def test_the_cost_of_age_is_that_of_a_device_heard_or_not_and_nothing_of_a_fallen_one():
    heard, unheard = torch.arange(60.0).double(), 1000 + torch.arange(60.0).double()
    fallen = lambda state: state[..., 0].abs() > 0.45  # noqa: E731
    data = rollout(AgeCost(heard, unheard, fallen), Scheduler("max_age", 2), lengths=[40, 40, 40, 40, 40, 7], slots=30)
    for device in range(6):
        start, last = 0, None
        for slot in range(30):
            if device == 5 and slot in (7, 14, 21, 28):
                start, last = slot, None
            age = slot - start + 1 if last is None else slot - last
            expected = unheard[age] if last is None else heard[age]
            if last is not None and fallen(data["state"][device, last]):
                expected = 0.0
            assert data["age_cost"][device, slot] == expected, (device, slot)
            last = slot if data["delivered"][device, slot] else last
    assert (data["age_cost"] == 0).any() and (data["age_cost"] >= 1000).any()


def test_a_controller_learns_from_what_it_hears():
    data = rollout(ExpectedGain(twin(predict=wrong_model)), Scheduler("expected_urgency", 2))
    record, told = start_record((6,)), torch.full((6, 1), REST)
    age, informed, places = torch.ones(6, dtype=torch.int64), torch.zeros(6, dtype=torch.bool), None
    for slot in range(data.shape[1]):
        if slot:
            before = data[:, slot - 1]
            error = (law(before["received"]) - told).abs()[:, 0].double()
            record = learn(record, places, error, before["delivered"] & ~beyond(before["received"]))
            belief, informed, age = (
                wrong_model(before["belief"], before["action"]),
                before["informed"],
                before["age_of_information"],
            )
            told = torch.where(informed.unsqueeze(-1), law(belief), torch.full((6, 1), REST))
        places = situation(age, informed)
        gain = expected_gain(record, places)
        if slot:
            gain = gain.masked_fill(informed & beyond(belief), 0)
        torch.testing.assert_close(data["expected_gain"][:, slot], gain, atol=1e-9, rtol=1e-5)
    assert record.updates.sum() > 20


def test_of_a_held_command_whoever_was_not_heard_is_unheard():
    end = HoldCommand("hold")
    expert = lambda tensordict: tensordict.set("action", -law(tensordict["received"]) * RANGE)  # noqa: E731
    gain = ExpectedGain(twin(predict=None, holds=True))
    data = rollout(gain, Scheduler("expected_urgency", 1), end=end, with_policy=expert, lengths=[40] * 5 + [7])
    for device in range(6):
        heard, age = False, 1
        for slot in range(40):
            if device == 5 and slot % 7 == 0:
                heard, age = False, 1
            elif slot:
                heard, age = (
                    heard or bool(data["delivered"][device, slot - 1]),
                    data["age_of_information"][device, slot - 1],
                )
            assert data["error_situation"][device, slot] == situation(torch.as_tensor(age), torch.tensor(heard))


def chain_of(name):
    if name == "expected_urgency":
        return ExpectedGain(twin(predict=wrong_model)), Scheduler(name, 6)
    change = 2 if name == "urgency" else None
    urgency = Urgency(twin(predict=wrong_model), "state", CODE, 2, first_contact=name == "first_contact", change=change)
    return urgency, Scheduler(name, 6)


@pytest.mark.parametrize("name", ["urgency", "expected_urgency"])
def test_resetting_devices_leaves_the_others_alone_and_the_record_alive(name):
    quiet, lengths = rollout(*chain_of(name)), [9, 1000, 12, 1000, 7, 1000]
    noisy = rollout(*chain_of(name), lengths=lengths)
    kept = torch.tensor(lengths) == 1000
    for key in ("state", "belief", "delivered", "true_error", "urgency", "urgency_requests"):
        if key in quiet:
            assert torch.equal(noisy[key][kept], quiet[key][kept]), key
    first = noisy["slot"] == 0
    if name == "urgency":
        assert (noisy["urgency"][first] == 0).all() and first.sum() > 6
    else:
        heard = noisy["error_record"][..., 1, :].sum(-1)
        assert (heard.diff(dim=1) >= 0).all() and heard[0, -1] > 5


@pytest.mark.parametrize("name", ["urgency", "first_contact", "expected_urgency"])
def test_specs(name):
    chain = [Channel(), *chain_of(name), Codec(FloatCodec(), in_key="state"), Uplink(), Estimator(wrong_model)]
    check_env_specs(TransformedEnv(LinearFleet((6,)), Compose(*chain)))


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="delay -1"):
        Urgency(twin(), delay=-1)
    for bad in ({"change": 0, "code": CODE}, {"change": 1}):
        with pytest.raises(ValueError, match="at least 1 code"):
            Urgency(twin(), **bad)
    with pytest.raises(KeyError, match="put a Camera and an Encode before it"):
        rollout(Urgency(twin()), Scheduler("urgency", 1))
