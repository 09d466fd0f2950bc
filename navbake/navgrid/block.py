"""Temporary blocks of a grid's cells, which change its layers in place."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.block_state import (
    BLOCKED,
    CHANGING,
    OCCUPIED,
    OCCUPIED_LAYERS,
    BlockState,
    Layers,
    Window,
)
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance

if TYPE_CHECKING:
    from typing_extensions import Self


class Block:
    """Cells that are blocked until `free` is called, or until the end of a with statement.

    Attributes:
        cells: flat ids of the cells where an agent can't stand because of the block, by level, each
            ascending, int64; including cells that were not free before.
        arguments: of `grid.block` that made it.
    """

    def __init__(
        self, grid: NavGrid, layers: list[Layers], arguments: dict[str, Any] | None = None
    ) -> None:
        self.arguments, self._grid = arguments or {}, grid
        self.copies: list[Block] = []  # on grids for agents of other sizes
        self.cells = [of_level[BLOCKED] for of_level in layers]
        self._held: list[tuple[SceneGrid2D, BlockState, Layers]] = []
        for level, of_level in zip(grid.levels, layers, strict=True):
            if any(len(ids) for ids in of_level):
                state = level.block_state = level.block_state or _begin(level)
                _change(level, state, of_level, is_held=True)
                self._held.append((level, state, of_level))
        grid.blocks.append(self)

    def free(self) -> None:
        """Free the cells, except those held by other blocks. Further calls do nothing."""
        for level, state, of_level in self._held:
            _change(level, state, of_level, is_held=False)
        self._held.clear()
        for copied in self.copies:
            copied.free()
        if self in self._grid.blocks:
            self._grid.blocks.remove(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()


def _begin(level: SceneGrid2D) -> BlockState:
    """The state of an unblocked level; the level gets writable copies of its arrays."""
    # others may share the level's arrays, or they may be read-only
    level.weights = np.array(level.weights, order="C")
    level.attributes = dict(level.attributes)
    for name in CHANGING & level.attributes.keys():
        level.attributes[name] = np.array(level.attributes[name], order="C")
    occupied = {
        name: level.attributes[name].copy() for name in OCCUPIED_LAYERS if name in level.attributes
    }
    return BlockState(level.weights.copy(), occupied, _farthest(level))


def _change(level: SceneGrid2D, state: BlockState, cells: Layers, *, is_held: bool) -> None:
    """Block or free cells."""
    count = state.count.reshape(len(cells), -1)
    for number, ids in zip(count, cells, strict=True):
        if is_held:
            number[ids] += 1
        else:
            number[ids] -= 1
    changed: list[tuple[int, NDArray[Any], NDArray[Any], float]] = [
        (BLOCKED, level.weights, state.weights, np.inf),
        *((OCCUPIED, level.attributes[name], own, 1.0) for name, own in state.occupied.items()),
    ]
    for layer, array, clean, value in changed:
        now, before, ids = array.reshape(-1), clean.reshape(-1), cells[layer]
        if is_held:
            # the first block reads the arrays again: they are writable
            first = ids[count[layer, ids] == 1]
            before[first] = now[first]
            now[first] = value
        else:
            left = ids[count[layer, ids] == 0]
            now[left] = before[left]
    # one window for all layers
    rows, cols = np.divmod(np.concatenate(cells), level.width)
    window = (int(rows.min()), int(rows.max()) + 1, int(cols.min()), int(cols.max()) + 1)
    state.note(window)
    if state.farthest is not None:
        _measure_again(level, window, state.farthest)


def _farthest(level: SceneGrid2D) -> float | None:
    """The largest clearance of a level, in cells; None without that layer."""
    stored = level.attributes.get("clearance")
    if stored is None:
        return None
    measured = clearance(level)
    # in files of other programs, a layer of this name may mean anything
    if stored.dtype != measured.dtype or not np.allclose(stored, measured, atol=1e-5):
        return None
    return float(measured.max(initial=0)) / level.lattice.cell_size


def _measure_again(level: SceneGrid2D, window: Window, farthest: float) -> None:
    """Update the clearance around a changed window of cells.

    No clearance exceeds that without blocks, `farthest` cells. So cells farther from the window
    keep theirs.
    """
    reach = math.ceil(farthest) + 2
    # the nearest blocked cell of one at the rim of `inner` may be a whole reach further out
    outer, inner = (_grown(window, k * reach, level) for k in (2, 1))
    row0, row1, col0, col1 = inner
    here = np.s_[row0 - outer[0] : row1 - outer[0], col0 - outer[2] : col1 - outer[2]]
    level.attributes["clearance"][row0:row1, col0:col1] = clearance(level, outer)[here]


def _grown(window: Window, by: int, level: SceneGrid2D) -> Window:
    row0, row1, col0, col1 = window
    rows = max(row0 - by, 0), min(row1 + by, level.height)
    return *rows, max(col0 - by, 0), min(col1 + by, level.width)
