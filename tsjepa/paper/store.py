"""Recorded results: ``<figure>.json``, one line a point of the sweep, and the same rows as a tidy ``<figure>.csv``."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

from tsjepa.support.files import json_text, read_json, write_text

DIGITS = 6


def read(folder: str | Path, figure: str) -> list[dict]:
    """The records of a figure, none where nothing was recorded.

    A record has ``point``, ``rows``, ``seconds`` (that it took), ``made_by`` (command, commit, date, and where its rows
    were computed anew from what was recorded, ``restated``: how), ``weights``
    (of every model of the zoo and every recipe that it used, the first digits of the hash) and ``code`` (the first
    digits of the hash of the package's source).
    """
    path = Path(folder) / f"{figure}.json"
    return read_json(path)["records"] if path.is_file() else []


def write(folder: str | Path, figure: str, records: list[dict]) -> None:
    """Replaces both files; a reader finds the old ones or the new."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{figure}.json"
    lines = ",\n".join(json_text(path, record) for record in records)
    write_text(path, f'{{"figure": "{figure}", "records": [\n{lines}\n]}}\n')
    write_text(folder / f"{figure}.csv", tidy(records))


def tidy(records: list[dict]) -> str:
    """One line a row, the point's values in front and its origin behind; curves stay in the JSON file alone."""
    rows = [
        {name: value for name, value in row.items() if not isinstance(value, list)} | record["made_by"]
        for record in records
        for row in flat([record])
    ]
    columns = dict.fromkeys(name for row in rows for name in row)
    origin = [name for name in ("commit", "date", "command") if name in columns]
    text = io.StringIO()
    writer = csv.DictWriter(text, [*(name for name in columns if name not in origin), *origin], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def flat(records: list[dict]) -> list[dict]:
    """All rows, each with the values of its point."""
    return [record["point"] | row for record in records for row in record["rows"]]


def key(point: dict) -> str:
    """The same string for the same point."""
    return json.dumps(point, sort_keys=True)


def rounded(value):
    """Numbers to six significant digits, in lists and dicts too."""
    if isinstance(value, dict):
        return {name: rounded(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
