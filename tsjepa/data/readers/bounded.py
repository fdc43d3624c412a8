"""Files for libraries that ask for as many bytes as a damaged record claims."""

from __future__ import annotations

import io
import os
from pathlib import Path


class BoundedPath(type(Path())):
    """A path whose file never gives, and so never takes memory for, more than is left of it.

    The reader of .mcap asks for as many bytes as a damaged record claims.
    """

    def open(self, mode: str = "r", *arguments, **options):
        """As that of a path; binary files are bounded."""
        return BoundedFile(io.FileIO(self)) if mode == "rb" else super().open(mode, *arguments, **options)


class BoundedFile(io.BufferedReader):
    """A file that is read to its end at most, whatever size is asked for."""

    def read(self, size: int | None = -1) -> bytes:
        """As that of a file, and without memory for bytes that are not there."""
        if size is not None and size > io.DEFAULT_BUFFER_SIZE:
            size = min(size, max(0, os.fstat(self.fileno()).st_size - self.tell()))
        return super().read(size)
