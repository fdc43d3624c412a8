"""What a killed fit needs to go on as if nothing had happened: whole checkpoints, and a log that is continued."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.loggers.csv_logs import ExperimentWriter
from lightning.pytorch.plugins.io import TorchCheckpointIO

from tsjepa.support.files import write_text
from tsjepa.support.trust import load_checkpoint


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes a checkpoint beside its place and renames it; reads tensors and plain values only.

    Lightning writes into the system's temporary folder and moves the file, which is a copy where that folder is on
    another file system; a kill during the copy leaves half a ``last.ckpt``.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".partial")
        try:
            with partial.open("wb") as file:
                torch.save(checkpoint, file)
                file.flush()
                os.fsync(file.fileno())
        except (OSError, RuntimeError) as error:
            # torch's writer reports a full disk as a RuntimeError
            partial.unlink(missing_ok=True)
            raise OSError(
                f"The checkpoint {path} could not be written ({_cause(error)}); the one before is whole: make room, "
                "then go on with --ckpt_path last."
            ) from error
        os.replace(partial, path)

    def load_checkpoint(
        self, path: str | Path, map_location: Any = "cpu", weights_only: bool | None = None
    ) -> dict[str, Any]:
        return load_checkpoint(str(path), map_location, trusted=weights_only is False)


def _cause(error: BaseException) -> str:
    while error.__context__ is not None and not isinstance(error, OSError):
        error = error.__context__
    return error.strerror if isinstance(error, OSError) and error.strerror else "the file system took no more"


class ContinuedWriter(ExperimentWriter):
    """Keeps the whole rows of an earlier process up to the step at which this one logs first."""

    def _check_log_dir_exists(self) -> None:
        """Lightning deletes the earlier log here."""

    def log_metrics(self, metrics_dict: dict[str, float], step: int | None = None) -> None:
        path = Path(self.metrics_file_path)
        if not self.metrics_keys and path.is_file():
            self.metrics_keys, rows = whole_rows(path)
            kept = [row for row in rows if int(row["step"]) < (step or 0)]
            if self.metrics_keys:
                lines = [self.metrics_keys, *([row[key] for key in self.metrics_keys] for row in kept)]
                write_text(path, "".join(",".join(line) + "\n" for line in lines))
            else:
                path.unlink()
        super().log_metrics(metrics_dict, step)


def whole_rows(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """The columns of a log and its rows, without those that a kill or a full disk has cut; no columns without a step.

    A line that was cut may have another one written on behind it.
    """
    lines = path.read_text().splitlines(keepends=True)
    reader = csv.DictReader(line for line in lines if line.endswith("\n"))
    columns = list(reader.fieldnames or ())
    if "step" not in columns:
        return [], []
    # the reader gives None to a column that is lacking, and puts what is too many under the name None
    rows = [row for row in reader if None not in row and None not in row.values() and row["step"].isdecimal()]
    return columns, rows


class FreshLog(Callback):
    """Removes an earlier fit's log from the folder of one that goes on from no checkpoint. Every ``tsjepa fit`` has it.

    Lightning has read by then the checkpoint that there is to go on from; ``--ckpt_path last`` may find none, which is
    said.

    Args:
        asked: the checkpoint that the command names, or None.
    """

    def __init__(self, asked: str | None = None) -> None:
        self.asked = asked

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        if trainer.is_global_zero and not trainer.ckpt_path:
            if self.asked is not None:
                print(
                    f"{trainer.default_root_dir} has no checkpoint to go on from, so the fit begins at its beginning."
                )
            for logger in trainer.loggers:
                if isinstance(logger, ContinuedCSVLogger):
                    Path(logger.experiment.metrics_file_path).unlink(missing_ok=True)


class ContinuedCSVLogger(CSVLogger):
    """A ``metrics.csv`` that a resumed fit continues; :class:`FreshLog` starts it anew in a fresh one."""

    @property
    def experiment(self) -> ExperimentWriter:
        if self._experiment is None:
            os.makedirs(self.root_dir, exist_ok=True)
            self._experiment = ContinuedWriter(self.log_dir)
        return self._experiment
