"""What all questions of a `PathFinder` share: the grid, and what follows from it."""

from navbake.navgrid.grid import NavGrid
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.paths.planner import Planner


class Questions:
    """Questions about a grid; `PathFinder` puts those of all modules of this folder together."""

    grid: NavGrid
    _cache: GridCache
    _planner: Planner
