"""What became of each scene of a batch: a line of JSON each, written as it goes."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

from navbake.files import write_whole
from navbake.types import Json

NAME = "index.jsonl"


def read_index(folder: Path) -> dict[str, Json]:
    """The last line of each scene, by its id; {} where there is no index.

    A line that was cut off, as when the machine lost power, counts as none.
    """
    rows: dict[str, Json] = {}
    try:
        lines = (folder / NAME).read_bytes().split(b"\n")
    except FileNotFoundError:
        return rows
    for line in lines:
        try:
            row = json.loads(line)
        except ValueError:
            continue
        if isinstance(row, dict) and isinstance(row.get("id"), str):
            rows[row["id"]] = row
    return rows


class Index:
    """The index of a folder, to which one process adds lines."""

    def __init__(self, folder: Path) -> None:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
        path = folder / NAME
        self._path = path
        self._file = os.open(path, flags, 0o666)
        self._mend()

    def _mend(self) -> None:
        """End a line that was cut off, so that the next one is a line of its own."""
        content = self._path.read_bytes()
        if content and not content.endswith(b"\n"):
            os.write(self._file, b"\n")

    def add(self, row: Json) -> None:
        """Add a scene's line, in one write: a reader sees all of it or nothing."""
        line = json.dumps(row, sort_keys=True, separators=(",", ":"), allow_nan=False)
        os.write(self._file, line.encode() + b"\n")

    def finish(self, rows: Iterable[Json]) -> None:
        """Replace all lines by one for each scene, in the batch's order."""
        os.close(self._file)
        lines = [
            json.dumps(r, sort_keys=True, separators=(",", ":"), allow_nan=False) for r in rows
        ]
        write_whole(("\n".join(lines) + "\n").encode(), self._path)

    def close(self) -> None:
        """Leave the lines as they are."""
        os.close(self._file)
