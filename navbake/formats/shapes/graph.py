"""A grid as a graph, of its cells or of its rooms."""

from __future__ import annotations

from navbake.errors import QueryError
from navbake.formats.shapes.cell_graph import CellGraph, make_cell_graph
from navbake.formats.shapes.room_graph import RoomGraph, make_room_graph
from navbake.navgrid.grid import NavGrid


def make_graph(
    grid: NavGrid, kind: str = "cells", *, cut_corners: bool = False
) -> CellGraph | RoomGraph:
    """Make the graph of a grid's cells (``cells``) or rooms (``rooms``), as they are now.

    Args:
        grid: a grid of one or several levels.
        kind: see `make_cell_graph` and `make_room_graph`.
        cut_corners: let diagonal steps pass blocked corners; of ``cells``.

    Raises:
        QueryError: the kind is unknown, or a weight is negative.
    """
    if kind == "cells":
        return make_cell_graph(grid, cut_corners=cut_corners)
    if kind == "rooms":
        return make_room_graph(grid)
    raise QueryError(f"expected cells or rooms as kind of graph, got {kind!r}")
