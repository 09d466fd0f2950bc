"""User data: what stands in each cell, by name."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.lists import number_lists
from navbake.baker.lattice import Window, cut_cells
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.navgrid.lattice import Lattice
from navbake.types import Int

Names = dict[str, list[str]]

# Bits: how a geom is in a cell, and the keys of user data that they end up under
OBJECTS, WALLS, BLOCKERS = 1, 2, 4
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
    """Write the names of geoms in cells as user data.

    Args:
        cell, geom: cells on the lattice, and a geom in each, shape (n,).
        bits: how it is there, of OBJECTS, WALLS and BLOCKERS, shape (n,); none if 0.
        names: by geom id.
        lattice, window: the cells, and those that the grid holds.

    Returns:
        Cell ids on the window, ascending; which entry each has; and the entries: sorted names
        under each key that has any, and ``blockers`` where they aren't all the other names. See
        `navbake.navgrid.user_data.Shared`.
    """
    # names are numbered by their first geoms, so that they keep the order of the scene's geoms
    numbers: dict[str, int] = {}
    number_of = np.array([numbers.setdefault(name, k) for k, name in enumerate(names)], np.int64)
    cell, name, bits = _merge(cell, number_of[geom], bits, len(names))
    token = name * ALL_BITS + bits
    if window != (slice(0, lattice.height), slice(0, lattice.width)):
        cell, inside = cut_cells(cell, window, lattice.width)
        token = token[inside]
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    start = np.append(first, len(cell))
    number = np.empty(len(first), dtype=np.int64)
    lists = number_lists(start, token, number)
    return cell[first], number, _describe(token, start[lists], start[lists + 1], names)


def _merge(cell: Int, name: Int, bits: Int, num_names: int) -> tuple[Int, Int, Int]:
    """Cells, names and their bits, by cell and then name, none twice."""
    kept = bits > 0
    cell, name, bits = cell[kept], name[kept], bits[kept]
    pair = cell * num_names + name
    if (np.diff(pair) < 0).any():
        order = np.argsort(pair, kind="stable")
        pair, cell, name, bits = pair[order], cell[order], name[order], bits[order]
    first = np.flatnonzero(np.diff(pair, prepend=-1))
    merged = np.bitwise_or.reduceat(bits, first) if len(first) else bits
    return cell[first], name[first], merged


def _describe(token: Int, begin: Int, end: Int, names: Sequence[str]) -> list[Names]:
    """The user data of cells that hold the tokens from each begin to its end."""
    name_of = [names[k] for k in (token // ALL_BITS).tolist()]
    bits_of = (token % ALL_BITS).tolist()
    described = []
    for one, other in zip(begin.tolist(), end.tolist(), strict=True):
        listed, bits = name_of[one:other], bits_of[one:other]
        if len(set(bits)) == 1:
            listed.sort()
            described.append(dict.fromkeys(_KEYS_OF[bits[0]], listed))
        else:
            described.append(_describe_mixed(listed, bits))
    return described


def _describe_mixed(names: Sequence[str], bits: Sequence[int]) -> Names:
    """The user data of a cell that holds names under different keys."""
    pairs = sorted(zip(names, bits, strict=True))
    data = {key: [name for name, b in pairs if b & bit] for key, bit in KEYS.items()}
    if any(bool(b & BLOCKERS) != bool(b & NAMED) for b in bits):
        data["blockers"] = [name for name, b in pairs if b & BLOCKERS]
    return {key: listed for key, listed in data.items() if listed}


# The keys of a cell whose names all have the same bits
_KEYS_OF = [list(_describe_mixed(["name"], [bits])) for bits in range(ALL_BITS)]
