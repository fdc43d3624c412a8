"""A command in a process of its own ends with the one that started it, however that ends, and can be continued."""

import contextlib
import io
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tiny
import torch

from tsjepa import cli
from tsjepa.models import entries
from tsjepa.support.files import exclusive
from tsjepa.zoo.child import run
from tsjepa.zoo.steps import ENTRIES, fits

NAME = "tsjepa-cartpole-d16"
HOME = Path("runs/zoo", NAME, "seed0", "jepa")  # of the fit
LAST = ("--ckpt_path", "last")
PATIENCE = 300.0  # seconds, of a busy machine
EPOCHS = 24  # more than pass between each checkpoint that is seen and its signal
LONG = {"max_epochs": EPOCHS, "check_val_every_n_epoch": EPOCHS}
ENDS = {signal.SIGKILL: -signal.SIGKILL, signal.SIGTERM: 128 + signal.SIGTERM, signal.SIGINT: -signal.SIGINT}


def test_a_command_is_timed_and_its_failure_is_named(capfd):
    assert run(["--version"]) > 0
    assert capfd.readouterr().out.startswith("tsjepa --version\ntsjepa ")
    with pytest.raises(RuntimeError, match="`tsjepa absent` ended with status 2"):
        run(["absent"])


def test_a_command_says_what_it_says_where_its_parent_prints(capfd):
    with contextlib.redirect_stdout(sys.stderr):  # as --json does
        run(["--version"])
    said = capfd.readouterr()
    assert said.out == "" and said.err.startswith("tsjepa --version\ntsjepa ")
    with contextlib.redirect_stdout(io.StringIO()):  # of no file, as in a notebook
        run(["--version"])
    assert capfd.readouterr().out.startswith("tsjepa ")


def test_sigterm_is_again_what_it_was_after_a_command():
    before = signal.getsignal(signal.SIGTERM)
    run(["--version"])
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_step_ends_when_its_standard_input_is_closed():
    code = (
        "import time; from tsjepa.cli import step; step.end_with_parent(); print('ready', flush=True); time.sleep(600)"
    )
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"ready\n"
        assert process.poll() is None
        process.stdin.close()
        assert process.wait(PATIENCE) == 1


def until(what, patience: float = PATIENCE):
    """Asks ``what`` until it says something."""
    began = time.monotonic()
    while not (found := what()):
        assert time.monotonic() - began < patience, "nothing happened"
        time.sleep(0.02)
    return found


def written(path: Path) -> int:
    """When a file was written; 0 where there is none."""
    return path.stat().st_mtime_ns if path.exists() else 0


def free(folder: Path) -> bool:
    """Whether nobody writes a folder any more."""
    try:
        with exclusive(folder):
            return True
    except FileExistsError:
        return False


@pytest.fixture
def home(tmp_path, monkeypatch):
    """The tiny recipes, with fits that last, as the working directory."""
    for name in tiny.NAMES:
        tiny.write(tmp_path, name, tiny.replace(tiny.shrink(tiny.load(name)), LONG))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def broken_off(words: list[str], end: signal.Signals) -> None:
    """Starts the fit from a process that is ended in the middle of it, and waits until the fit has ended too."""
    checkpoint = HOME / "checkpoints/last.ckpt"
    before = written(checkpoint)
    # a shell may start the tests in the background, where SIGINT is ignored
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    start = f"{heard}; from tsjepa.zoo.child import run; run({[*words, *(LAST if before else ())]})"
    with open("log.txt", "a") as log, subprocess.Popen([sys.executable, "-c", start], stdout=log, stderr=log) as parent:
        try:
            until(lambda: written(checkpoint) != before or parent.poll() is not None)
            assert parent.poll() is None and not free(HOME)
            parent.send_signal(end)
            assert parent.wait(PATIENCE) == ENDS[end]
        finally:
            parent.kill()
    if end == signal.SIGKILL:
        until(lambda: free(HOME))
    assert free(HOME)  # who could pass the signal on has waited
    assert not (HOME / "model").exists()


@pytest.mark.slow
def test_a_fit_whose_parent_was_ended_ends_and_is_continued_to_the_same_weights(home):
    words = fits(ENTRIES[NAME], HOME.parent.as_posix(), 0)["jepa"]
    for end in ENDS:
        broken_off(words, end)
    assert cli.main([*words, *LAST]) == 0
    continued = entries.load(HOME / "model").state_dict()
    HOME.rename("continued")
    assert cli.main(words) == 0
    undisturbed = entries.load(HOME / "model").state_dict()
    # the ranges of a codec, which the actor's fit finds, are not numbers yet
    torch.testing.assert_close(continued, undisturbed, rtol=0, atol=0, equal_nan=True)
