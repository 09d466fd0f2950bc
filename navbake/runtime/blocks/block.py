"""Blocks cells of a grid for a while, for things that move, and frees them again."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

from navbake.navgrid.block_state import BLOCKED, BlockState, Layers

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.navgrid.grid import NavGrid, SceneGrid2D


class Block:
    """Cells that something blocks until it is freed.

    Use it as a context manager, or call `free`.

    Attributes:
        cells: flat ids of the cells where an agent can't stand for it, by level, each ascending,
            int64; those that it couldn't stand on before included.
    """

    def __init__(self, grid: NavGrid, layers: list[Layers]) -> None:
        self.cells = [of_level[BLOCKED] for of_level in layers]
        self._held: list[tuple[SceneGrid2D, BlockState, Layers]] = []
        for level, of_level in zip(grid.levels, layers, strict=True):
            if any(len(ids) for ids in of_level):
                if level.block_state is None:
                    level.block_state = BlockState(level)
                level.block_state.hold(level, of_level)
                self._held.append((level, level.block_state, of_level))

    def free(self) -> None:
        """Give the cells back, but for those that others block too. Once is enough."""
        for level, state, of_level in self._held:
            state.release(level, of_level)
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
