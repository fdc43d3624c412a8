"""Files that stay open between reads: a few, however many episodes a recording has."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

MOST = 32  # files; a process may often have no more than 256 or 1024 open, and a recording may have one an episode


class KeptOpen:
    """The newest :data:`MOST` files that a recording has opened; another is opened again when it is read."""

    def __init__(self) -> None:
        self._files: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, open_: Callable[[], Any]) -> Any:
        """The open file of ``key``; ``open_()`` gives one that has a ``close``. Good until the next call."""
        if key not in self._files:
            while len(self._files) >= MOST:
                self._files.popitem(last=False)[1].close()
            self._files[key] = open_()
        self._files.move_to_end(key)
        return self._files[key]
