"""What a spec says of a machine beside what it was given."""

import pytest

from tsjepa.support.spec import PlantSpec


@pytest.mark.parametrize(
    ("low", "high", "rest"), [((-20.0,), (20.0,), (0.0,)), ((0.5, -3.0, -1.0), (2.0, -1.0, 0.0), (0.5, -1.0, 0.0))]
)
def test_a_machine_rests_under_the_command_nearest_to_zero(low, high, rest):
    assert PlantSpec(low, high, slot=0.02, frame=(64, 128)).rest == rest
