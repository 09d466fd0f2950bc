"""How well agents did: measures of trajectories against the episodes of a set.

`Measures` follows one episode step by step, and `score_set` scores the trajectories of a set. The
functions of arrays compute by numpy, or by the module `xp`, ``jax.numpy`` or ``torch``, without
branches on values.

Distances [m] are those of `PathFinder` over cells, from the cell of a position to the nearest place
of the goal; in a cell where no agent can stand, from the nearest free cell and to it. Success and
SPL use the same distances.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from navbake.episodes.episode import EDGES, Episode, EpisodeSet, named_agent, scene_of
from navbake.episodes.formats import decode
from navbake.episodes.goals import SNAP, find_stops, path_through
from navbake.errors import FormatError, QueryError
from navbake.formats.npz import open_archive
from navbake.formats.source import read_bytes, unpack
from navbake.navgrid.grid import NavGrid
from navbake.runtime.blocking import fit_grid
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.places import snap
from navbake.types import Float, Json

THRESHOLD = 3.0  # of nDTW, as VLN-CE has it [m]
SAMPLES = 1000  # of a bootstrap
ARRIVED = 1e-6  # metres by which a step may miss its end
MEANS = (
    "success", "spl", "soft_spl", "distance", "oracle_success", "ndtw", "length", "collisions",
    "time", "coverage",
)  # fmt: skip
"""The measures of an episode of which a table has means."""
REQUIRED = ("episode", "start", "positions")  # arrays of trajectories
GROUPS = ("all", "distance", "ratio", "room", "scene", "split")


def success(distance: Any, radius: Any, stopped: Any, *, xp: Any = np) -> Any:
    """1.0 where the agent stopped within the radius, else 0.0; a NaN distance is no success."""
    one = xp.ones_like(distance)
    none = xp.zeros_like(distance)
    return xp.where((distance <= radius) & stopped, one, none)


def spl(succeeded: Any, shortest: Any, length: Any, *, xp: Any = np) -> Any:
    """Success S weighted by the agent's path length p and the shortest one's l: S l / max(l, p).

    All have the shape (...). 0 where S is 0; S where l is 0; NaN where S is 1 and l is not finite.

    Source: Anderson et al., "On Evaluation of Embodied Navigation Agents" (2018).
    """
    return xp.where(succeeded > 0, succeeded * _efficiency(shortest, length, xp), succeeded * 0.0)


def soft_spl(distance: Any, shortest: Any, length: Any, *, xp: Any = np) -> Any:
    """Progress weighted by path length: max(0, 1 - d / l) l / max(l, p).

    d is the distance at the end [m]; the others as in `spl`. Where l is 0, 1 if d is 0, else 0;
    NaN where l or d is not known.

    Source: Datta et al., "Integrating Egocentric Localization" (2020).
    """
    whole = xp.where(shortest > 0, shortest, xp.ones_like(shortest))
    left = xp.where(shortest > 0, distance / whole, xp.where(distance > 0, 1.0, distance))
    progress = xp.where(left > 1, xp.zeros_like(left), 1.0 - left)
    return progress * _efficiency(shortest, length, xp)


def _efficiency(shortest: Any, length: Any, xp: Any) -> Any:
    """L / max(l, p), 1 where l is 0, NaN where l is not finite."""
    is_known = xp.isfinite(shortest)
    least = xp.where(is_known & (shortest > 0), shortest, xp.ones_like(shortest))
    ratio = least / xp.where((length > least) & (shortest > 0), length, least)
    return xp.where(is_known, ratio, xp.full_like(ratio, math.nan))


def path_length(positions: ArrayLike) -> float:
    """Length of the straight moves between positions, shape (n, 3) [m]; 0 for one or none."""
    p = np.asarray(positions, dtype=np.float64)
    return float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum()) if len(p) > 1 else 0.0


def ndtw(path: Any, reference: Any, threshold: float = THRESHOLD, *, xp: Any = np) -> Any:
    """exp(-DTW / (n threshold)) of a path and a reference of n points, shapes (m, 3) and (n, 3).

    DTW is the least sum of distances over matches that keep the order; NaN without points.

    Source: Ilharco et al., "General Evaluation for Instruction Conditioned Navigation using
    Dynamic Time Warping" (2019).
    """
    p = xp.asarray(path)
    q = xp.asarray(reference)
    if not len(p) or not len(q):
        return math.nan
    few, many = (p, q) if len(p) < len(q) else (q, p)
    apart = xp.sqrt(((few[:, None] - many) ** 2).sum(-1))
    i = xp.arange(len(few))
    n = len(many)
    before = last = xp.full_like(apart[:, 0], math.inf)
    # cells of one anti-diagonal, by their row, depend on the two before it alone
    for diagonal in range(len(few) + n - 1):
        j = diagonal - i
        above = xp.minimum(xp.minimum(last, last[i - 1]), before[i - 1])
        best = xp.where(i > 0, above, last) if diagonal else xp.zeros_like(last)
        cost = xp.where((j >= 0) & (j < n), apart[i, xp.clip(j, 0, n - 1)], math.inf)
        before = last
        last = cost + best
    return xp.exp(-last[-1] / (len(q) * threshold))


class Interval(NamedTuple):
    """A mean and its confidence interval; NaN of no values."""

    mean: float
    low: float
    high: float
    known: int  #: Number of values that are no NaN.


def bootstrap(
    values: ArrayLike, *, seed: int = 0, samples: int = SAMPLES, certainty: float = 0.95
) -> Interval:
    """Mean of values and its percentile bootstrap interval; NaN values are left out."""
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[~np.isnan(known)]
    if not len(known):
        return Interval(math.nan, math.nan, math.nan, 0)
    rng = np.random.default_rng(seed)
    means = [known[rng.integers(len(known), size=len(known))].mean() for _ in range(samples)]
    low, high = np.quantile(means, [(1 - certainty) / 2, (1 + certainty) / 2])
    return Interval(float(known.mean()), float(low), float(high), len(known))


class Measures:
    """Follows one episode step by step, from the episode's start.

    Args:
        finder: of the set's grid, inflated for its agent.
        episode: the task.
        threshold: of nDTW [m].

    Raises:
        QueryError: no agent can get to the goal on this grid, or the start is in no cell.
    """

    def __init__(
        self, finder: PathFinder, episode: Episode, *, threshold: float = THRESHOLD
    ) -> None:
        self.finder = finder
        self.episode = episode
        self.threshold = threshold
        self.share = episode.goals[0].share
        self.radius = episode.goals[0].radius
        goals = episode.goals
        in_order = episode.task == "sequence"
        # many episodes of a set have the goals of the last one
        find = functools.partial(find_stops, finder, goals, in_order=in_order)
        stops = finder.search.cached("stops", (goals, in_order), find)
        if stops is None:
            raise QueryError(f"no agent can stand at the goal of episode {episode.id!r}")
        self._stops = stops
        self._passed = 0
        self._positions = [np.array(episode.start)]
        self._times = list[float]()
        self._distances = self._measure(self._positions[0][None], "start")
        self.shortest = self._distances[0]

    @property
    def distance(self) -> float:
        """Length of the shortest path to the goal, through all that are still ahead [m]."""
        return self._distances[-1]

    def step(self, position: ArrayLike, time: float | None = None) -> float:
        """Add the agent's position, world x, y, z [m], and its time [s]; returns `distance`."""
        self.steps(np.asarray(position, dtype=np.float64)[None], None if time is None else [time])
        return self.distance

    def steps(self, positions: ArrayLike, times: Sequence[float] | None = None) -> None:
        """Add many positions, shape (n, 3)."""
        p = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
        self._distances += self._measure(p, "position")
        self._positions += list(p)
        self._times += [] if times is None else [float(t) for t in times]

    def _measure(self, p: Float, what: str) -> list[float]:
        """The distance at each position; goes on to the next goal where one is reached."""
        bad = np.flatnonzero(~np.isfinite(p).all(axis=1))
        flat = self.finder.search.flat
        name = self.episode.id
        if len(bad):
            raise QueryError(f"expected finite numbers at {what} {bad[0]} of episode {name!r}")
        cells = flat.cells_at(p)
        if (cells < 0).any():
            k = int(np.argmax(cells < 0))
            where = ", ".join(f"{v:g}" for v in p[k])
            raise QueryError(f"{what} {k} of episode {name!r}, {where}, lies beside the grid")
        fields = self._stops.fields
        rest = self._stops.rest
        if not fields:
            return [math.nan] * len(p)
        aside = np.zeros(len(p))
        blocked = np.flatnonzero(~flat.free[cells])
        if len(blocked):
            near, found = snap(flat, flat.free, p[blocked], max_distance=SNAP)
            cells[blocked] = np.where(found >= 0, found, cells[blocked])
            away = np.linalg.norm(near - p[blocked], axis=1)
            aside[blocked] = np.where(found >= 0, away, math.inf)
        distances = []
        for cell, more in zip(cells.tolist(), aside.tolist(), strict=True):
            left = float(fields[self._passed][cell]) + more
            while left <= self.radius and self._passed < len(fields) - 1:
                self._passed += 1
                left = float(fields[self._passed][cell]) + more
            distances.append(left + rest[self._passed])
        return distances

    def scores(self, *, stopped: bool) -> Json:
        """`MEANS` and the length of the ``shortest`` path; NaN where one has no meaning."""
        way = np.array(self._positions)
        places = self._stops.places
        times = self._times
        lengths = path_length(way), self.distance, self.shortest
        length, distance, shortest = map(np.array, lengths)
        coverage = math.nan if self.share is None else self._coverage(way)
        if self.share is not None:
            ends_at = best_at = 0.0 if coverage >= self.share else math.inf
        elif self.episode.extra.get("success") == "planar":
            goals = np.array([g.position for g in self.episode.goals if g.position is not None])
            on_map = np.linalg.norm((way[:, None] - goals)[..., :2], axis=-1).min(axis=1)
            ends_at = on_map[-1]
            best_at = on_map.min()
        else:
            ends_at = self.distance
            best_at = np.min(self._distances)
        reached = success(np.array(ends_at), self.radius, stopped)
        reference = self.episode.path if places else ()
        if places and not reference:
            reference = path_through(self.finder, self.episode.start, places).get("path", ())
        # moves that no agent can make straight, as they begin in or meet a cell that isn't free
        starts = way[:-1]
        ends = way[1:]
        flat = self.finder.search.flat
        is_free = flat.free[flat.cells_at(starts)]
        arrived = self.finder.try_step(starts[is_free], ends[is_free], slide=False)
        off = np.abs(arrived - ends[is_free])[:, :2].max(axis=1, initial=0.0)
        found = {
            "success": reached,
            "spl": spl(reached, shortest, length) if places else math.nan,
            "soft_spl": soft_spl(distance, shortest, length),
            "distance": distance,
            "oracle_success": success(np.array(best_at), self.radius, True),
            "ndtw": ndtw(way, reference, self.threshold),
            "length": length,
            "collisions": (~is_free).sum() + (off > ARRIVED).sum(),
            "time": times[-1] - times[0] if times else math.nan,
            "coverage": coverage,
            "shortest": shortest,
        }
        return {key: float(value) for key, value in found.items()}

    def _coverage(self, way: Float) -> float:
        """Share of the start's island within the radius along the floor of where the agent was."""
        search = self.finder.search
        flat = search.flat
        number = search.islands.number
        home = number[flat.cells_at(way[0])]
        cells = np.unique(flat.cells_at(way))
        cells = cells[(number[cells] == home) & (home > 0)]
        if not len(cells):
            return 0.0
        field = search.field(cells, by="length", backwards=False)
        near = (field <= self.radius) & (number == home)
        size = flat.layout.cell_size[flat.level_of(np.flatnonzero(near))]
        return float((size**2).sum() / search.islands.areas[home])


