"""Two network namespaces with the kernel's own weather between them; skipped where they may not be made."""

import json
import os
import shutil
import signal
import subprocess

import pytest
from test_processes import SLOW, Process, lines, until

SETUP = """
ip netns add {a} && ip netns add {b} &&
ip link add {a} type veth peer name {b} && ip link set {a} netns {a} && ip link set {b} netns {b} &&
ip -n {a} addr add 10.77.0.1/24 dev {a} && ip -n {b} addr add 10.77.0.2/24 dev {b} &&
ip -n {a} link set {a} up && ip -n {b} link set {b} up &&
ip netns exec {b} tc qdisc add dev {b} root netem loss 30% delay 20ms
"""


@pytest.fixture
def namespaces():
    """Names of a namespace for the controller and of one for the device, whose packets are lost and late."""
    if shutil.which("ip") is None or shutil.which("tc") is None:
        pytest.skip("ip and tc (iproute2) are not installed")
    names = {"a": f"tsj{os.getpid()}a", "b": f"tsj{os.getpid()}b"}
    made = subprocess.run(SETUP.format(**names), shell=True, capture_output=True, text=True)
    try:
        if made.returncode:
            pytest.skip(f"network namespaces with netem may not be made here: {made.stderr.strip().splitlines()[-1]}")
        yield names["a"], names["b"]
    finally:
        for name in names.values():
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


@pytest.mark.slow
def test_a_device_is_controlled_through_the_kernels_weather(deployed, tmp_path, namespaces):
    here, there = namespaces
    options = ["--bind", "10.77.0.1:5700", "--log", tmp_path / "log.csv", "--report", tmp_path / "c.json"]
    with Process("controller", deployed, *options, *SLOW, within=here) as controller:
        options = ["--controller", "10.77.0.1:5700", "--report", tmp_path / "d.json"]
        with Process("device", deployed, *options, *SLOW, within=there) as device:
            until(lambda: lines(tmp_path / "log.csv") > 60, "no updates")
            assert device.end(signal.SIGTERM)[0] == 0
        assert controller.end(signal.SIGTERM)[0] == 0
    sent, heard = (json.loads((tmp_path / name).read_text()) for name in ("d.json", "c.json"))
    arrived = heard["counts"]["updates"] / sent["updates"]["sent"]
    assert 0.45 < arrived < 0.9  # of 80 or more; .7 is meant
    assert heard["counts"]["predictions"] > 0
    assert sent["commands"]["received"] > heard["counts"]["updates"]
