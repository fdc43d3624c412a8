"""The Hugging Face Hub: models come from it and go to it as whole zoo entries, and only when somebody asks.

Needs the package huggingface_hub (``pip install 'tsjepa[hub]'``), which is imported when it is first used. What is
fetched are the five files of an entry; they are verified against the entry's manifest before anything is loaded.
"""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path
from types import ModuleType
from typing import TypeVar

ADDRESS_PREFIX = "hf://"
REPOSITORY = re.compile(r"[\w.-]+/[\w.-]+")

Model = TypeVar("Model", bound="HubModel")


def is_address(name: str | os.PathLike) -> bool:
    """Whether ``name`` asks for a download, as ``hf://owner/name`` does."""
    return str(name).startswith(ADDRESS_PREFIX)


def parse(address: str | os.PathLike) -> tuple[str, str | None]:
    """Repository and revision of ``hf://owner/name[@revision]``.

    Raises:
        ValueError: it has another form.
    """
    repository, _, revision = str(address).removeprefix(ADDRESS_PREFIX).partition("@")
    if not REPOSITORY.fullmatch(repository):
        raise ValueError(
            f"{str(address)!r} is no address on the Hub; write hf://owner/name or hf://owner/name@revision."
        )
    return repository, revision or None


def download(repo_id: str, revision: str | None = None, **options) -> Path:
    """Fetches an entry, or finds it in the cache.

    Args:
        repo_id: ``owner/name``.
        revision: branch, tag or, to pin it, commit hash.
        options: ``cache_dir``, ``local_files_only``, ``force_download`` and ``token`` of
            ``huggingface_hub.snapshot_download``.

    Returns:
        The folder, whose files nobody has verified yet.

    Raises:
        FileNotFoundError: the Hub has no such entry or cannot be reached.
    """
    from tsjepa.models.entries import FILES

    try:
        folder = _library().snapshot_download(repo_id, revision=revision, allow_patterns=list(FILES), **options)
    except (OSError, ValueError) as error:
        at = f" at revision {revision}" if revision else ""
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FileNotFoundError(f"{repo_id}{at} could not be fetched from the Hugging Face Hub: {reason}") from error
    return Path(folder)


def _library() -> ModuleType:
    try:
        import huggingface_hub
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "The Hugging Face Hub needs the package huggingface_hub: pip install 'tsjepa[hub]'."
        ) from error
    return huggingface_hub


class HubModel:
    """Gives a model of the zoo the three methods that models on the Hugging Face Hub usually have.

    ``metrics`` and ``card`` are those of the entry that the model was loaded from; they travel with it, so replace
    them where the weights have changed since.
    """

    metrics: dict | None = None
    card: str = ""

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
    ) -> Model:
        """Loads a model by name, from a folder, or from the Hub, as :func:`tsjepa.models.entries.load` does.

        Args:
            name_or_path: name of a shipped entry, a folder, or else ``owner/name`` on the Hub.
            revision: branch, tag or commit hash on the Hub.
            cache_dir: where downloads are kept; the library's own place by default.
            local_files_only: take what is in the cache and fetch nothing.
            force_download: fetch even what is in the cache.
            token: for a private repository.
            sha256: of the entry's manifest (:func:`tsjepa.models.entries.fingerprint`), to accept this entry only.

        Raises:
            FileNotFoundError: there is no such entry.
            tsjepa.models.entries.DamagedEntryError: a file is missing or has changed.
            ValueError: a revision of something that is not on the Hub.
            TypeError: the entry holds a model of another class.
        """
        from tsjepa.models import entries

        name = str(name_or_path)
        if name in entries.names() or Path(name).is_dir() or not (is_address(name) or REPOSITORY.fullmatch(name)):
            if revision is not None:
                raise ValueError(f"{name!r} is on this machine and has no revision {revision!r}; leave revision out.")
            folder = entries.find(name)
        else:
            repo_id, named = parse(name)
            options = {"cache_dir": cache_dir, "local_files_only": local_files_only}
            options |= {"force_download": force_download, "token": token}
            folder = download(repo_id, revision or named, **options)
        model = entries.load(folder, sha256)
        if not isinstance(model, cls):
            raise TypeError(f"{name!r} holds a {type(model).__name__}: load it with that class, or with tsjepa.load.")
        return model

    def save_pretrained(self, folder: str | os.PathLike, dtype: str = "float32") -> Path:
        """Writes the model as an entry, in place of ``folder``; ``dtype`` as in :func:`tsjepa.models.entries.save`."""
        from tsjepa.models import entries

        return entries.save(self, folder, self.metrics, self.card, dtype)

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
        interface = _library().HfApi(token=token)
        name = repo_id.rpartition("/")[2]
        with tempfile.TemporaryDirectory() as folder:
            entry = self.save_pretrained(Path(folder) / "entry", dtype)
            repo_id = interface.create_repo(repo_id, private=private, exist_ok=True).repo_id
            commit = interface.upload_folder(
                repo_id=repo_id,
                folder_path=entry,
                commit_message=commit_message or f"Upload {name}",
                revision=revision,
                create_pr=create_pr,
            )
        return commit.commit_url
