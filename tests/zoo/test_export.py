"""``tsjepa export``: what is refused before anything is evaluated or written."""

import pytest
from tiny_controller import tiny_autoencoder

from tsjepa.models import entries
from tsjepa.zoo.export import export


def test_an_autoencoder_is_not_exported_without_the_decoder_that_it_acts_by(tmp_path):
    entries.save(tiny_autoencoder(), tmp_path / "run" / "model")
    with pytest.raises(ValueError, match="acts on what its decoder draws"):
        export(str(tmp_path / "run"), "absent", folder=str(tmp_path), decoder=False)
    assert not (tmp_path / "absent").exists()
