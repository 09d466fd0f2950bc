"""Notes of what was made of a scene, on stores; see `products.remove_products`."""

from __future__ import annotations

from collections.abc import Iterable

from navbake.batch.products import MAX_NOTE, NOTE, encode_note, parse_note
from navbake.batch.stores.store import read_if_there, write_file


def read_note_at(place: str) -> set[str]:
    """The names of what was made of a scene besides its grid; `place` is its folder's URL."""
    return parse_note(read_if_there(f"{place}/{NOTE}", MAX_NOTE) or b"")


def write_note_at(place: str, names: Iterable[str]) -> None:
    """Note the names of what is made of a scene besides its grid."""
    write_file(f"{place}/{NOTE}", encode_note(names))
