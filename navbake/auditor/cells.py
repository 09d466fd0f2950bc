"""Checks of layers and floors: free, blocked, weights, jumps, what is connected or cut off."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.auditor.facts import DOWN, ERROR, REMARK, RIGHT, Facts, Found, read_inflations
from navbake.errors import count_of
from navbake.navgrid.grid import GridBase
from navbake.types import Bool, Int

MANY = 100  # cells that a grid has at least, if it is to say something that all are free
FEW = 0.01  # share of a level's cells under which hardly any are free
LARGE = 1e-3  # metres that a clearance may be off
MOST_STORED = 65_535  # the number of the islands that the layer's type has no other for
FARTHEST = 10_000.0  # floors beyond are a wrong unit [m]
MIN_AREA = 1.0  # of a floor that no step leads to, unless the settings of a bake say another [m²]
MOST_ROUND = 0.75  # share of a patch's outline that is nearly all of it: a corner may touch a wall
HALF_ROUND = 0.5  # share from which on nobody would take a patch for a storey beside another
MOST_PATCHES = 10  # that are told one by one
MIN_CUT_OFF = 1.0  # of both islands, if what lies between them is to matter [m²]
MOST_CELLS = 3  # of a gap; what is longer is a thin wall
MOST_GAPS = 10  # that are told, the widest islands first


def check_all_free(facts: Facts) -> Iterator[Found]:
    """All cells are free: nothing stands there, not even a wall."""
    total = sum(free.size for free in facts.free)
    if total >= MANY and all(free.all() for free in facts.free):
        text = f"all {total} cells are free: nothing stands on the floor, and it ends nowhere"
        yield REMARK, None, None, text


def check_empty_levels(facts: Facts) -> Iterator[Found]:
    """A level has no floor, or nowhere to stand, which an inflation may do; or so has the grid."""
    severity = ERROR
    inflated = ""
    if facts.reach is not None:
        severity = REMARK
        inflated = f", inflated by {facts.reach:g} m"
    if not any(free.any() for free in facts.free):
        yield severity, None, None, f"no cell is free, on any level{inflated}"
        return
    for number in [number for number, free in enumerate(facts.free) if not free.any()]:
        has_floor = np.count_nonzero(~np.isnan(facts.floors[number]))
        text = f"none of its {has_floor} cells with a floor is free{inflated}"
        yield (severity, number, None, text) if has_floor else (ERROR, number, None, "no floor")


def check_free_share(facts: Facts) -> Iterator[Found]:
    """Hardly any cell is free: a map that is black but for a few specks."""
    for number, (level, free) in enumerate(zip(facts.levels, facts.free, strict=True)):
        is_floor = free | ~np.isnan(facts.floors[number])
        total = np.count_nonzero(is_floor) if level.uses_cell_floors else free.size
        if total >= MANY and 0 < (num_free := np.count_nonzero(free)) < FEW * total:
            text = f"only {num_free} of {total} cells are free"
            yield REMARK, number, facts.first(number, free), text


def check_weights(facts: Facts) -> Iterator[Found]:
    """Weights and occupancy contradict each other, or a weight is none."""
    reach = facts.reach
    for number, level in enumerate(facts.levels):
        weights = level.weights
        occupied = level.occupancy != 0
        free = facts.free[number]
        broken = np.isnan(weights) | (weights < 0)
        yield from facts.on_cells(number, broken, "a weight that is no cost")
        if "occupancy" not in level.attributes:
            continue
        is_opened = (reach is not None) & (level.solid == 0)
        on_occupied = free & occupied & ~is_opened
        yield from facts.on_cells(number, on_occupied, "free by weight, but occupied")
        blocked = ~free & ~broken & ~occupied
        text = "blocked by weight, but not occupied"
        if reach is not None and blocked.any():
            blocked &= ~find_reasons(facts.grid, number, reach)
            text += f", and nothing that an inflation avoids is within {reach:g} m"
        yield from facts.on_cells(number, blocked, text)


def find_reasons(grid: GridBase, number: int, reach: float) -> Bool:
    """The cells of a level that have something within reach [m] for which they may be closed.

    An occupied cell, none, a floor more than a step off, one of another level less than the agent's
    height away, or the edge; in a square, which misses none.
    """
    level = grid.levels[number]
    cells = min(math.ceil(reach / level.lattice.cell_size) + 1, max(level.shape))
    floor = level.floor
    size = 2 * cells + 1
    body = grid.agent_height
    blocks = (level.occupancy != 0) | np.isnan(floor)
    known = floor[~np.isnan(floor)]
    for other in grid.levels:
        if other is not level and len(known):
            near = (other.floor > known.min() - body) & (other.floor < known.max() + body)
            at = other.lattice.positions(*np.nonzero(near))
            rows, cols = level.lattice.rows_cols(at)
            inside = level.lattice.holds(rows, cols)
            blocks[rows[inside], cols[inside]] = True
    found: Bool = maximum_filter(blocks, size, mode="constant", cval=True)
    high = maximum_filter(np.where(np.isnan(floor), -np.inf, floor), size)
    low = minimum_filter(np.where(np.isnan(floor), np.inf, floor), size)
    with np.errstate(invalid="ignore"):  # where there is no floor
        found |= (high - floor > grid.max_step) | (floor - low > grid.max_step)
    return found


def check_inflation(facts: Facts) -> Iterator[Found]:
    """The metadata don't tell for which radius a grid was inflated."""
    _, broken = read_inflations(facts.grid)
    if broken is not None:
        # in files of other programs it may mean anything
        yield ERROR if facts.grid.navbake else REMARK, None, None, broken


