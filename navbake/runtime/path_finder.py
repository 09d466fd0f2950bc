"""Plans paths on a grid, and answers queries about places on it."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.lazy import resolve
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import Agent
from navbake.runtime.draws import DrawQuestions
from navbake.runtime.passage import Passage, find_passage, why_not
from navbake.runtime.path_following import Follower
from navbake.runtime.paths import Goal, Path, find_field, find_path
from navbake.runtime.search import Search
from navbake.types import Float

# what others call the same
_MEANT = {
    "distance": "distances(starts, goal)",
    "geodesic_distance": "distances(starts, goal)",
    "get_random_navigable_point": "random_point(rng)",
    "random_navigable_point": "random_point(rng)",
    "random_points": "random_point(rng, count)",
    "is_free": "is_navigable(position)",
    "shortest_path": "find_path(start, goal)",
    "snap_point": "snap(position)",
}


class PathFinder(DrawQuestions):
    """Plans paths on a grid, and answers queries about places on it.

    A path steps over the edges and corners of free cells, to other levels where the grid has
    `steps`, and takes the grid's open `links`. Floors of neighbours differ by at most the grid's
    `traversableFloorHeight`. A step costs its length [m] times the weight of the cell that it leads
    to, and times the cost of its area. A link costs what it says, or its length; and lasts as long
    as it says, or its cost at the agent's speed.

    For an agent, the grid is inflated to its radius, and steps are as low as it takes. Cells of
    areas that bar it are not free, and links that bar it or are narrower than twice its radius
    aren't there. Without an agent, the grid is as it is, the speed is 1 m/s, all open links that
    are wide enough count, and areas bar only where their cost is infinite.

    In all methods

    - a position is world x, y, z [m], on the level of the nearest floor below. With `level`,
      positions are on that level (0 is the lowest) and z is ignored. x, y are enough with `level`,
      or on a grid of one level;
    - a goal is a position, several of them (the cheapest to reach counts), ``room:NAME``, or
      ``object:NAME`` with a name of the user data (the nearest free cells of each island within
      1 m of it);
    - a room is given by its id or name, an island by its number; 1 is the largest;
    - a place is world x, y and floor z [m], shape (3,), or (n, 3) for several, float64;
    - `rng` is a numpy Generator; None makes a new one for each call;
    - QueryError is raised for a position that is not valid, and for an unknown level, room,
      object or island.

    Not thread-safe: use one object per thread.

    Attributes:
        grid: the grid for the agent's size: that which was given, where it fits.

    Args:
        grid: a grid of one or several levels, or its file. Later writes into its arrays have no
            effect; `grid.block` has.
        cut_corners: allow diagonal steps past blocked corners.
        agent: the name of one of the grid's `agents`, or a `navbake.Agent`.

    Raises:
        QueryError: a weight is negative, or the agent is unknown, higher than the grid's or takes
            higher steps.
        FormatError: the file can't be read, or is no NavGrid.
    """

    def __init__(
        self,
        grid: NavGrid | str | os.PathLike[str],
        *,
        cut_corners: bool = False,
        agent: str | Agent | None = None,
    ) -> None:
        self._cut_corners = cut_corners
        self._agent = agent
        self.use(grid)

    def use(self, grid: NavGrid | str | os.PathLike[str]) -> None:
        """Switch to another grid, as after `Baker.update`."""
        if isinstance(grid, str | os.PathLike):
            read: NavGrid = resolve("navbake.formats.navgrid:read_navgrid")(grid)
        else:
            read = grid
        self._search = Search(read, cut_corners=self._cut_corners, agent=self._agent)
        self.grid = self._search.grid

    @property
    def agent(self) -> Agent | None:
        """Who plans; None for the grid's own agent."""
        return self._search.agent

    def __getattr__(self, name: str) -> Any:
        meant = f": write `{_MEANT[name]}`" if name in _MEANT else ""
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}{meant}")

    def __repr__(self) -> str:
        count = self.islands.count
        area = self.navigable_area
        return f"PathFinder({self.grid.scene_id!r}, {area:.1f} m² free, islands: {count})"

    def _repr_html_(self) -> str:
        return self.grid._repr_html_()

    def _repr_png_(self) -> bytes:
        return self.grid._repr_png_()

    def find_path(
        self,
        start: ArrayLike,
        goal: Goal,
        *,
        level: int | None = None,
        by: str = "cost",
        smooth: bool = True,
    ) -> Path | None:
        """Find the cheapest path; None if there is none, for the reason that `why_not` returns.

        By ``time``, the quickest: steps last their length over the agent's speed or their area's,
        whatever they cost.

        If `smooth`, it is pulled straight where that stays free; else it runs through the cells'
        centres. It begins and ends at the given positions, unless they are nearer to obstacles
        than the agent may be.
        """
        return find_path(self.search, start, goal, level, by=by, smooth=smooth)

    def why_not(self, start: ArrayLike, goal: Goal, *, level: int | None = None) -> str | None:
        """Say in one sentence why there is no path; None if there is one.

        The sentence names a start or goal that isn't free, with the nearest free cell; else the
        islands of both, and the first obstacle found of these: blocked cells, doors, the first link
        or area that the path would use if all were open, a gap that is too narrow, blocked steps
        between levels, and things in between by name.
        """
        return why_not(self.search, start, goal, level)

    def distance_field(
        self, goal: Goal, *, level: int | None = None, weighted: bool = True, by: str = "cost"
    ) -> list[Float]:
        """Compute the cost of the cheapest path from every cell to the goal.

        If `weighted`, as in `find_path`; else the length of the shortest path [m], on which links
        count what they cost; by ``time``, the seconds of the quickest. One array a level, shape
        (height, width), float64, inf where no path leads to the goal; read-only. Raises a
        QueryError for lengths by ``time``.
        """
        field = find_field(self.search, goal, level, weighted=weighted, by=by)
        flat = self._search.flat
        return [field[flat.cells_of(k)].reshape(v.shape) for k, v in enumerate(self.grid.levels)]

    def distances(
        self,
        starts: ArrayLike,
        goal: Goal | None = None,
        *,
        goals: Sequence[Goal] | None = None,
        level: int | None = None,
        weighted: bool = True,
        by: str = "cost",
    ) -> Float:
        """Look up `distance_field` at starts of shape (..., 3): shape (...), inf for no path.

        With m `goals`, the distances from each start to each goal: shape (..., m). The fields of
        the last few goals are cached.
        """
        if (goal is None) == (goals is None):
            raise QueryError("expected a goal, or goals=[…], one of them")
        asked: Sequence[Any] = [goal] if goals is None else goals
        cells = self.search.flat.cells_at(starts, level)
        found = np.full((*cells.shape, len(asked)), np.inf)
        for k, one in enumerate(asked):
            field = find_field(self._search, one, level, weighted=weighted, by=by)
            found[..., k] = np.where(cells >= 0, field[cells], np.inf)
        return found[..., 0] if goals is None else found

    def max_radius(
        self, start: ArrayLike, goal: Goal, *, level: int | None = None, ledges: str = "avoid"
    ) -> Passage | None:
        """Find the widest agent that can get from a place to a goal, and its bottleneck.

        ``find_path`` finds a path on ``grid.inflate(radius)`` for every radius up to this one, and
        for no larger one; `ledges` as there. Current blocks, and the agent's rights but not its
        size count. The result for an inflated grid is that of the grid before, if the file has it.
        None if not even a point gets there. Raises QueryError if start or goal is outside the grid
        or occupied, or if the goal is an object.
        """
        return find_passage(self.search, start, goal, level, ledges)

    def follow(
        self,
        path: Path,
        *,
        speed: float = 0.5,
        acceleration: float = 1.0,
        turn_rate: float = 1.5,
        lookahead: float = 0.4,
        tolerance: float = 0.05,
    ) -> Follower:
        """Follow a path with a mobile base: velocities or waypoints, step by step.

        The base stays within some centimetres of the path, so plan it on a grid that is inflated
        for a radius larger by that much.

        Args:
            path: a path found by this object.
            speed: the highest [m/s].
            acceleration: of braking [m/s²].
            turn_rate: the highest [rad/s].
            lookahead: distance along the path to the point that the base heads for [m].
            tolerance: distance to the goal at which the base has arrived [m].
        """
        if not isinstance(path, Path):
            raise QueryError(f"expected a path that find_path has found, got {path!r}")
        limits = {
            "speed": speed, "acceleration": acceleration, "turn_rate": turn_rate,
            "lookahead": lookahead, "tolerance": tolerance,
        }  # fmt: skip
        return Follower(self._search, path, limits)


def plan_path(
    grid: NavGrid,
    start: ArrayLike,
    goal: Goal,
    *,
    level: int | None = None,
    by: str = "cost",
    smooth: bool = True,
    agent: str | Agent | None = None,
) -> Path | None:
    """Find the cheapest path on a grid, see `PathFinder.find_path`.

    Each call prepares the whole grid; use a `PathFinder` for many queries.
    """
    finder = PathFinder(grid, agent=agent)
    return finder.find_path(start, goal, level=level, by=by, smooth=smooth)
