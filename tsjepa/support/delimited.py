"""Text of others as they write it: compressed, with a mark of its coding, with commas, semicolons, tabs or comments."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator
from pathlib import Path

MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
MOST_TEXT = 2 << 30  # bytes, unpacked
NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*", re.IGNORECASE)
THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+(\.\d+)?")
COMMA_NUMBER = re.compile(r"\s*[-+]?\d+(,\d+)?(e[-+]?\d+)?\s*", re.IGNORECASE)


def kind(path: Path) -> str:
    """The file's suffix in small letters, that below .gz included: ".csv" of ``run.CSV.gz``."""
    return Path(path.stem if path.suffix.lower() == ".gz" else path.name).suffix.lower()


def stem(path: Path) -> str:
    """The file's name without suffixes: "run" of ``run.csv.gz``."""
    return Path(path.stem).stem if path.suffix.lower() == ".gz" else path.stem


def read_text(path: Path) -> str:
    """The whole text, unpacked, without a byte-order mark.

    Raises:
        ValueError: it is packed and damaged, or unpacks to more than a table ever holds.
    """
    data = path.read_bytes()
    if path.suffix.lower() == ".gz" or data[:2] == b"\x1f\x8b":
        try:
            with gzip.open(io.BytesIO(data)) as file:
                data = file.read(MOST_TEXT + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise ValueError(f"{path.name} cannot be unpacked ({error}).") from error
    if len(data) > MOST_TEXT:
        raise ValueError(f"{path.name} holds more than {MOST_TEXT >> 30} GiB of text; cut it into smaller files.")
    coding = next((coding for mark, coding in MARKS if data.startswith(mark)), "utf-8")
    return data.decode(coding, errors="replace")


def without_comments(lines: list[str]) -> list[str]:
    """The lines from the header on, blank ones left out.

    A last comment before the rows that has as many cells as they is the header.
    """
    lines = [line for line in lines if line.strip()]
    start = next((place for place, line in enumerate(lines) if not line.lstrip().startswith("#")), len(lines))
    if 0 < start < len(lines):
        header, first = lines[start - 1].lstrip("# \t"), lines[start]
        mark = delimiter_of(first)
        cells = first.split(mark) if mark in first else first.split()
        names = header.split(mark) if mark in header else header.split()
        if 1 < len(names) == len(cells) and any(NUMBER.fullmatch(cell) for cell in cells):
            return [header, *lines[start:]]
    return lines[start:]


def split_rows(text: str) -> tuple[str, list[tuple[int, list[str]]]]:
    """What separates the cells, and of every row that is not empty its first line, from 1, and its cells.

    The header comes first; comments before it are left out.

    Raises:
        ValueError: a cell in quotes goes on for more than 128 KiB; the sentence names the line where it begins.
    """
    lines = text.splitlines()
    places = [place for place, line in enumerate(lines, 1) if line.strip()]
    lines = without_comments(lines)
    places = places[len(places) - len(lines) :]
    mark = delimiter_of(lines[0]) if lines else ","
    rows = csv.reader(lines, delimiter=mark)
    found = []
    start = 0
    try:
        for row in rows:
            if any(cell.strip() for cell in row):
                found.append((places[start], row))
            start = rows.line_num  # a cell in quotes may go over several lines
    except csv.Error as error:
        raise ValueError(
            f"the row that begins in line {places[start]} cannot be read ({error}): is a quote open?"
        ) from error
    return mark, found


def delimiter_of(line: str) -> str:
    """What separates the cells of a header: the most frequent of comma, semicolon and tab."""
    return max(",;\t", key=line.count)


def decimal_points(cells: list[str | None], mark: str) -> list[str | None]:
    """The cells with decimal points where all of them are whole numbers or have a comma.

    Between cells that commas separate, a comma in quotes is one of thousands wherever it can be.

    Args:
        cells: of one column.
        mark: what separates the cells of a row.
    """
    commas = [cell.strip() for cell in cells if cell and "," in cell]
    if not commas:
        return cells
    words = [cell for cell in cells if cell]
    if mark == "," and all(THOUSANDS.fullmatch(word) for word in commas):
        return [cell.replace(",", "") if cell else cell for cell in cells]
    if all(COMMA_NUMBER.fullmatch(word) for word in words):
        return [cell.replace(",", ".") if cell else cell for cell in cells]
    return cells


def as_columns(rows: list[dict]) -> dict[str, list]:
    """Cells by name, in the order in which names first appear; objects within objects as ``outer.inner``."""
    flattened = [dict(flat(row)) for row in rows]
    names = dict.fromkeys(name for row in flattened for name in row)
    return {name: [row.get(name) for row in flattened] for name in names}


def flat(row: dict, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Names and values of an object, those within it as ``outer.inner``."""
    for key, value in row.items():
        if isinstance(value, dict) and value:
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value
