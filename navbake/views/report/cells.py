"""What a report says of each cell when one points at it."""

from collections.abc import MutableMapping

import numpy as np
import orjson

from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, islands_of
from navbake.navgrid.user_data import NAMES, Shared, UserData, collector_off, names_in
from navbake.types import Float, Int, Json
from navbake.views.report.packing import NONE, number_distinct, pack, to_steps, to_text

KINDS = (*NAMES, "blockers")  # keys of a cell's user data that list names
MILLIMETRE = 1e-3  # to which floors and clearances are rounded [m]
MOST_STEPS = 2**31  # that a page counts of heights
MAX_SHOWN = 4_000_000  # cells of a level that a page holds; of larger ones only every n-th


def thinning(level: SceneGrid2D) -> int:
    """Every which row and column of a level a page shows; 1 for all."""
    step = 1
    while -(-level.height // step) * -(-level.width // step) > MAX_SHOWN:
        step += 1
    return step


def describe_cells(grid: NavGrid, number: int) -> Json:
    """What is known of the cells of one level, packed by `packing.pack`.

    Returns:
        ``every``, see `thinning`; ``floor`` and ``clearance`` in steps of a millimetre from
        ``floorFrom`` and 0, floors that are far apart in larger ones, ``floorStep`` [m];
        ``room``, ``island``; ``weight`` and ``names`` as numbers into the
        lists ``weights`` (None for infinite) and ``nameLists``, which is JSON, compressed. An entry
        of it holds the names of what stands in a cell, and of what blocks it, by `KINDS`.
    """
    level = grid.levels[number]
    every = thinning(level)
    shown = np.s_[::every, ::every]
    floor_step = max(MILLIMETRE, _span(level.floor[shown]) / MOST_STEPS)
    floor, floor_from = to_steps(level.floor[shown], floor_step)
    free = level.free[shown]
    weight, weights = number_distinct(np.where(free, level.weights[shown], np.inf))
    away, _ = to_steps(clearance(level)[shown].astype(np.float64), MILLIMETRE, 0.0)
    names, name_lists = _number_names(level)
    return {
        "every": every,
        "floor": pack(floor, smooth=True),
        "floorFrom": floor_from,
        "floorStep": floor_step,
        "clearance": pack(np.where(free, away, 0), smooth=True),
        "room": pack(level.room_index[shown].astype(np.int64)),
        "island": pack(islands_of(grid)[number][shown].astype(np.int64)),
        "weight": pack(weight),
        "weights": [value if np.isfinite(value) else None for value in weights],
        "names": pack(names[shown]),
        "nameLists": to_text(orjson.dumps(name_lists)),
    }


def _span(values: Float) -> float:
    """From the least to the greatest finite value."""
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _number_names(level: SceneGrid2D) -> tuple[Int, list[Json]]:
    """Which entry of the list of names each cell has, -1 for none, shape (height, width)."""
    found: dict[bytes, int] = {}  # by an entry's JSON: most cells have the entry of others
    lists: list[Json] = []

    def number_of(entry: Json) -> int:
        key = orjson.dumps(entry, default=str)
        if key not in found:
            names = {kind: sorted(names_in(entry, kind)) for kind in KINDS}
            names = {kind: some for kind, some in names.items() if some}
            found[key] = len(lists) if names else NONE
            lists.extend([names] if names else [])
        return found[key]

    numbers = np.full(level.height * level.width, NONE, dtype=np.int64)
    source = UserData.of(level.user_data).source
    if isinstance(source, Shared):
        cells, number, entries = source
    else:
        with collector_off():
            table = source if isinstance(source, MutableMapping) else source.read()
        cells, entries = np.fromiter(table, np.int64, len(table)), list(table.values())
        number = np.arange(len(table))
    if len(cells):
        numbers[cells] = np.fromiter(map(number_of, entries), np.int64, len(entries))[number]
    return numbers.reshape(level.shape), lists
