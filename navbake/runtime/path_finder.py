"""Plans paths on a grid, and answers questions about places on it."""

from functools import cached_property

from navbake.navgrid.grid import NavGrid
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.many import ManyPlaces
from navbake.runtime.paths.planner import Planner
from navbake.runtime.paths.search import Search
from navbake.runtime.questions.draws import DrawQuestions
from navbake.runtime.questions.paths import PathQuestions
from navbake.runtime.questions.places import PlaceQuestions


class PathFinder(PathQuestions, PlaceQuestions, DrawQuestions):
    """Answers an agent's questions about ways through a grid, and about places on it.

    A path steps over the edges and corners of free cells and over links between levels. Floors of
    neighbours differ by at most the grid's `traversableFloorHeight`. A step costs its length [m]
    times the weight of the cell that it leads to.

    Goals are a position, several of them (the one that is the cheapest to reach counts),
    ``room:NAME`` with a room's id or name, or ``object:NAME`` with a name of the user data (the
    free cells next to it). Positions are world x, y, z [m], on the level of the nearest floor
    below. With `level`, positions are on that level (0 is the lowest) and z is ignored. x, y are
    enough with `level`, or on a grid of one level. Every method raises QueryError where a
    position is not valid, or where there is no such level, room, object or island.

    One object serves one thread at a time.

    Args:
        grid: a grid of one or several levels. What is written into its arrays later is not seen;
            what `grid.block` blocks is.
        cut_corners: let diagonal steps pass blocked corners.

    Raises:
        QueryError: a weight is negative.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        self._cut_corners = cut_corners
        self.use(grid)

    def use(self, grid: NavGrid) -> None:
        """Answer about another grid from now on, as after `Baker.update`.

        What was planned and kept for the last one is forgotten.

        Raises:
            QueryError: a weight is negative.
        """
        cache = GridCache(grid, cut_corners=self._cut_corners)
        for name in ("many", "_spawner"):
            self.__dict__.pop(name, None)
        self.grid, self._cache = grid, cache
        self._planner = Planner(cache)

    @cached_property
    def many(self) -> ManyPlaces:
        """The same questions about many positions at once: `snap`, `clearance` and others."""
        return ManyPlaces(self._cache, self._planner)

    @property
    def search(self) -> Search:
        """The cells and the steps between them, with what is blocked now."""
        return self._cache.search
