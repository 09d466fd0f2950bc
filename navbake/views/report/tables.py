"""Tables of a report."""

from collections.abc import Iterator, Sequence
from typing import Any

from navbake.types import Json

MAX_ROWS = 2000  # of a table; the page says how many more there are


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]], numbers: Sequence[int] = ()
) -> Json:
    """A table of a page; `numbers` are the columns that hold some, which stand to the right.

    A column that is empty in all rows is left out.
    """
    kept = [i for i in range(len(columns)) if any(row[i] not in ("", None) for row in rows)]
    shown = rows[:MAX_ROWS]
    return {
        "title": title,
        "columns": [columns[i] for i in kept],
        "rows": [["" if row[i] is None else row[i] for i in kept] for row in shown],
        "numbers": [place for place, i in enumerate(kept) if i in numbers],
        "more": len(rows) - len(shown),
    }


def flatten(value: Any, path: str = "") -> list[tuple[str, str]]:
    """The values in nested objects, each with its path; lists of objects count from 0."""

    def walk(part: Any, path: str) -> Iterator[tuple[str, str]]:
        if isinstance(part, list) and any(isinstance(inner, dict) for inner in part):
            part = dict(enumerate(part))
        if isinstance(part, dict):
            for key, inner in part.items():
                yield from walk(inner, f"{path}.{key}" if path else str(key))
        elif part is not None:
            yield path, str(part)

    return list(walk(value, path))
