"""Starts a fit from weights of the zoo: ``pretrained: NAME`` in a recipe."""

from __future__ import annotations

from torch import nn

from tsjepa.models import entries


def start_from(name: str, **parts: nn.Module) -> None:
    """Copies an entry's weights into ``parts``, every tensor whose name and shape agree; the others keep their draw.

    So an encoder of another embedding dimension starts from the entry's convolutions, with a new projection, and a
    predictor from its own draw where the entry has none.

    Args:
        name: of a zoo entry, or the folder of one.
        parts: modules by the name that the entry's controller gives them: encoder, predictor, actor.

    Raises:
        ValueError: nothing of a part agrees, so that it would start from nothing.
    """
    controller = entries.load(name)
    for part, module in parts.items():
        source = getattr(controller, part, None)
        if source is None:
            continue
        own, given = module.state_dict(), source.state_dict()
        fitting = {key: value for key, value in given.items() if key in own and own[key].shape == value.shape}
        if not any(value.ndim > 1 for value in fitting.values()) and part == "encoder":
            raise ValueError(
                f"No weights of the {part} of {name!r} fit this one's sizes: give it the widths and the frame_stack of "
                f"{name!r}, which its config.yaml names, or leave out `pretrained`."
            )
        module.load_state_dict(own | fitting)
