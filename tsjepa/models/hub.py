"""The Hugging Face Hub: models come from it and go to it as whole zoo entries, and only when somebody asks.

Needs the package huggingface_hub (``pip install 'tsjepa[hub]'``), which is imported when it is first used. What is
fetched are the files of an entry; they are verified against the entry's manifest before anything is loaded.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

ADDRESS_PREFIX = "hf://"
REPOSITORY = re.compile(r"[\w.-]+/[\w.-]+")


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


def download(repo_id: str, files: Sequence[str], revision: str | None = None, **options) -> Path:
    """Fetches an entry, or finds it in the cache.

    Args:
        repo_id: ``owner/name``.
        files: names of the files that are fetched.
        revision: branch, tag or, to pin it, commit hash.
        options: ``cache_dir``, ``local_files_only``, ``force_download`` and ``token`` of
            ``huggingface_hub.snapshot_download``.

    Returns:
        The folder, whose files nobody has verified yet.

    Raises:
        FileNotFoundError: the Hub has no such entry or cannot be reached.
    """
    try:
        folder = _library().snapshot_download(repo_id, revision=revision, allow_patterns=list(files), **options)
    except (OSError, ValueError) as error:
        at = f" at revision {revision}" if revision else ""
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FileNotFoundError(f"{repo_id}{at} could not be fetched from the Hugging Face Hub: {reason}") from error
    return Path(folder)


def upload(
    entry: Path, repo_id: str, commit_message: str | None, private: bool | None, token: str | bool | None, **options
) -> str:
    """Uploads the folder of an entry in one commit and returns its address; makes the repository where there is none.

    Args:
        entry: folder.
        repo_id: ``owner/name``.
        commit_message: "Upload NAME" where it is None.
        private: whether a new repository is.
        token: that may write.
        options: ``revision`` and ``create_pr`` of ``huggingface_hub.HfApi.upload_folder``.
    """
    interface = _library().HfApi(token=token)
    message = commit_message or f"Upload {repo_id.rpartition('/')[2]}"
    repo_id = interface.create_repo(repo_id, private=private, exist_ok=True).repo_id
    return interface.upload_folder(repo_id=repo_id, folder_path=entry, commit_message=message, **options).commit_url


def _library() -> ModuleType:
    try:
        import huggingface_hub
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "The Hugging Face Hub needs the package huggingface_hub: pip install 'tsjepa[hub]'."
        ) from error
    return huggingface_hub
