from types import SimpleNamespace

import pytest
import tiny_controller
import torch
from tensordict import TensorDict

from tsjepa.training.finish.codec import FitCodec


def pixels(episodes: int, seed: int) -> TensorDict:
    """A split [episodes, 6] of random frames."""
    generator = torch.Generator().manual_seed(seed)
    return TensorDict(
        {
            "pixels": torch.randint(0, 256, (episodes, 6, 64, 128, 3), dtype=torch.uint8, generator=generator),
            **{name: torch.zeros(episodes, 6, 1) for name in ("state", "action", "expert_action")},
        },
        batch_size=[episodes, 6],
    )


@pytest.fixture
def model():
    model = tiny_controller.tiny(frame_spacing=2)
    model.code_low.fill_(torch.nan)
    return model


def test_the_ranges_are_the_extremes_of_the_embeddings_of_every_stack(model):
    splits = {"train": pixels(2, 0), "actor_train": pixels(1, 1), "test": pixels(2, 2)}
    trainer = SimpleNamespace(datamodule=SimpleNamespace(split=splits.__getitem__))
    module = SimpleNamespace(controller=lambda: model)
    FitCodec().finish(trainer, module)
    seen = []
    for split in (splits["train"], splits["actor_train"]):
        for frames in split["pixels"]:
            seen += [model.encode(torch.stack((frames[slot - 2], frames[slot]))) for slot in range(2, 6)]
    seen = torch.stack(seen)
    torch.testing.assert_close(model.code_low, seen.amin(0))
    torch.testing.assert_close(model.code_high, seen.amax(0))


def test_only_the_first_process_fits(model):
    FitCodec().on_fit_end(SimpleNamespace(is_global_zero=False), SimpleNamespace())
    assert model.code_low.isnan().all()
