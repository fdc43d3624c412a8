"""What every controller of the zoo has: an encoder for the device, a command for an embedding, and a way to disk."""

from __future__ import annotations

import math
import os
import tempfile
from pathlib import Path
from typing import ClassVar, TypeVar

import torch
from torch import Tensor, nn

from tsjepa.models import entries, hub
from tsjepa.models.checks import check_sizes_of
from tsjepa.support.spec import PlantSpec

Model = TypeVar("Model", bound="Controller")
NO_ACTOR = (
    "This model has no actor yet, so that it commands nothing: fit one with `tsjepa fit --config recipes/actor.yaml "
    "--model.init_args.pretrained FOLDER`, and take the model that this leaves."
)


class Controller(nn.Module):
    """An encoder that runs on the device, and what turns its embeddings into commands elsewhere.

    ``metrics``, ``card`` and ``entry_sha256`` are those of the entry that it was loaded from; ``plant`` has the class
    path and the arguments of the plant that it was trained on, None for a recording. They travel with it, so replace
    them where the weights have changed since.

    Args:
        encoder: frames uint8 [..., frame_stack, H, W, 3], oldest first, to embeddings [..., d]; it has
            ``frame_shape`` (frame_stack, H, W, 3) and ``embedding_dim``.
        frame_spacing: slots between the frames of a stack.
        spec: names, units and ranges of the plant.

    ``code_low`` and ``code_high`` [d] are the ranges over which an integer codec sends an embedding; NaN until they
    are fitted.
    """

    metrics: dict | None = None
    card: str = ""
    entry_sha256: str | None = None
    plant: dict | None = None
    optional: ClassVar[tuple[str, ...]] = ("code_",)
    """Beginnings of tensors that an entry may lack, all or none of them; what needs them says so when it is used."""

    def __init__(self, encoder: nn.Module, frame_spacing: int, spec: PlantSpec) -> None:
        super().__init__()
        check_sizes_of(encoder)
        self.encoder, self.frame_spacing, self.spec = encoder, frame_spacing, spec
        self.register_buffer("code_low", torch.full((encoder.embedding_dim,), math.nan))
        self.register_buffer("code_high", torch.full((encoder.embedding_dim,), math.nan))

    @property
    def kind(self) -> str:
        """What it is, in one word; subclasses say."""
        raise NotImplementedError

    @property
    def frame_stack(self) -> int:
        """Frames of an embedding (kappa)."""
        return self.encoder.frame_shape[0]

    @property
    def frame_history(self) -> int:
        """Slots that one stack spans."""
        return (self.frame_stack - 1) * self.frame_spacing + 1

    @property
    def embedding_dim(self) -> int:
        """d."""
        return self.encoder.embedding_dim

    @property
    def has_predictor(self) -> bool:
        """Whether it predicts between updates; one that does not holds its last command."""
        return False

    @property
    def has_observer(self) -> bool:
        """Whether its devices send what they believe, by all that they have seen or by their last command."""
        return False

    @property
    def acts(self) -> bool:
        """Whether it has what makes commands of embeddings; a TS-JEPA has no actor before one is fitted to it."""
        return True

    def check_acts(self) -> None:
        """Refuses a model that makes no commands.

        Raises:
            ValueError: it has no actor.
        """
        if not self.acts:
            raise ValueError(NO_ACTOR)

    def encode(self, frames: Tensor) -> Tensor:
        """uint8 [..., frame_stack, H, W, 3], oldest first, to embeddings [..., d]."""
        return self.encoder(frames)

    @classmethod
    def from_pretrained(
        cls: type[Model],
        name_or_path: str | os.PathLike,
        *,
        revision: str | None = None,
        cache_dir: str | os.PathLike | None = None,
        local_files_only: bool = False,
        force_download: bool = False,
        token: str | bool | None = None,
        sha256: str | None = None,
        trusted: bool = False,
    ) -> Model:
        """Loads a model by name, from a folder, or from the Hub, as :func:`tsjepa.load` does.

        Args:
            name_or_path: name of a shipped entry, a folder, or else ``owner/name`` on the Hub.
            revision: branch, tag or commit hash on the Hub.
            cache_dir: where downloads are kept; the library's own place by default.
            local_files_only: take what is in the cache and fetch nothing.
            force_download: fetch even what is in the cache.
            token: for a private repository.
            sha256: of the entry's manifest, to accept this entry only.
            trusted: import classes that are not this package's own.

        Raises:
            FileNotFoundError: there is no such entry.
            tsjepa.models.entries.DamagedEntryError: a file is missing or has changed.
            ValueError: a revision of something that is not on the Hub.
            TypeError: the entry holds a model of another class.
        """
        name = str(name_or_path)
        here = name in entries.names() or Path(name).is_dir()
        if here or not (hub.is_address(name) or hub.REPOSITORY.fullmatch(name)):
            if revision is not None:
                raise ValueError(f"{name!r} is on this machine and has no revision {revision!r}; leave revision out.")
            folder = entries.find(name)
        else:
            repo_id, named = hub.parse(name)
            options = {"cache_dir": cache_dir, "local_files_only": local_files_only}
            options |= {"force_download": force_download, "token": token}
            folder = hub.download(repo_id, entries.FILES, revision or named, **options)
        model = entries.load(folder, sha256, trusted)
        if not isinstance(model, cls):
            raise TypeError(f"{name!r} holds a {type(model).__name__}: load it with that class, or with tsjepa.load.")
        return model

    def save_pretrained(self, folder: str | os.PathLike, dtype: str = "float32") -> Path:
        """Writes the model as an entry, in place of ``folder``; ``dtype`` as in :func:`tsjepa.models.entries.save`."""
        return entries.save(self, Path(folder), self.metrics, self.card, dtype)

    def push_to_hub(
        self,
        repo_id: str,
        *,
        commit_message: str | None = None,
        revision: str | None = None,
        private: bool | None = None,
        token: str | bool | None = None,
        create_pr: bool = False,
        dtype: str = "float32",
    ) -> str:
        """Uploads the model as an entry, in one commit; makes the repository where there is none.

        Args:
            repo_id: ``owner/name``.
            commit_message: "Upload NAME" by default.
            revision: branch to commit to.
            private: whether a new repository is.
            token: that may write; the one of ``hf auth login`` by default.
            create_pr: propose the commit instead of making it.
            dtype: of the weights, see :func:`tsjepa.models.entries.save`.

        Returns:
            The address of the commit.
        """
        options = {"revision": revision, "create_pr": create_pr}
        with tempfile.TemporaryDirectory() as folder:
            entry = self.save_pretrained(Path(folder) / "entry", dtype)
            return hub.upload(entry, repo_id, commit_message, private, token, **options)
