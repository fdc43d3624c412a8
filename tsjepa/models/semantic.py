"""Everything that runs in the loop, in one module: what the zoo ships and what the evaluation drives."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor, nn

from tsjepa.models.controller import NO_ACTOR, Controller
from tsjepa.support.spec import PlantSpec


class SemanticController(Controller):
    """Context encoder (on the device), predictor and semantic actor (at the controller).

    Two more parts look inside and control nothing: ``probe`` reads the state from an embedding, ``decoder`` draws it.

    Args:
        encoder: see :class:`Controller`.
        actor: from an embedding [..., d] and set-points [..., r] to a command [..., m]; None before one is fitted.
        frame_spacing: slots between the frames of a stack.
        spec: names, units and ranges of the plant.
        predictor: from an embedding and a command to the next embedding; None for a controller that holds its last
            command between updates (the supervised baseline).
        probe: from an embedding to the state; None where the data have no states.
        decoder: from an embedding to frames; None for none.
        observer: on the device, from what was predicted, an embedding and the last command to what it sends; None sends
            the embedding.
    """

    optional: ClassVar[tuple[str, ...]] = ("decoder.", "code_")

    def __init__(
        self,
        encoder: nn.Module,
        actor: nn.Module | None,
        frame_spacing: int,
        spec: PlantSpec,
        predictor: nn.Module | None = None,
        probe: nn.Module | None = None,
        decoder: nn.Module | None = None,
        observer: nn.Module | None = None,
    ) -> None:
        super().__init__(encoder, frame_spacing, spec)
        self.predictor, self.actor, self.probe, self.decoder = predictor, actor, probe, decoder
        self.observer = observer

    @property
    def kind(self) -> str:
        """ "tsjepa", or "supervised" for a controller without a predictor."""
        return "tsjepa" if self.has_predictor else "supervised"

    @property
    def has_predictor(self) -> bool:
        """Whether it predicts between updates."""
        return self.predictor is not None

    @property
    def has_observer(self) -> bool:
        """Whether its devices send what they believe, by all that they have seen or by their last command."""
        return self.observer is not None

    @property
    def acts(self) -> bool:
        """Whether it has an actor."""
        return self.actor is not None

    def predict(self, embedding: Tensor, command: Tensor) -> Tensor:
        """Embedding [..., d] one slot later under ``command`` [..., m].

        Raises:
            ValueError: this controller has no predictor.
        """
        if self.predictor is None:
            raise ValueError("This controller has no predictor (has_predictor is False); hold the last command.")
        return self.predictor(embedding, command)

    def correct(self, belief: Tensor, command: Tensor, embedding: Tensor) -> Tensor:
        """What the device believes [..., d] of this slot.

        Args:
            belief: [..., d], of the slot before.
            command: [..., m], applied since.
            embedding: [..., d], of this slot's frames.

        Raises:
            ValueError: this controller has no observer.
        """
        if self.observer is None:
            raise ValueError("This controller has no observer: send its embeddings as they are, or fit one to it.")
        return self.observer(self.predict(belief, command), embedding, command)

    def belief_after(self, embeddings: Tensor, commands: Tensor) -> Tensor:
        """What a device believes [..., d] after a row of slots; the first embedding is taken as it is.

        Args:
            embeddings: [..., W + 1, d], those that were seen.
            commands: [..., W, m], the command applied between two of them.

        Raises:
            ValueError: this controller has no observer.
        """
        belief = embeddings[..., 0, :]
        for slot in range(commands.shape[-2]):
            belief = self.correct(belief, commands[..., slot, :], embeddings[..., slot + 1, :])
        return belief

    def act(self, embedding: Tensor, reference: Tensor | None = None) -> Tensor:
        """Command [..., m] for ``embedding`` [..., d] and set-points [..., r].

        Raises:
            ValueError: this controller has no actor.
        """
        if self.actor is None:
            raise ValueError(NO_ACTOR)
        return self.actor(embedding, reference)

    def decode(self, embedding: Tensor) -> Tensor:
        """Newest frame of an embedding [..., d] as the decoder draws it: float [..., H, W, 3] in 0..255.

        Raises:
            ValueError: there is no decoder, or it was never trained.
        """
        if self.decoder is None:
            raise ValueError("This controller has no decoder, so that its embeddings cannot be drawn.")
        return self.decoder(embedding)[..., -1, :, :, :]
