"""Which scenes of a batch are done already."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from navbake.batch import remote
from navbake.batch.file_states import Places, are_unchanged, has_no_other, list_candidates
from navbake.batch.settings import settings_of
from navbake.batch.work import OK, Order, key_of
from navbake.errors import NavbakeError
from navbake.formats.scene_files import Folders
from navbake.types import Json


def find_done(orders: Sequence[Order], known: Mapping[str, Json]) -> set[str]:
    """The ids of scenes whose rows are of the same files, settings, products and version.

    Args:
        orders: of the batch's scenes.
        known: the rows of the index, by id.
    """
    on_stores: list[Order] = []
    here: list[Order] = []
    for order in orders:
        (on_stores if remote.is_remote(order) else here).append(order)
    done = remote.find_done(on_stores, known)
    if here:  # all have one output folder
        assert isinstance(here[0].folder, Path)
        places, listed = Places(here[0].folder), Folders(here[0].folder)
        for order in here:
            if _is_done(order, known.get(order.job.id), places, listed):
                done.add(order.job.id)
    return done


def _is_done(order: Order, row: Json | None, places: Places, listed: Folders) -> bool:
    if row is None or row.get("status") != OK:
        return False
    try:
        if not os.path.isfile(order.job.source):  # who reads a pipe may wait for ever
            return False
        config = settings_of(order.job, order.settings, order.overrides)
        assert isinstance(order.folder, Path)
        return bool(
            row["key"] == key_of(order, config)
            and row["named"] == [places.of_file(path) for path in config.inputs]
            and are_unchanged(row["inputs"], order.folder)
            and has_no_other(
                list_candidates(row["sought"], config.inputs[0], listed), row["inputs"], places
            )
            and are_unchanged(row["files"], order.place)
        )
    # or no row of a batch's
    except (NavbakeError, KeyError, TypeError, AttributeError, ValueError):
        return False
