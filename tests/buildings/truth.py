"""Checks a baked grid against what is true of a building."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from box_truth import HEIGHT, STEP, Corners, met_by_boxes
from buildings.parts import Building, Patch, Placing, Rect
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import find_islands

SAME = 0.02  # heights that differ by less are the same [m]
CLEAR = 0.001  # what is nearer than this to an edge is on neither side of it [m]
# By so much a wall leans at most where the whole building does [m]
LEAN = 0.06
# So many cells at edges of slabs may hold more floors there than there are storeys
FEW = 5
# A part of a floor that is cut off, as under stairs, may be furniture if smaller [m²]
SMALL = 3.0

Mask = NDArray[np.bool_]
Cells = NDArray[np.float64]


def check(grid: SceneGrid2D | MultiLevelGrid, building: Building) -> list[str]:
    """What is wrong with a grid, a line each; nothing where it is as a person would say.

    A line begins with the kind of fault: ``levels`` (their number), ``floor lost``, ``false
    floor`` (on a roof, in a wall), ``false connection``, ``missing connection``. A cell has to be
    free where its centre is on a floor with headroom and no box meets its footprint, by exact
    geometry; but not where spiral stairs stand, which are no boxes.
    """
    faults = []
    if len(grid.levels) != building.levels:
        heights = ", ".join(f"{level.ground:.2f}" for level in grid.levels)
        faults.append(f"levels: {len(grid.levels)} (at {heights}) instead of {building.levels}")
    views = [LevelView(level, building) for level in grid.levels]
    faults += _lost_floors(views, building)
    faults += _false_floors(views, building)
    faults += _connections(grid, views, building)
    return faults


class LevelView:
    """A level's cells: centres in the world, floors as placed, and which are free."""

    def __init__(self, level: SceneGrid2D, building: Building) -> None:
        lattice, self.cell = level.lattice, level.lattice.cell_size
        row, col = np.indices(level.shape)
        self.x: Cells = lattice.x_min + (col + 0.5) * self.cell
        self.y: Cells = lattice.y_max - (row + 0.5) * self.cell
        self.free: Mask = level.free
        self.placing = building.placing
        floor = level.floor_height.astype(np.float64)
        self.placed_x, self.placed_y, self.floor = self.placing.back(self.x, self.y, floor)

    def within(self, rect: Rect, margin: float = 0.0) -> Mask:
        """The cells whose centres are inside of a rectangle, by a margin [m]."""
        return within(self.placed_x, self.placed_y, self.placing, rect, margin)

    def at(self, low: float, high: float) -> Mask:
        """The free cells whose floor is between two heights."""
        with np.errstate(invalid="ignore"):
            return self.free & (self.floor >= low) & (self.floor <= high)


def within(x: Cells, y: Cells, placing: Placing, rect: Rect, margin: float) -> Mask:
    x0, y0, x1, y1 = placing.rect(rect)
    inside = (x >= x0 + margin) & (x <= x1 - margin)
    return inside & (y >= y0 + margin) & (y <= y1 - margin)


def _floor_cells(
    views: Sequence[LevelView], building: Building
) -> Iterator[tuple[str, float, Mask, list[Mask]]]:
    """Of each patch: its place, height, cells that are lost, and those found on each level."""
    # the levels are cut from one lattice; the largest rectangle is that of all of them
    cell = views[0].cell
    x0, x1 = min(v.x.min() for v in views), max(v.x.max() for v in views)
    y0, y1 = min(v.y.min() for v in views), max(v.y.max() for v in views)
    num_cols, num_rows = round((x1 - x0) / cell) + 1, round((y1 - y0) / cell) + 1
    x, y = np.meshgrid(x0 + cell * np.arange(num_cols), y1 - cell * np.arange(num_rows))
    for place, rect, z, holes in building.floors:
        must = _must_be_free(x, y, cell, building, Patch(place, rect, z, holes))
        found, anywhere = [], np.zeros(must.shape, dtype=np.bool_)
        for view in views:
            row = round((y1 - view.y[0, 0]) / cell)
            col = round((view.x[0, 0] - x0) / cell)
            height, width = view.free.shape
            mask = np.zeros(must.shape, dtype=np.bool_)
            mask[row : row + height, col : col + width] = view.at(z - SAME, z + SAME)
            found.append((mask & must)[row : row + height, col : col + width])
            anywhere |= mask
        yield place, z, _joined_parts(must, must & anywhere, cell) & ~anywhere, found


def _must_be_free(x: Cells, y: Cells, cell: float, building: Building, patch: Patch) -> Mask:
    """The cells of a patch where nothing can be in the agent's way.

    A box around a turned footprint and a tilted agent stands for them.
    """
    _, rect, z, holes = patch
    placing = building.placing
    turn = np.radians(placing.turn)
    cell *= abs(np.cos(turn)) + abs(np.sin(turn))
    slack = CLEAR + 2 * HEIGHT * np.sin(np.radians(abs(placing.tilt)))
    x, y = placing.under(x, y, z)
    must = within(x, y, placing, rect, CLEAR)
    for hole in holes:
        must &= ~within(x, y, placing, hole, -slack)
    boxes: list[Corners] = []
    for box in building.boxes:
        if box.top > z + CLEAR and box.bottom < z + HEIGHT + slack:
            x0, y0, x1, y1 = placing.rect(box.rect)
            boxes.append((x0, y0, box.bottom, x1, y1, box.top))
            # what is over the centre is its floor, or leaves no headroom
            must &= ~within(x, y, placing, box.rect, -slack)
    for stairs in building.stairs if building.features.get("stairs") == "spiral" else ():
        if stairs.bottom - SAME <= z <= stairs.top + SAME + HEIGHT:
            must &= ~within(x, y, placing, stairs.rect, -1.5 * cell)
    met: Mask = met_by_boxes(x, y, np.full(x.shape, z), cell, boxes, slack=-slack)
    return must & ~met


