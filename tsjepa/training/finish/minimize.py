"""The loop in which small parts learn from what a frozen encoder has made, when a fit ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager

from torch import Tensor, nn
from tqdm import trange

from tsjepa.training.schedule import adamw, warmup_cosine_schedule

# Makes the context of a forward pass, ``trainer.precision_plugin.forward_context``; losses are taken outside it.
ForwardContext = Callable[[], AbstractContextManager]
SHOW_EVERY = 50  # steps; to read a loss makes the host wait for the device


def minimize(
    loss: Callable[[], Tensor],
    parameters: Iterable[nn.Parameter],
    steps: int,
    learning_rate: float,
    weight_decay: float,
    what: str,
) -> None:
    """Takes AdamW's steps, with warm-up and cosine decay.

    Args:
        loss: draws a batch and gives its loss, a scalar; called once a step.
        parameters: that change.
        steps: optimizer steps.
        learning_rate: the schedule's peak.
        weight_decay: of AdamW.
        what: said beside the progress bar.
    """
    parameters = [parameter.requires_grad_() for parameter in parameters]  # the fit may have left them out
    optimizer = adamw(parameters, learning_rate, weight_decay)
    schedule = warmup_cosine_schedule(optimizer, steps)
    progress = trange(steps, desc=what, unit="step")
    for step in progress:
        value = loss()
        optimizer.zero_grad()
        value.backward()
        optimizer.step()
        schedule.step()
        if (step + 1) % SHOW_EVERY == 0 or step + 1 == steps:
            progress.set_postfix(loss=f"{value.item():.5f}", refresh=False)
