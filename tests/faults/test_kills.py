"""A kill of every command; `make faults` does fifty."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_every_command_survives_being_killed(tmp_path):
    output = tmp_path / "faults.json"
    script = Path(__file__).parent / "kills.py"
    done = subprocess.run(
        [sys.executable, str(script), "--kills", "1", "--output", str(output)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    commands = json.loads(output.read_text())["commands"]
    assert set(commands) == {"collect", "fit", "sweep", "export"}
    assert all(row["kills"] == row["survived"] == 1 for row in commands.values()), commands