def check_layers(facts: Facts) -> Iterator[Found]:
    """Stored layers contradict what they follow from: islands and clearance."""
    if not facts.grid.navbake:
        return  # in files of other programs they may be anything
    for number, level in enumerate(facts.levels):
        stored = level.attributes.get("island")
        if stored is not None:
            wrong = stored != np.minimum(facts.islands[number], MOST_STORED)
            text = "a number in the layer `island` that isn't what is connected"
            yield from facts.on_cells(number, wrong, text)
        stored = level.attributes.get("clearance")
        if stored is not None:
            away = distance_transform_edt(np.pad(level.free_for_point, 1))[1:-1, 1:-1] - 0.5
            away = np.where(level.free, away * level.lattice.cell_size, 0.0)
            wrong = np.abs(stored * level.unit - away) > LARGE
            yield from facts.on_cells(number, wrong, "a wrong `clearance`")


def check_floors(facts: Facts) -> Iterator[Found]:
    """Free cells have no floor, or one that is absurdly high or low."""
    for number, level in enumerate(facts.levels):
        if level.uses_cell_floors:
            floor = facts.floors[number]
            missing = facts.free[number] & np.isnan(floor)
            yield from facts.on_cells(number, missing, "free without a floor")
            far = np.abs(floor) > FARTHEST  # NaN isn't
            yield from facts.on_cells(number, far, f"farther than {FARTHEST:g} m from 0")


