import os

import pytest

from tsjepa.cli import doctor
from tsjepa.support import processor, provenance


@pytest.mark.parametrize(
    ("quota", "cores"),
    [("200000 100000\n", 2), ("150000 100000\n", 2), ("max 100000\n", 6), ("6400000 100000\n", 6), (None, 6)],
)
def test_cores_are_those_that_affinity_and_container_allow(tmp_path, monkeypatch, quota, cores):
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(6)), raising=False)
    monkeypatch.setattr(processor, "QUOTA", tmp_path / "cpu.max")
    if quota is not None:
        (tmp_path / "cpu.max").write_text(quota)
    assert processor.cores() == cores
    assert provenance.machine()["cores"] == cores
    ((_, line),) = [each for each in doctor._machine()[0] if each[0] == "cpu"]
    assert line == f"{processor.processor()}, {cores} usable cores"


def test_a_processor_has_the_name_that_the_system_gives_it(tmp_path, monkeypatch):
    monkeypatch.setattr(processor.sys, "platform", "linux")
    monkeypatch.setattr(processor, "CPUINFO", tmp_path / "cpuinfo")
    (tmp_path / "cpuinfo").write_text("processor : 0\nmodel name\t: A Chip 9000\n")
    assert processor.processor() == "A Chip 9000"
    (tmp_path / "cpuinfo").unlink()
    assert processor.processor()
