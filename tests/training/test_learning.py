"""A short fit learns: what is broken in loss, encoder, commands or step misses the thresholds below.

Measured with seed 0 in float32; the errors are over the standard deviation and over the actuator's range:

| fit               | skill at 10 slots | error of the probed speed | error of the command |
|-------------------|-------------------|---------------------------|----------------------|
| as it is          | .30               | .40                       | .030                 |
| untrained encoder | -.10              | .99                       | .132                 |
| frozen encoder    | -.11              | 1.02                      | .118                 |
| shuffled commands | -.15              | 1.00                      | .101                 |
| sign of the loss  | .02               | .44                       | .033                 |
"""

import lightning
import pytest
import tiny_data
import torch

from tsjepa.data.augmentation import Augmentation
from tsjepa.data.module import Trajectories
from tsjepa.models import Encoder, Predictor
from tsjepa.training.actor import SemanticActor
from tsjepa.training.callbacks import ExportModel
from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.centre import CentreEmbedding
from tsjepa.training.imitation_data import ImitationPairs
from tsjepa.training.jepa import TSJEPA
from tsjepa.training.monitor import linear_probe_rmse, prediction_skill

SPLITS = {"train": 24, "validation": 6, "test": 6, "actor_train": 12, "actor_test": 6}
UNSEEN = ("validation", "test", "actor_train", "actor_test")
STEPS, D = 300, 32
QUIET = {"logger": False, "enable_checkpointing": False, "enable_progress_bar": False, "enable_model_summary": False}
QUIET |= {"accelerator": "cpu", "limit_val_batches": 0}


@pytest.mark.slow
def test_a_short_fit_learns_to_see_to_predict_and_to_act(tmp_path):
    path = tiny_data.write(tmp_path / "data", slots=40, **SPLITS)
    lightning.seed_everything(0)
    module = TSJEPA(
        Encoder(2, (8, 16, 32), D, grey=True),
        Predictor(D, 128),
        Augmentation(),
        lambda parameters: torch.optim.AdamW(parameters, 2e-3, weight_decay=1e-2),
    )
    data = Trajectories(path, frames_per_batch=64, stacks=8, steps=[1, 1, 2])
    finishes = [CentreEmbedding(), ExportModel()]
    lightning.Trainer(max_steps=STEPS, default_root_dir=tmp_path, callbacks=finishes, **QUIET).fit(module, data)
    embedded = torch.cat([embed_split(module.encoder, data.split(name), 1) for name in UNSEEN])

    with torch.no_grad():
        skill = prediction_skill(module.predictor, embedded["embedding"], embedded["action"], (10,))[10]
    state = embedded["state"]
    speed = (linear_probe_rmse(embedded["embedding"], state) / state.flatten(0, 1).std(0))[2]

    actor, pairs = SemanticActor(str(tmp_path / "model"), (64, 32), 0.0, 3e-3), ImitationPairs(path, batch_size=128)
    trainer = lightning.Trainer(max_epochs=40, **QUIET)
    trainer.fit(actor, pairs)
    error = trainer.test(actor, pairs, verbose=False)[0]["test/command_nmae"]

    assert skill > 0.12
    assert speed < 0.7
    assert error < 0.06
