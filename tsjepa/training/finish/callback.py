"""The callback from which everything that is fitted on a frozen encoder inherits."""

from __future__ import annotations

import lightning


class Finish(lightning.Callback):
    """Runs :meth:`finish` when the fit ends, in the first process and on the trainer's device.

    Recipes list the finishes in the order in which they run, before the export. Lightning has moved the module to the
    CPU by then, so this moves it back; the first one pays, and ``teardown`` leaves it on the CPU as Lightning does.
    """

    def finish(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        """Changes parts of the module, or of its controller, in place."""
        raise NotImplementedError

    def on_fit_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.is_global_zero:
            module.to(trainer.strategy.root_device)
            module.controller().to(trainer.strategy.root_device)
            self.finish(trainer, module)

    def teardown(self, trainer: lightning.Trainer, module: lightning.LightningModule, stage: str) -> None:
        module.cpu()
        module.controller().cpu()