def _joined_parts(must: Mask, found: Mask, cell: float) -> Mask:
    """The cells that are joined to one that was found, or to many others."""
    part, number = ndimage.label(must)
    area = np.bincount(part.ravel(), minlength=number + 1) * cell**2
    counts = area >= SMALL
    counts[np.unique(part[found])] = True
    counts[0] = False
    joined: Mask = counts[part]
    return joined


def _lost_floors(views: Sequence[LevelView], building: Building) -> list[str]:
    faults = []
    for place, z, lost, found in _floor_cells(views, building):
        num_lost, num_found = int(lost.sum()), sum(int(f.sum()) for f in found)
        if num_lost > (FEW if building.placing.tilt else 0):
            share = num_lost / (num_lost + num_found)
            faults.append(f"floor lost: {num_lost} cells ({share:.0%}) of {place} at {z:.2f}")
        elif not num_found and place != "outdoors":
            faults.append(f"truth: {place} at {z:.2f} has no cells")
    return faults


def _false_floors(views: Sequence[LevelView], building: Building) -> list[str]:
    faults = []
    for number, view in enumerate(views):
        allowed = np.zeros(view.free.shape, dtype=np.bool_)
        for _, rect, z, holes in [*building.floors, *building.maybe]:
            here = view.at(z - SAME, z + SAME) & view.within(rect, -0.5 * view.cell)
            for hole in holes:
                here &= ~view.within(hole, 0.5 * view.cell)
            allowed |= here
        for stairs in building.stairs:
            between = view.at(stairs.bottom - SAME, stairs.top + SAME)
            allowed |= between & view.within(stairs.rect, -1e-6)
        if building.placing.tilt:  # the sides of boxes lean, and show from above
            for box in building.boxes:
                side = view.within(box.rect, -LEAN) & ~view.within(box.rect, LEAN)
                allowed |= side & view.at(box.bottom - SAME, box.top + SAME)
        wrong = view.free & ~allowed
        if wrong.any():
            faults.append(_describe("false floor", number, view, wrong))
        inside = np.zeros(view.free.shape, dtype=np.bool_)
        for box in building.boxes:
            meets = view.at(box.bottom - HEIGHT + SAME, box.top - STEP - SAME)
            inside |= meets & view.within(box.rect, LEAN if building.placing.tilt else 1e-6)
        if inside.any():
            faults.append(_describe("false floor: in a solid", number, view, inside))
    return faults


def _describe(kind: str, number: int, view: LevelView, cells: Mask) -> str:
    row, col = np.argwhere(cells)[0]
    heights = np.unique(view.floor[cells].round(2))
    return (
        f"{kind}: {int(cells.sum())} cells of level {number} at heights "
        f"{heights[0]:.2f} to {heights[-1]:.2f}, one at "
        f"({view.x[row, col]:.2f}, {view.y[row, col]:.2f})"
    )


def _connections(
    grid: SceneGrid2D | MultiLevelGrid, views: Sequence[LevelView], building: Building
) -> list[str]:
    """Places have to share an island where one can walk between them, and only there."""
    islands = find_islands(grid)
    of_place: dict[str, list[int]] = {}
    for place, _, _, found in _floor_cells(views, building):
        ids = [island[cells] for island, cells in zip(islands, found, strict=True)]
        of_place.setdefault(place, []).extend(np.concatenate(ids).tolist())
    group = _groups(of_place, building.joined)
    main, faults = {}, []
    for place, ids in of_place.items():
        if ids:
            counts = np.bincount(ids)
            main[place] = int(counts.argmax())
            if counts.max() < 0.999 * len(ids):
                parts = np.sort(counts[counts > 0])[::-1][:4].tolist()
                faults.append(f"missing connection: {place} is in parts of {parts} cells")
    for name in sorted(set(group.values())):
        islands_of = {place: main[place] for place in main if group[place] == name}
        if len(set(islands_of.values())) > 1:
            parts = [[p for p, i in islands_of.items() if i == k] for k in set(islands_of.values())]
            text = "; ".join(sorted(", ".join(part) for part in parts))
            faults.append(f"missing connection between: {text}")
    for island in sorted(set(main.values())):
        places = {group[place]: place for place in main if main[place] == island}
        if len(places) > 1:
            faults.append(f"false connection of: {', '.join(places.values())}")
    return faults


def _groups(
    places: Sequence[str] | dict[str, list[int]], joined: Sequence[tuple[str, str]]
) -> dict[str, str]:
    """A name for each group of places that are joined."""
    group = {place: place for place in places}
    for a, b in joined:
        old, new = group.get(a), group.get(b)
        if old is None or new is None:
            continue
        group = {place: new if name == old else name for place, name in group.items()}
    return group
