"""Makes the user data of a grid: the names of the objects, walls and blockers in each cell."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.union_find import number_distinct_lists
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.navgrid.lattice import Lattice
from navbake.types import Int

CellNames = dict[str, list[str]]
"""The user data of a cell: key, such as ``objects`` -> the sorted names under this key."""

# Bits of a geom in a cell, and the keys of user data for them
OBJECTS = 1
WALLS = 2
BLOCKERS = 4
BOX_STEPS = 10_000.0  # steps in a metre to which the corners of boxes are rounded
BOX_SLACK = 1e-3  # share of a step
USER_DATA_KEYS = {"objects": OBJECTS, "walls": WALLS}
OBJECTS_OR_WALLS = OBJECTS | WALLS
NUM_BIT_COMBINATIONS = 8  # all sums of these bits are below this


def name_geoms(scene: Scene) -> list[str]:
    """Return for each geom the name of its topmost body.

    A geom of the world body has its own name instead. A body or geom without a name is called
    ``body 3`` or ``geom 12``, after its id.
    """
    model = scene.model
    root_bodies = model.body_rootid[model.geom_bodyid]
    names_of_bodies = {
        int(root_body): body_name(model, int(root_body)) for root_body in np.unique(root_bodies)
    }
    return [
        names_of_bodies[int(root_body)] if root_body else geom_report.name
        for root_body, geom_report in zip(root_bodies, scene.geoms, strict=True)
    ]


def measure_names(shapes: Shapes, geoms: Int, names: Sequence[str]) -> dict[str, list[float]]:
    """Measure the upright box round all geoms of each name.

    Args:
        shapes: the geometry of the posed scene.
        geoms: ids of the geoms that are measured: all that have any of the names, (n,).
        names: the name of each of these geoms, n names.

    Returns:
        Name -> x, y, z of the box's lower corner, and of its upper corner [m], in steps of 0.1 mm;
        sorted by name. Names of geoms without an end are left out.
    """
    unique_names = sorted(set(names))
    number_of_name = {name: number for number, name in enumerate(unique_names)}
    number_of_geom = np.full(len(shapes.is_endless), -1)
    number_of_geom[geoms] = [number_of_name[name] for name in names]
    number_of_box = number_of_geom[shapes.geom_of_box]
    measured_boxes = np.flatnonzero((number_of_box >= 0) & ~shapes.is_endless[shapes.geom_of_box])
    boxes = shapes.boxes[measured_boxes]
    has_end = np.isfinite(boxes).all(axis=1)
    boxes = boxes[has_end]
    numbers = number_of_box[measured_boxes[has_end]]
    corners = np.full((len(unique_names), 6), np.inf)
    corners[:, 3:] = -np.inf
    np.minimum.at(corners[:, :3], numbers, boxes[:, :3])
    np.maximum.at(corners[:, 3:], numbers, boxes[:, 3:])
    # outwards, but for what rounding may have moved a round number
    corners[:, :3] = np.floor(corners[:, :3] * BOX_STEPS + BOX_SLACK)
    corners[:, 3:] = np.ceil(corners[:, 3:] * BOX_STEPS - BOX_SLACK)
    rounded_corners = (corners / BOX_STEPS + 0.0).tolist()  # no -0.0
    has_box = np.isfinite(corners).all(axis=1).tolist()
    return {
        name: box
        for name, box, is_measured in zip(unique_names, rounded_corners, has_box, strict=True)
        if is_measured
    }


def name_cells(
    cells: Int,
    geoms: NDArray[np.integer],
    key_bits: Int,
    names: Sequence[str],
    lattice: Lattice,
    window: Window,
) -> tuple[Int, Int, list[CellNames]]:
    """Make the table of names for the cells of a grid.

    Args:
        cells: cell ids on the lattice, shape (n,).
        geoms: the id of a geom in each of these cells, shape (n,). A cell with several geoms occurs
            several times.
        key_bits: the bits OBJECTS, WALLS and BLOCKERS of each pair of cell and geom, shape (n,); a
            pair with 0 is dropped.
        names: the name of each geom, that of its topmost body, by geom id.
        lattice: the whole lattice.
        window: the rows and columns of the lattice that the grid holds.

    Returns:
        The fields of `navbake.navgrid.user_data.SharedEntries`: the ids on the window of the cells
        with names, ascending; for each of them, the index of its entry; and the entries, which hold
        sorted names by key. An entry has no ``blockers`` if they are the same names as its objects
        and walls together.
    """
    has_bits = key_bits > 0
    if not has_bits.any():
        no_cells = np.empty(0, dtype=np.int64)
        return no_cells, no_cells, []
    cells = cells[has_bits]
    geoms = geoms[has_bits]
    key_bits = key_bits[has_bits]
    # names are numbered by their first geoms, so that they keep the order of the scene's geoms;
    # only the names of the level's own geoms are
    level_geoms, geom_index = np.unique(geoms, return_inverse=True)
    names = [names[geom] for geom in level_geoms.tolist()]
    number_of_name: dict[str, int] = {}
    name_number_of_geom = np.array(
        [number_of_name.setdefault(name, number) for number, name in enumerate(names)], np.int64
    )
    cells, name_numbers, key_bits = _merge_pairs(
        cells, name_number_of_geom[geom_index], key_bits, len(names)
    )
    name_and_bits = name_numbers * NUM_BIT_COMBINATIONS + key_bits
    if window != (slice(0, lattice.height), slice(0, lattice.width)):
        cells, is_inside = crop_cells(cells, window, lattice.width)
        name_and_bits = name_and_bits[is_inside]
    # cells with equal lists of names and bits share an entry
    first_pair_of_cell = np.flatnonzero(np.diff(cells, prepend=-1))
    list_starts = np.append(first_pair_of_cell, len(cells))
    entry_of_cell = np.empty(len(first_pair_of_cell), dtype=np.int64)
    distinct_list_indices = number_distinct_lists(list_starts, name_and_bits, entry_of_cell)
    entries = _describe(
        name_and_bits,
        list_starts[distinct_list_indices],
        list_starts[distinct_list_indices + 1],
        names,
    )
    return cells[first_pair_of_cell], entry_of_cell, entries


def _merge_pairs(
    cells: Int, name_numbers: Int, key_bits: Int, num_names: int
) -> tuple[Int, Int, Int]:
    """Merge all entries that have the same cell and the same name.

    An entry is a geom in a cell.

    Args:
        cells: the cell of each entry, (n,).
        name_numbers: the number of the geom's name, for each entry, (n,).
        key_bits: the bits OBJECTS, WALLS and BLOCKERS of the geom in the cell, at least one of
            them, (n,).
        num_names: the number of names; all of `name_numbers` are below it.

    Returns:
        Cells and numbers of names of the unique pairs, sorted by cell and then name; and the bits
        that any entry of the pair has.
    """
    pair_key = cells * num_names + name_numbers
    if (np.diff(pair_key) < 0).any():
        sort_indices = np.argsort(pair_key, kind="stable")
        pair_key = pair_key[sort_indices]
        cells = cells[sort_indices]
        name_numbers = name_numbers[sort_indices]
        key_bits = key_bits[sort_indices]
    first_index_of_pair = np.flatnonzero(np.diff(pair_key, prepend=-1))
    merged_bits = np.bitwise_or.reduceat(key_bits, first_index_of_pair)
    return cells[first_index_of_pair], name_numbers[first_index_of_pair], merged_bits


def _describe(
    names_and_bits: Int, list_starts: Int, list_ends: Int, names: Sequence[str]
) -> list[CellNames]:
    """Make the user data of each distinct list of names, which several cells may share.

    A name and its bits are one number: ``number of the name * NUM_BIT_COMBINATIONS + bits``.

    Args:
        names_and_bits: names and bits of all cells, one cell after the other.
        list_starts: for each list, the index of its first name in `names_and_bits`.
        list_ends: for each list, the index after its last name.
        names: the names, by number.

    Returns:
        For each list, its sorted names by key.
    """
    list_lengths = list_ends - list_starts
    num_lists = len(list_lengths)
    list_number = np.repeat(np.arange(num_lists), list_lengths)
    names_and_bits = names_and_bits[
        np.arange(len(list_number))
        + (list_starts - np.cumsum(list_lengths) + list_lengths)[list_number]
    ]
    name_numbers, key_bits = np.divmod(names_and_bits, NUM_BIT_COMBINATIONS)
    sort_indices = np.lexsort((_rank_names(names)[name_numbers], list_number))
    name_numbers = name_numbers[sort_indices]
    key_bits = key_bits[sort_indices]
    is_blocker_mismatch = ((key_bits & BLOCKERS) > 0) != ((key_bits & OBJECTS_OR_WALLS) > 0)
    has_blockers = np.bincount(list_number, is_blocker_mismatch, num_lists) > 0
    is_under_key = {key: (key_bits & bit) > 0 for key, bit in USER_DATA_KEYS.items()}
    is_under_key["blockers"] = ((key_bits & BLOCKERS) > 0) & has_blockers[list_number]
    user_data: list[CellNames] = [{} for _ in range(num_lists)]
    for key, is_listed in is_under_key.items():
        key_names = [names[name_number] for name_number in name_numbers[is_listed].tolist()]
        list_numbers, first_names = np.unique(list_number[is_listed], return_index=True)
        end_names = np.append(first_names[1:], len(key_names))[: len(first_names)]
        name_ranges = np.stack([list_numbers, first_names, end_names], axis=1).tolist()
        for list_index, first_name, end_name in name_ranges:
            user_data[list_index][key] = key_names[first_name:end_name]
    return user_data


def _rank_names(names: Sequence[str]) -> Int:
    """Return for each name its index in the sorted list of all names, shape (n,)."""
    ranks_of_names = np.empty(len(names), dtype=np.int64)
    ranks_of_names[sorted(range(len(names)), key=names.__getitem__)] = np.arange(len(names))
    return ranks_of_names