def check_jumps(facts: Facts) -> Iterator[Found]:
    """A patch of floor lies more than a step above or below what is round it.

    It is a spike, a pit, or the top of something: an error if it is too small for a floor.
    """
    settings = facts.settings.get("floors")
    stated = settings.get("min_area") if isinstance(settings, dict) else None
    min_area = float(stated) if isinstance(stated, int | float) else MIN_AREA
    # of each island: cells, edges of its outline, how many of these drop or rise to another one,
    # and by how much in all [m]
    islands = facts.islands
    count = max((int(island.max(initial=0)) for island in islands), default=0) + 1
    cells, edges = np.zeros((2, count), dtype=np.int64)
    jumps, total = np.zeros((2, 2, count))
    for number, island in enumerate(islands):
        cells += np.bincount(island.ravel(), minlength=count)
        padded = np.pad(island, 1)  # beyond the rim is none
        for here, there in DOWN, RIGHT:
            differ = padded[here] != padded[there]
            for side in (here, there):
                edges += np.bincount(padded[side][differ], minlength=count)
        # free neighbours are on two islands only where they lie more than a step apart
        for one, step in pairs_across(island, 1):
            own = island.ravel()
            floor = facts.floors[number].ravel()
            one = one[(own[one] > 0) & (own[one + step] > 0)]
            down = floor[one] - floor[one + step]
            for patches, drop in (own[one + step], -down), (own[one], down):
                for num, rise, mask in zip(jumps, total, (drop > 0, drop < 0), strict=True):
                    num += np.bincount(patches[mask], minlength=count)
                    rise += np.bincount(patches[mask], np.abs(drop[mask]), minlength=count)
    cells[0] = 0
    jumps[:, 0] = 0
    area = cells * facts.levels[0].lattice.cell_size ** 2
    found = []
    for way, num, rise in zip(("above", "below"), jumps, total, strict=True):
        share = num / np.maximum(edges, 1)
        for patch in np.flatnonzero(share >= HALF_ROUND).tolist():
            is_most = share[patch] >= MOST_ROUND
            by = rise[patch] / num[patch]
            around = "all" if is_most else "most of what is"
            size = f"{area[patch]:.3g} m² of floor ({count_of(int(cells[patch]), 'cell')})"
            text = f"{size} lies {by:.2f} m {way} {around} round it, and no step leads there"
            found.append((not (is_most and area[patch] < min_area), -area[patch], patch, text))
    found.sort()
    for is_remark, _, patch, text in found[:MOST_PATCHES]:
        # the level that has most of it, and a cell in its middle
        on = [np.flatnonzero(island == patch) for island in islands]
        number = max(range(len(on)), key=lambda k: len(on[k]))
        row, col = divmod(int(on[number][len(on[number]) // 2]), facts.levels[number].width)
        place = facts.place(number, row, col)
        yield REMARK if is_remark else ERROR, number, place, text
    if rest := found[MOST_PATCHES:]:
        severity = REMARK if rest[0][0] else ERROR
        yield severity, None, None, f"{len(rest)} more patches of floor jump"


def pairs_across(values: NDArray[Any], gap: int) -> Iterator[tuple[Int, int]]:
    """Flat ids of cells whose value differs from that of a cell to the right, then below.

    With how far that one is in the flat array: `gap` columns, then `gap` rows.
    """
    width = values.shape[1]
    right = values[:, :-gap] != values[:, gap:]
    below = values[:-gap] != values[gap:]
    for differ, step in ((right, gap), (below, gap * width)):
        rows, cols = np.nonzero(differ)  # few do, so that the rest is asked of few
        yield rows * width + cols, step


def check_cut_off(facts: Facts) -> Iterator[Found]:
    """One cell, or two or three side by side, cut off an island, with all doors open.

    More cells between the same two islands are a thin wall; cells in it that nothing occupies are a
    gap closed for a larger agent. The floors on both sides are within a step of each other.
    """
    islands = facts.open_islands
    cell_size = facts.levels[0].lattice.cell_size
    largest = max((int(island.max(initial=0)) for island in islands), default=0)
    counts = [np.bincount(island.ravel(), minlength=largest + 1) for island in islands]
    area = np.sum(counts, axis=0) * cell_size**2
    found = []
    for number, island in enumerate(islands if largest >= 2 else ()):
        occupied = facts.levels[number].occupancy.ravel() != 0
        floor = facts.floors[number].ravel()
        own = island.ravel()
        gaps: dict[tuple[int, ...], set[int]] = {}  # blocked cells by the islands on both sides
        for one, step in pairs_across(island, 2):
            cell = one + step // 2
            other = one + step
            is_gap = (own[one] > 0) & (own[cell] == 0) & (own[other] > 0) & ~np.isnan(floor[cell])
            with np.errstate(invalid="ignore"):
                is_gap &= ~(np.abs(floor[one] - floor[other]) > facts.step_limit)
            pairs = np.sort(np.stack([own[one], own[other]], axis=1)[is_gap], axis=1)
            for pair, blocked in zip(pairs.tolist(), cell[is_gap].tolist(), strict=True):
                gaps.setdefault(tuple(pair), set()).add(blocked)
        for pair, between in gaps.items():
            cells = {cell for cell in between if not occupied[cell]} or between
            smaller = min(area[list(pair)])
            if len(cells) <= MOST_CELLS and smaller >= MIN_CUT_OFF:
                found.append((smaller, number, cells))
    for smaller, number, cells in sorted(found, key=lambda gap: -gap[0])[:MOST_GAPS]:
        row, col = divmod(sorted(cells)[len(cells) // 2], facts.levels[number].width)
        size = len(cells) * facts.levels[number].lattice.cell_size
        text = f"a gap {size:.2f} m wide is blocked by one cell, and cuts off {smaller:.1f} m²"
        yield REMARK, number, facts.place(number, row, col), text


def check_unreached_levels(facts: Facts) -> Iterator[Found]:
    """No link leads to a level from the one with the most free cells."""
    count = len(facts.levels)
    sizes = [int(free.sum()) for free in facts.free]
    pairs = coo_array((np.ones(len(facts.links)), tuple(facts.links[:, ::2].T)), (count, count))
    _, group = connected_components(pairs, directed=False)
    for number in np.flatnonzero(group != group[np.argmax(sizes)]).tolist():
        if sizes[number]:  # else a check of empty levels says so
            area = sizes[number] * facts.levels[number].lattice.cell_size ** 2
            place = facts.first(number, facts.free[number])
            yield REMARK, number, place, f"no link leads to its {area:.1f} m²"