class Trajectory(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where an agent was in one episode."""

    episode: str  #: The episode's id.
    positions: Sequence[tuple[float, float, float]]  #: World x, y, z [m]; maybe none.
    stop: bool = True  #: Whether the agent called stop.
    times: Sequence[float] | None = None  #: Of the positions [s].


def read_trajectories(path: str | os.PathLike[str]) -> list[Trajectory]:
    """Read trajectories: JSON lines, one each with the fields of `Trajectory`, or an ``.npz``.

    The archive has the arrays ``episode`` (ids, shape (k,)), ``start`` (int, shape (k + 1,)),
    ``positions`` (shape (n, 3); those of trajectory i are ``start[i]:start[i + 1]``), and maybe
    ``stop`` (bool, shape (k,)) and ``times`` (shape (n,)).

    Raises:
        FormatError: it is neither, or empty.
    """
    if not os.fspath(path).lower().endswith(".npz"):
        packed, name = read_bytes(path)
        lines = [line for line in unpack(packed, name).splitlines() if line.strip()]
        if not lines:
            raise FormatError(f"expected trajectories in {name}, got none")
        return [decode(line, Trajectory, f"{name}, line {k}") for k, line in enumerate(lines, 1)]
    wanted = "arrays episode (k), start (k + 1) and positions (n, 3)"
    with open_archive(os.fspath(path), wanted) as archive:
        ids, start, points = (archive.read(key, archive.top) for key in REQUIRED)
        stop = archive.read("stop", archive.top) if "stop" in archive else None
        times = archive.read("times", archive.top) if "times" in archive else None
        fits = start.shape == (len(ids) + 1,) and points.ndim == 2 and points.shape[1] == 3
        fits &= stop is None or stop.shape == ids.shape
        fits &= times is None or times.shape == points.shape[:1]
        if not len(ids):
            raise ValueError("no trajectories")
        if not fits or start[0] != 0 or start[-1] != len(points) or (np.diff(start) < 0).any():
            raise ValueError("arrays of other shapes")
        return [
            Trajectory(
                episode=str(ids[k]), positions=points[a:b].astype(np.float64).tolist(),
                stop=stop is None or bool(stop[k]),
                times=None if times is None else times[a:b].astype(np.float64).tolist(),
            )
            for k, (a, b) in enumerate(pairwise(start.tolist()))
        ]  # fmt: skip


def score_set(
    content: EpisodeSet,
    trajectories: Iterable[Trajectory],
    grids: NavGrid | Sequence[NavGrid],
    *,
    threshold: float = THRESHOLD,
    force: bool = False,
    partial: bool = False,
) -> list[Json]:
    """Score trajectories: a row for each of the set's episodes, in its order.

    Args:
        content: the set.
        trajectories: one for each episode.
        grids: that the set was made on; they are inflated for its agent if need be.
        threshold: of nDTW [m].
        force: score on other grids, or for another agent.
        partial: leave out episodes without a trajectory.

    Returns:
        Rows with ``episode``, ``scene``, ``room``, ``split``, ``ratio`` and `Measures.scores`.

    Raises:
        QueryError: a grid isn't the set's, an episode has no trajectory, a trajectory has no
            episode or leaves the map.
    """
    by_id: dict[str, Trajectory] = {}
    for trajectory in trajectories:
        if trajectory.episode in by_id:
            raise QueryError(f"expected one trajectory of episode {trajectory.episode!r}, got two")
        by_id[trajectory.episode] = trajectory
    chosen = [e for e in content.episodes if e.id in by_id]
    if unknown := by_id.keys() - {e.id for e in chosen}:
        raise QueryError(f"the set has no episode {min(unknown)!r} as a trajectory has")
    if len(chosen) < len(content) and not partial:
        first = next(e.id for e in content.episodes if e.id not in by_id)
        missing = f"{len(content) - len(chosen)} of {len(content)} episodes have no trajectory"
        hint = "or score a part of the set (--partial, partial=True)"
        raise QueryError(
            f"{missing}, as {first!r}: a run that failed counts as an empty one, {hint}"
        )
    agent = content.header.agent
    finders: dict[str, PathFinder] = {}
    for given in [grids] if not isinstance(grids, Sequence) else grids:
        name, radius = (None, None) if agent is None else (agent.name or None, agent.radius)
        planner = named_agent(given, name, radius)
        grid = given if force else fit_grid(given, planner)
        if not force:
            content.check_grid(grid)
        finders[scene_of(grid)] = PathFinder(grid, agent=planner.of_any_size() if name else None)
    rows = []
    for episode in chosen:
        if episode.scene not in finders:
            raise QueryError(f"no grid of {episode.scene!r}, the scene of episode {episode.id!r}")
        trajectory = by_id[episode.id]
        times = trajectory.times
        if times is not None and len(times) != len(trajectory.positions):
            raise QueryError(f"expected a time for each position of episode {episode.id!r}")
        measures = Measures(finders[episode.scene], episode, threshold=threshold)
        measures.steps(np.array(trajectory.positions, dtype=np.float64), times)
        facts = {key: getattr(episode, key) for key in ("scene", "room", "split", "ratio")}
        found = measures.scores(stopped=trajectory.stop)
        rows.append({"episode": episode.id} | facts | found)
    return rows


def summarize(rows: Sequence[Mapping[str, Any]], by: str = "all", *, seed: int = 0) -> list[Json]:
    """Means of groups of rows: the ``group``, its number of ``episodes``, `Interval`s by measure.

    ``distance`` groups by classes of the shortest path's length, ``ratio`` by classes of that over
    the straight line's. Infinite values are left out. Raises QueryError for an unknown group.
    """
    if by not in GROUPS:
        raise QueryError(f"expected one of {', '.join(GROUPS)} to group by, got {by!r}")
    groups: dict[str, list[Mapping[str, Any]]] = {}
    if by in ("distance", "ratio"):
        edges = {"distance": (0.0, *EDGES["distance"]), "ratio": EDGES["ratio"]}[by]
        unit = " m" if by == "distance" else ""
        names = [f"{low:g} to {high:g}{unit}" for low, high in pairwise(edges)]
        names = ["-", *names, f"{edges[-1]:g} and more{unit}"]
        values = [row["shortest" if by == "distance" else by] for row in rows]
        numbers = np.array([math.nan if v is None else v for v in values], dtype=float)
        found = np.searchsorted(edges, numbers, side="right") * ~np.isnan(numbers)
        for number in np.unique(found).tolist():
            groups[names[number]] = [row for row, k in zip(rows, found, strict=True) if k == number]
    else:
        for row in rows:
            groups.setdefault("all" if by == "all" else str(row[by]), []).append(row)
    summaries = []
    for name, members in groups.items():
        means = {}
        for key in MEANS:
            column = np.array([row[key] for row in members], dtype=float)
            means[key] = bootstrap(np.where(np.isinf(column), np.nan, column), seed=seed)
        summaries.append({"group": name, "episodes": len(members), **means})
    return summaries
