"""Blocks cells of a grid for a while, for things that move, and frees them again.

Each level counts who blocks its cells, so blocks may overlap. The level's own weights and
occupancy change with them, and its clearance if it has that layer, in the touched window only.
Who keeps something that follows from them, as a `PathFinder` does, asks for the windows that
changed since it last looked.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.islands import clearance
from navbake.navgrid.user_data import held_user_data
from navbake.runtime.blocks.shape import BLOCKED, NUM_LAYERS, OCCUPIED, Layers

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.navgrid.grid import NavGrid, SceneGrid2D

CHANGING = {"occupancy", "clearance"}  # attributes that are changed in place
MAX_JOURNAL = 1024  # changes that a level remembers; who missed more looks at all of it

Window = tuple[int, int, int, int]
"""First and last row, first and last column, the last ones excluded."""


class LevelChanges:
    """Who blocks the cells of one level, and what was there before.

    Attributes:
        count: how many blocks hold a cell, by layer (see `navbake.runtime.blocks.shape`)
            and cell id, uint16.
        weights: what the cells weigh when nobody blocks them, by cell id.
        occupancy: likewise; None if the level has no such layer of its own.
        revision: how many times something changed.
    """

    def __init__(self, level: SceneGrid2D) -> None:
        self.count = np.zeros((NUM_LAYERS, level.width * level.height), dtype=np.uint16)
        self.revision = 0
        self._journal: list[Window] = []
        # arrays of its own: others may share them, or they may be read-only
        level.weights = np.array(level.weights, order="C")
        level.attributes = dict(level.attributes)
        for name in CHANGING & level.attributes.keys():
            level.attributes[name] = np.array(level.attributes[name], order="C")
        self.weights = level.weights.ravel().copy()
        stored = level.attributes.get("occupancy")
        self.occupancy = None if stored is None else stored.ravel().copy()
        self._farthest = _farthest(level)

    @property
    def is_blocked(self) -> bool:
        """Whether any cell is blocked now."""
        return bool(self.count.any())

    def windows_since(self, revision: int) -> list[Window] | None:
        """The windows that changed after a revision; None if that is too long ago to tell."""
        missed = self.revision - revision
        if missed > len(self._journal):
            return None
        return self._journal[len(self._journal) - missed :]

    def hold(self, level: SceneGrid2D, cells: Layers) -> None:
        """Block cells."""
        for layer, ids in enumerate(cells):
            self.count[layer, ids] += 1
        weights, taken = level.weights.reshape(-1), cells[BLOCKED]
        taken = taken[self.count[BLOCKED, taken] == 1]
        self.weights[taken] = weights[taken]
        weights[taken] = np.inf
        if self.occupancy is not None:
            occupancy, taken = level.attributes["occupancy"].reshape(-1), cells[OCCUPIED]
            taken = taken[self.count[OCCUPIED, taken] == 1]
            self.occupancy[taken] = occupancy[taken]
            occupancy[taken] = 1
        self._note(level, cells)

    def let_go(self, level: SceneGrid2D, cells: Layers) -> None:
        """Take back what `hold` did."""
        for layer, ids in enumerate(cells):
            self.count[layer, ids] -= 1
        left = cells[BLOCKED][self.count[BLOCKED, cells[BLOCKED]] == 0]
        level.weights.reshape(-1)[left] = self.weights[left]
        if self.occupancy is not None:
            left = cells[OCCUPIED][self.count[OCCUPIED, cells[OCCUPIED]] == 0]
            level.attributes["occupancy"].reshape(-1)[left] = self.occupancy[left]
        self._note(level, cells)

    def _note(self, level: SceneGrid2D, cells: Layers) -> None:
        rows, cols = np.divmod(np.concatenate(cells), level.width)
        window = (int(rows.min()), int(rows.max()) + 1, int(cols.min()), int(cols.max()) + 1)
        self.revision += 1
        self._journal.append(window)
        del self._journal[:-MAX_JOURNAL]
        if self._farthest is not None:
            _measure_again(level, window, self._farthest)


class Block:
    """Cells that something blocks until it is freed.

    Use it as a context manager, or call `free`.

    Attributes:
        cells: flat ids of the cells where an agent can't stand for it, by level, each ascending,
            int64; those that it couldn't stand on before included.
    """

    def __init__(self, grid: NavGrid, layers: list[Layers]) -> None:
        self.cells = [of_level[BLOCKED] for of_level in layers]
        self._held: list[tuple[SceneGrid2D, Layers]] = []
        for level, of_level in zip(grid.levels, layers, strict=True):
            if any(len(ids) for ids in of_level):
                changes_of(level).hold(level, of_level)
                self._held.append((level, of_level))

    def free(self) -> None:
        """Give the cells back, but for those that others block too. Once is enough."""
        for level, of_level in self._held:
            changes_of(level).let_go(level, of_level)
        self._held.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.free()


_CHANGES: WeakKeyDictionary[SceneGrid2D, LevelChanges] = WeakKeyDictionary()


def changes_of(level: SceneGrid2D) -> LevelChanges:
    """The changes of a level, from the first on."""
    if level not in _CHANGES:
        _CHANGES[level] = LevelChanges(level)
    return _CHANGES[level]


def known_changes(level: SceneGrid2D) -> LevelChanges | None:
    """The changes of a level; None if nothing was ever blocked there."""
    return _CHANGES.get(level)


def own_attributes(level: SceneGrid2D) -> dict[str, NDArray[Any]]:
    """The attributes for a level that is derived from this one, which may be blocked and freed."""
    attributes = dict(level.attributes)
    if known_changes(level) is not None:
        for name in CHANGING & attributes.keys():
            attributes[name] = attributes[name].copy()
    return attributes


def unblocked(grid: NavGrid) -> NavGrid:
    """The grid as it is when nothing is blocked; itself if nothing is."""
    from navbake.navgrid.grid import MultiLevelGrid

    levels = [_unblocked_level(level) for level in grid.levels]
    if all(one is other for one, other in zip(levels, grid.levels, strict=True)):
        return grid
    return replace(grid, grids=levels) if isinstance(grid, MultiLevelGrid) else levels[0]


def _unblocked_level(level: SceneGrid2D) -> SceneGrid2D:
    changes = known_changes(level)
    if changes is None or not changes.is_blocked:
        return level
    attributes = dict(level.attributes)
    if changes.occupancy is not None:
        held = changes.count[OCCUPIED] > 0
        occupancy = np.where(held, changes.occupancy, attributes["occupancy"].ravel())
        attributes["occupancy"] = occupancy.reshape(level.shape)
    weights = np.where(changes.count[BLOCKED] > 0, changes.weights, level.weights.ravel())
    return replace(
        level,
        weights=weights.reshape(level.shape),
        attributes=attributes,
        user_data=held_user_data(level),
    )


def _farthest(level: SceneGrid2D) -> float | None:
    """The largest clearance of a level, in cells; None if it has no such layer.

    In others' files ``clearance`` may mean anything: it has to be what it should be.
    """
    stored = level.attributes.get("clearance")
    if stored is None:
        return None
    measured = clearance(level)
    if stored.dtype != measured.dtype or not np.allclose(stored, measured, atol=1e-5):
        return None
    return float(measured.max(initial=0)) / level.lattice.cell_size


def _measure_again(level: SceneGrid2D, window: Window, farthest: float) -> None:
    """Measure the clearance where it may have changed.

    No cell is farther from what blocks than it was when nothing was blocked, so what is farther
    from the window than that has nothing to do with it.

    Args:
        level: its layer `clearance` is changed.
        window: where cells changed.
        farthest: the largest clearance when nothing is blocked, in cells.
    """
    reach = math.ceil(farthest) + 2
    outer, inner = (_grown(window, k * reach, level) for k in (2, 1))
    row0, row1, col0, col1 = outer
    free = level.free[row0:row1, col0:col1]
    edges = ((row0 > 0, row1 < level.height), (col0 > 0, col1 < level.width))
    cells = _to_blocked(free, edges)
    rows, cols = slice(inner[0], inner[1]), slice(inner[2], inner[3])
    here = np.s_[inner[0] - row0 : inner[1] - row0, inner[2] - col0 : inner[3] - col0]
    metres = np.where(free[here], (cells[here] - 0.5) * level.lattice.cell_size, 0.0)
    level.attributes["clearance"][rows, cols] = metres


def _to_blocked(
    free: NDArray[np.bool_], open_edges: tuple[tuple[bool, bool], tuple[bool, bool]]
) -> NDArray[np.float64]:
    """Distances to the nearest cell that isn't free, which all beyond closed edges are."""
    from scipy.ndimage import distance_transform_edt

    pad = [tuple(int(not is_open) for is_open in edge) for edge in open_edges]
    distance = distance_transform_edt(np.pad(free, pad))
    rows, cols = free.shape
    return np.asarray(distance[pad[0][0] : pad[0][0] + rows, pad[1][0] : pad[1][0] + cols])


def _grown(window: Window, by: int, level: SceneGrid2D) -> Window:
    row0, row1, col0, col1 = window
    return (
        max(row0 - by, 0),
        min(row1 + by, level.height),
        max(col0 - by, 0),
        min(col1 + by, level.width),
    )
