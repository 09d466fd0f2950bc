"""Whether what agents go along is free: paths, drops and jumps with landings, shafts of lifts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import fcl
import mujoco
import numpy as np

from navbake.baker.scene.names import body_name, find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene
from navbake.errors import FormatError
from navbake.navgrid.grid import GridBase, NavGrid
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import Link
from navbake.runtime.path_finder import PathFinder
from navbake.types import Float, Int
from navbake.verifier.cells import rounding
from navbake.verifier.probes import TOUCHES, Column, Probes
from navbake.verifier.report import LINK_TOUCHES, NO_LANDING, PATH_TOUCHES, Finding, SweepCounts
from navbake.verifier.sample import SLACK, AgentSizes, Neighbourhood

MOST_TRIES = 20  # a path, to find two places that are apart
CORNER = 1e-6  # a line is no longer than this in a cell whose corner it runs through [m]
LEVEL = 1e-4  # pieces whose floors differ by less are swept as one [m]
CROSSED = ("drop", "jump")  # kinds of links whose way runs straight from stop to stop
STEP = 0.02  # between the positions of a car that are looked at [m]


class Stretch(NamedTuple):
    """A straight part of a path on one floor, from above."""

    a: Float
    b: Float
    floor: float
    low: float  # the lowest floor under the cylinder, within a step [m]
    high: float  # and the highest
    level: int


class Sweep:
    """Sweeps a cylinder along paths on a grid that is inflated for it.

    It is as high as the agent, less a step at its lower end, and has to touch nothing between the
    heights that all floors under it leave free; what it meets beyond is counted by itself.
    """

    def __init__(
        self, grid: NavGrid, probes: Probes, body: AgentSizes, radius: float, tolerance: float
    ) -> None:
        self._grid = grid
        self._probes = probes
        self._body = body
        self._radius = radius
        self._tolerance = tolerance
        self._around = Neighbourhood(grid, body.step)

    def run(self, number: int, seed: int) -> tuple[SweepCounts, list[Finding]]:
        """Plan so many paths between random places, and sweep along each."""
        counts = SweepCounts(self._radius)
        findings = list[Finding]()
        finder = PathFinder(self._grid)
        rng = np.random.default_rng(seed)
        for _ in range(number * MOST_TRIES):
            start = finder.random_point(rng) if counts.paths < number else None
            if start is None:
                break
            goal = finder.random_point(rng, reachable_from=start)
            path = None if goal is None else finder.find_path(start, goal)
            if path is None or path.length == 0.0:
                continue
            found, beside = self._along(path.positions, path.levels)
            counts.paths += 1
            counts.length += path.length
            counts.beside += beside
            findings += found
        counts.touching = len(findings)
        counts.length = round(counts.length, 6)
        return counts, findings

    def _along(self, positions: Float, levels: Int) -> tuple[list[Finding], bool]:
        """The first touch along a path, and whether it meets anything within a step of its ends."""
        beside = False
        step = self._body.step
        height = self._body.height
        for piece in self._pieces(positions, levels):
            sure = piece.high + step, piece.low + height
            whole = piece.floor + step, piece.floor + height
            if touched := self._touch(piece, sure):
                name = self._probes.obstacles.name(touched[0])
                depth = touched[1] + self._tolerance
                x, y = ((piece.a + piece.b) / 2).tolist()
                lattice = self._grid.levels[piece.level].lattice
                row, col = (int(v) for v in lattice.rows_cols([x, y]))
                text = f"a cylinder of {self._radius:g} m on a path runs {depth:.4f} m into "
                text += f"{name!r}, between {sure[0]:.3f} and {sure[1]:.3f} m"
                cell = (piece.level, (row, col))
                place = (x, y, piece.floor)
                return [Finding(PATH_TOUCHES, *cell, place, text, name, depth)], beside
            beside = beside or (sure != whole and self._touch(piece, whole) is not None)
        return [], beside

    def _pieces(self, positions: Float, levels: Int) -> list[Stretch]:
        """A path cut where it goes from cell to cell, pieces of one floor put together."""
        pieces: list[Stretch] = []
        lattices = [level.lattice for level in self._grid.levels]
        for k, (a, b) in enumerate(pairwise(positions)):
            if np.hypot(*(b - a)[:2]) < CORNER:
                continue  # a step up or down between the floors on both sides
            lattice = lattices[int(levels[k])]
            times = _cuts(lattice, a, b)
            points = a[:2] + np.outer(times, b[:2] - a[:2])
            middles = (points[1:] + points[:-1]) / 2
            between = (times[1:] + times[:-1]) / 2
            between = a[2] + between * (b[2] - a[2])
            on = sorted({int(levels[k]), int(levels[k + 1])})
            cells = [(number, *lattices[number].rows_cols(middles)) for number in on]
            # where it goes from one level to another, the nearer of their floors counts
            found = np.stack([self._around.look(cell[0], *cell)[0] for cell in cells])
            gaps = np.nan_to_num(np.abs(found - between), nan=np.inf)
            best = gaps.argmin(axis=0)
            floor = np.take_along_axis(found, best[None], axis=0)[0]
            floor = np.where(np.isnan(floor), between, floor)
            reach = self._radius + lattice.cell_size * np.sqrt(0.5)
            under = [self._around.floors_under(*cell, floor, reach) for cell in cells]
            for n, which in enumerate(best.tolist()):
                low, high = under[which]
                heights = float(floor[n]), float(low[n]), float(high[n])
                last = pieces[-1] if n else None
                if last and last.level == on[which] and np.allclose(last[2:5], heights, 0, LEVEL):
                    pieces[-1] = last._replace(b=points[n + 1])
                else:
                    pieces.append(Stretch(points[n], points[n + 1], *heights, on[which]))
        return pieces

    def _touch(self, piece: Stretch, band: tuple[float, float]) -> tuple[int, float] | None:
        """The first obstacle that the cylinder touches on a piece, and how deep [m]."""
        half_z = (band[1] - band[0]) / 2 - self._tolerance
        radius = self._radius - self._tolerance
        z = (band[0] + band[1]) / 2
        if half_z <= 0:
            return None
        way = piece.b - piece.a
        middle = (piece.a + piece.b) / 2
        disc = Column(radius, radius, half_z, True)
        yaw = float(np.arctan2(way[1], way[0]))
        between = Column(float(np.hypot(*way)) / 2, radius, half_z, False, yaw)
        low = np.minimum(piece.a, piece.b) - radius
        high = np.maximum(piece.a, piece.b) + radius
        box_low = np.array([*low, z - half_z])
        box_high = np.array([*high, z + half_z])
        for number in self._probes.obstacles.meeting(box_low, box_high):
            for column, at in ((disc, piece.a), (disc, piece.b), (between, middle)):
                center = np.array([*at, z])
                if self._probes.touches(number, column, center) == TOUCHES:
                    return number, self._probes.depth(column, center, number)
        return None


def _cuts(lattice: Lattice, a: Float, b: Float) -> Float:
    """Where a line goes from cell to cell, as shares of its length from 0 to 1."""
    times = np.array([0.0, 1.0])
    corner = np.array([lattice.x_min, lattice.y_max])
    for first, last in zip(*((p[:2] - corner) / lattice.cell_size for p in (a, b)), strict=True):
        edges = np.arange(np.floor(min(first, last)) + 1, np.ceil(max(first, last)))
        times = np.append(times, (edges - first) / (last - first or 1.0))
    times = np.unique(times)
    # a line through a corner of cells is in none of those beside
    return np.asarray(times[np.diff(times, append=2.0) > CORNER / np.hypot(*(b - a)[:2])])


def check_links(
    grid: GridBase, scene: Scene, probes: Probes, body: AgentSizes, tolerance: float
) -> tuple[list[Finding], list[str]]:
    """Check the links of a grid: drops and jumps for the agent, lifts that the bake found.

    The agent's column has to touch nothing over each cell between the stops of a drop or a jump,
    over the higher of both floors, and down to the landing; whose floor has to be a surface. The
    car of a lift has to touch nothing on its way between the ends of its joint's range. Returns
    notes of the lifts whose car isn't found, too.
    """
    try:
        links = grid.links
    except FormatError:  # what an audit reports
        return [], []
    findings = list[Finding]()
    notes = list[str]()
    model = scene.model
    names = [body_name(model, number) for number in range(model.nbody)] if links else []
    for link in links:
        if link.kind in CROSSED and len(link.stops) == 2:
            findings += _check_crossing(link, grid, probes, body, tolerance)
        elif link.kind == "lift" and link.auto:
            # the car is the body of its name, or the one that the bake numbered
            for name in (link.name, link.name.rpartition("#")[0]):
                car = names.index(name) if name in names else 0
                joint = int(model.body_jntadr[car])
                if joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                    findings += _check_shaft(link, car, grid, scene, probes, tolerance)
                    break
            else:
                notes.append(f"lift {link.name!r} was not checked: no body of its name slides")
    return findings, notes


def _check_crossing(
    link: Link, grid: GridBase, probes: Probes, body: AgentSizes, tolerance: float
) -> Iterator[Finding]:
    levels = [grid.levels[stop.level] for stop in link.stops]
    cells = [divmod(s.cell, v.width) for s, v in zip(link.stops, levels, strict=True)]
    ends = [v.lattice.positions(*cell) for v, cell in zip(levels, cells, strict=True)]
    cell_size = levels[0].lattice.cell_size
    count = max(round(float(np.abs(ends[1] - ends[0]).max()) / cell_size), 1)
    line = ends[0] + np.linspace(0.0, 1.0, count + 1)[:, None] * (ends[1] - ends[0])
    # up to where, and from where on, one walks on the floors of both ends
    walks = []
    for level, places in zip(levels, (line, line[::-1]), strict=True):
        rows, cols = level.lattice.rows_cols(places)
        inside = level.lattice.holds(rows, cols)
        rows = rows[inside]
        cols = cols[inside]
        floor = level.floor_of(rows, cols)
        step = np.abs(np.diff(floor, prepend=floor[:1])) > body.step + SLACK
        stops = ~level.free[rows, cols] | np.isnan(floor) | step
        last = int(np.argmax(np.append(stops, True))) - 1
        walks.append((last, float(floor[max(last, 0)])))
    (first, start), (back, z) = walks
    crossed = line[max(first, 0) : len(line) - max(back, 0)]
    if len(crossed) < 2:  # one walks all the way
        return
    top = max(start, z)
    lows = np.full(len(crossed), top)
    lows[[0, -1]] = start, z  # over the ends, from their floors on
    half = cell_size / 2
    for (x, y), low in zip(crossed.tolist(), lows.tolist(), strict=True):
        band = low + body.step + tolerance, top + body.height - tolerance
        center = np.array([x, y, sum(band) / 2])
        half_z = (band[1] - band[0]) / 2
        columns = [Column(half, half, half_z, False)]
        columns += [Column(body.radius, body.radius, half_z, True)] if body.radius > half else []
        reach = np.array([max(half, body.radius)] * 2 + [half_z])
        for number in probes.obstacles.meeting(center - reach, center + reach):
            if any(probes.touches(number, c, center, -tolerance) == TOUCHES for c in columns):
                name = probes.obstacles.name(number)
                text = f"{link.kind} {link.name!r} runs into {name!r}"
                yield _finding(LINK_TOUCHES, link, grid, (x, y, low), text, name)
                return
    x, y = crossed[-1].tolist()
    off = rounding(x, y, z)
    found = probes.line(x, y).faces_up(z - off, z + off)
    if not (found or probes.faces_up_beside((x, y, z), off)):
        text = f"{link.kind} {link.name!r} lands at {z:.3f} m, where no surface is"
        yield _finding(NO_LANDING, link, grid, (x, y, z), text, None)


def _check_shaft(
    link: Link, body: int, grid: GridBase, scene: Scene, probes: Probes, tolerance: float
) -> Iterator[Finding]:
    """Move the car over its range, and ask FCL what it meets on the way."""
    model = scene.model
    obstacles = probes.obstacles
    up = np.array([0.0, 0.0, 1.0])
    joint = int(model.body_jntadr[body])
    own = geoms_of_bodies(model, body, int(find_subtree_ends(model)[body])).tolist()
    axis = float(scene.data.xaxis[joint, 2])
    now = float(scene.data.qpos[model.jnt_qposadr[joint]])
    low, high = sorted(axis * (end - now) for end in model.jnt_range[joint])
    # what it rests on, or reaches, at the ends of its way is no obstacle
    moves = np.linspace(low + tolerance, high - tolerance, max(int((high - low) / STEP), 1) + 1)
    for item in (item for item in obstacles.items if item.geom in own):
        near = obstacles.meeting(item.low + up * moves[0], item.high + up * moves[-1])
        others = [number for number in near if obstacles.items[number].geom not in own]
        start = np.array(item.shape.getTranslation())
        for move, number in product(moves.tolist(), others):
            item.shape.setTranslation(start + up * move)
            if fcl.collide(item.shape, obstacles.items[number].shape) > 0:
                name = obstacles.name(number)
                text = f"the car of {link.kind} {link.name!r} runs into {name!r}, "
                place = (item.low + item.high) / 2 + up * move
                text += f"moved by {move:.2f} m"
                yield _finding(LINK_TOUCHES, link, grid, place.tolist(), text, name)
                break
        item.shape.setTranslation(start)


def _finding(
    kind: str, link: Link, grid: GridBase, at: Sequence[float], text: str, geom: str | None
) -> Finding:
    stop = link.stops[0]
    cell = divmod(stop.cell, grid.levels[stop.level].width)
    x, y, z = (float(value) for value in at)
    return Finding(kind, stop.level, cell, (x, y, z), text, geom)
