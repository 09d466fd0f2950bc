"""Makes the user data of a grid: the names of the objects, walls and blockers in each cell."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.union_find import number_distinct_lists
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.navgrid.lattice import Lattice
from navbake.types import Int

CellNames = dict[str, list[str]]
"""The user data of a cell: sorted names by key."""

# Bits of a geom in a cell, and the keys of user data for them
OBJECTS = 1
WALLS = 2
BLOCKERS = 4
USER_DATA_KEYS = {"objects": OBJECTS, "walls": WALLS}
OBJECTS_OR_WALLS = OBJECTS | WALLS
NUM_BITS_VALUES = 8  # all sums of these bits are below this


def name_geoms(scene: Scene) -> list[str]:
    """Return for each geom the name of its topmost body; on the world body, the geom's own name.

    A body or geom without a name is called ``body 3`` or ``geom 12``, after its id.
    """
    model = scene.model
    roots = model.body_rootid[model.geom_bodyid]
    bodies = {int(root): body_name(model, int(root)) for root in np.unique(roots)}
    return [
        bodies[int(root)] if root else report.name
        for root, report in zip(roots, scene.geoms, strict=True)
    ]


def name_cells(
    cell: Int,
    geom: NDArray[np.integer],
    bits: Int,
    names: Sequence[str],
    lattice: Lattice,
    window: Window,
) -> tuple[Int, Int, list[CellNames]]:
    """Make the table of names for the cells of a grid.

    Args:
        cell: cell ids on the lattice, shape (n,).
        geom: the id of a geom in each of these cells, shape (n,). A cell with several geoms occurs
            several times.
        bits: the bits OBJECTS, WALLS and BLOCKERS of each pair of cell and geom, shape (n,); a pair
            with 0 is dropped.
        names: by geom id, see `name_geoms`.
        lattice: the whole lattice.
        window: the rows and columns of the lattice that the grid holds.

    Returns:
        The fields of `navbake.navgrid.user_data.Shared`: the ids on the window of the cells with
        names, ascending; for each of them, the index of its entry; and the entries, which hold
        sorted names by key. An entry has ``blockers`` only where these are not the same names as
        its objects and walls together.
    """
    # names are numbered by their first geoms, so that they keep the order of the scene's geoms
    numbers: dict[str, int] = {}
    name_of_geom = np.array([numbers.setdefault(name, k) for k, name in enumerate(names)], np.int64)
    cell, name, bits = _merge(cell, name_of_geom[geom], bits, len(names))
    token = name * NUM_BITS_VALUES + bits
    if window != (slice(0, lattice.height), slice(0, lattice.width)):
        cell, is_inside = crop_cells(cell, window, lattice.width)
        token = token[is_inside]
    # cells with equal lists of tokens share an entry
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    start = np.append(first, len(cell))
    entry_of_cell = np.empty(len(first), dtype=np.int64)
    lists = number_distinct_lists(start, token, entry_of_cell)
    entries = _describe(token, start[lists], start[lists + 1], names)
    return cell[first], entry_of_cell, entries


def _merge(cell: Int, name: Int, bits: Int, num_names: int) -> tuple[Int, Int, Int]:
    """Merge the entries with the same cell and name; entries without a bit are dropped.

    Args:
        cell: the cell of each entry, (n,).
        name: the number of the name of a geom in the cell, (n,).
        bits: the bits of the geom in the cell, (n,).
        num_names: the number of names; all of `name` are below it.

    Returns:
        Cells and names of the unique pairs, sorted by cell and then name; and the bits that any
        entry of the pair has.
    """
    counts = bits > 0
    cell = cell[counts]
    name = name[counts]
    bits = bits[counts]
    pair = cell * num_names + name
    if (np.diff(pair) < 0).any():
        order = np.argsort(pair, kind="stable")
        pair = pair[order]
        cell = cell[order]
        name = name[order]
        bits = bits[order]
    first = np.flatnonzero(np.diff(pair, prepend=-1))
    merged_bits = np.bitwise_or.reduceat(bits, first) if len(first) else bits
    return cell[first], name[first], merged_bits


def _describe(token: Int, begin: Int, end: Int, names: Sequence[str]) -> list[CellNames]:
    """Make the user data of each distinct list of tokens, which several cells may share.

    A token is ``number of a name * NUM_BITS_VALUES + bits``.

    Args:
        token: tokens of all cells, one cell after the other.
        begin: for each list, the index of its first token.
        end: for each list, the index after its last token.
        names: the names, by number.

    Returns:
        For each list, its sorted names by key.
    """
    size = end - begin
    num_entries = len(size)
    entry = np.repeat(np.arange(num_entries), size)
    token = token[np.arange(len(entry)) + (begin - np.cumsum(size) + size)[entry]]
    name, bits = np.divmod(token, NUM_BITS_VALUES)
    order = np.lexsort((_ranks(names)[name], entry))
    name = name[order]
    bits = bits[order]
    differs = ((bits & BLOCKERS) > 0) != ((bits & OBJECTS_OR_WALLS) > 0)
    has_blockers = np.bincount(entry, differs, num_entries) > 0
    is_under_key = {key: (bits & bit) > 0 for key, bit in USER_DATA_KEYS.items()}
    is_under_key["blockers"] = ((bits & BLOCKERS) > 0) & has_blockers[entry]
    user_data: list[CellNames] = [{} for _ in range(num_entries)]
    for key, is_listed in is_under_key.items():
        key_names = [names[k] for k in name[is_listed].tolist()]
        entries, first = np.unique(entry[is_listed], return_index=True)
        end_of_entry = np.append(first[1:], len(key_names))[: len(first)]
        ranges = np.stack([entries, first, end_of_entry], axis=1).tolist()
        for number, first_name, end_name in ranges:
            user_data[number][key] = key_names[first_name:end_name]
    return user_data


def _ranks(names: Sequence[str]) -> Int:
    """Return for each name its place in the sorted list of all names."""
    ranks = np.empty(len(names), dtype=np.int64)
    ranks[sorted(range(len(names)), key=names.__getitem__)] = np.arange(len(names))
    return ranks
