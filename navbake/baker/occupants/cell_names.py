"""User data: what stands in each cell, by name."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.union_find import number_distinct_lists
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.navgrid.lattice import Lattice
from navbake.types import Int

Names = dict[str, list[str]]

# Bits: how a geom is in a cell, and the keys of user data for them
OBJECTS = 1
WALLS = 2
BLOCKERS = 4
KEYS = {"objects": OBJECTS, "walls": WALLS}
NAMED = OBJECTS | WALLS
ALL_BITS = 8


def name_geoms(scene: Scene) -> list[str]:
    """Name each geom after its topmost body, or by its own name where it hangs on the world.

    What has no name is called ``body 3`` or ``geom 12``.
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
) -> tuple[Int, Int, list[Names]]:
    """Make the table of names for the cells of a grid.

    Args:
        cell, geom: cells on the lattice, and a geom in each, shape (n,).
        bits: OBJECTS, WALLS and BLOCKERS of each, shape (n,); those with 0 don't count.
        names: by geom id.
        lattice, window: the cells, and those that the grid holds.

    Returns:
        The fields of `navbake.navgrid.user_data.Shared`: cell ids on the window, ascending; the
        entry of each; and the entries: sorted names by key, ``blockers`` only where these differ
        from all other names.
    """
    # names are numbered by their first geoms, so that they keep the order of the scene's geoms
    numbers: dict[str, int] = {}
    number_of = np.array([numbers.setdefault(name, k) for k, name in enumerate(names)], np.int64)
    cell, name, bits = _merge(cell, number_of[geom], bits, len(names))
    token = name * ALL_BITS + bits
    if window != (slice(0, lattice.height), slice(0, lattice.width)):
        cell, inside = crop_cells(cell, window, lattice.width)
        token = token[inside]
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    start = np.append(first, len(cell))
    number = np.empty(len(first), dtype=np.int64)
    lists = number_distinct_lists(start, token, number)
    return cell[first], number, _describe(token, start[lists], start[lists + 1], names)


def _merge(cell: Int, name: Int, bits: Int, num_names: int) -> tuple[Int, Int, Int]:
    """Unique pairs of cell and name, sorted, with their bits."""
    kept = bits > 0
    cell = cell[kept]
    name = name[kept]
    bits = bits[kept]
    pair = cell * num_names + name
    if (np.diff(pair) < 0).any():
        order = np.argsort(pair, kind="stable")
        pair = pair[order]
        cell = cell[order]
        name = name[order]
        bits = bits[order]
    first = np.flatnonzero(np.diff(pair, prepend=-1))
    merged = np.bitwise_or.reduceat(bits, first) if len(first) else bits
    return cell[first], name[first], merged


def _describe(token: Int, begin: Int, end: Int, names: Sequence[str]) -> list[Names]:
    """The user data of cells that hold the tokens from each begin to its end."""
    size = end - begin
    owner = np.repeat(np.arange(len(size)), size)
    token = token[np.arange(len(owner)) + (begin - np.cumsum(size) + size)[owner]]
    name, bits = np.divmod(token, ALL_BITS)
    order = np.lexsort((_ranks(names)[name], owner))
    name = name[order]
    bits = bits[order]
    differs = ((bits & BLOCKERS) > 0) != ((bits & NAMED) > 0)
    tells_blockers = np.bincount(owner, differs, len(size)) > 0
    chosen = {key: (bits & bit) > 0 for key, bit in KEYS.items()}
    chosen["blockers"] = ((bits & BLOCKERS) > 0) & tells_blockers[owner]
    described: list[Names] = [{} for _ in size]
    for key, is_chosen in chosen.items():
        listed = [names[k] for k in name[is_chosen].tolist()]
        owners, first = np.unique(owner[is_chosen], return_index=True)
        ends = np.append(first[1:], len(listed))[: len(first)]
        for k, one, other in np.stack([owners, first, ends], axis=1).tolist():
            described[k][key] = listed[one:other]
    return described


def _ranks(names: Sequence[str]) -> Int:
    """The place of each name among all of them, sorted."""
    ranks = np.empty(len(names), dtype=np.int64)
    ranks[sorted(range(len(names)), key=names.__getitem__)] = np.arange(len(names))
    return ranks
