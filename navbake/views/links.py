"""Links and stairs of a grid, as pictures and tables show them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from navbake.navgrid.agents import Area
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import Link
from navbake.types import Float
from navbake.views.tables import Table, make_table

STAIR, STEEP = "stair", "steep"
BULGE = 0.15  # how far an arc bends from the straight line, by its length
ARC = 17  # points of an arc

Place = tuple[int, float, float, float]
"""A level, and world x, y, z [m]."""


class Way(NamedTuple):
    """A named link, or the steps side by side that make a stair or a steep ramp."""

    name: str
    kind: str
    places: tuple[Place, ...]  # its stops, or the middles of the steps' two ends
    link: Link | None  # None for steps
    num_steps: int = 0

    @property
    def is_closed(self) -> bool:
        return self.link is not None and self.link.state == "closed"

    @property
    def one_way(self) -> bool:
        return self.link is not None and self.link.one_way

    def label(self) -> str:
        """What stands at its stops."""
        return f"{self.name} (closed)" if self.is_closed else self.name


def find_ways(grid: NavGrid) -> list[Way]:
    """The named links in the file's order, then stairs, then steep ramps, by level."""
    links = [
        Way(link.name, link.kind, tuple((s.level, *s.position) for s in link.stops), link)
        for link in grid.links
    ]
    return [*links, *_group_steps(grid)]


def _group_steps(grid: NavGrid) -> Iterator[Way]:
    """Steps from one level to another that begin side by side are one stair."""
    from scipy import ndimage  # takes longer to load than most pages to make

    steps, count = grid.step_array, {STAIR: 0, STEEP: 0}
    pairs = np.unique(steps[:, ::2], axis=0).tolist()
    for pair in sorted(pairs, key=lambda pair: (pair[0] == pair[1], pair)):
        own = steps[(steps[:, ::2] == pair).all(axis=1)]
        level, kind = grid.levels[pair[0]], STEEP if pair[0] == pair[1] else STAIR
        mask, cells = np.zeros(level.shape, np.bool_), np.divmod(own[:, 1], level.width)
        mask[cells] = True
        part = ndimage.label(mask, np.ones((3, 3)))[0][cells]
        for number in np.unique(part).tolist():
            some, count[kind] = own[part == number], count[kind] + 1
            ends = [_middle_of(grid, pair[k], some[:, 2 * k + 1]) for k in (0, 1)]
            yield Way(f"{kind} {count[kind]}", kind, tuple(ends), None, len(some))


def _middle_of(grid: NavGrid, number: int, cells: np.ndarray) -> Place:
    level = grid.levels[number]
    rows, cols = np.divmod(cells, level.width)
    x, y = level.lattice.positions(rows, cols).mean(axis=0).tolist()
    z = level.floor_or_ground[rows, cols].mean()
    return number, x, y, float(z)


def bend(start: Float, end: Float) -> Float:
    """An arc from one position to another, shape (`ARC`, 3) [m].

    Between heights it bends to the side, else up.
    """
    along, side = end - start, np.array([0.0, 0.0, 1.0])
    flat = float(np.hypot(along[0], along[1]))
    if abs(along[2]) > flat:
        side = np.array([-along[1], along[0], 0.0]) / flat if flat > 1e-6 else -np.eye(3)[1]
    t = np.linspace(0.0, 1.0, ARC)[:, None]
    arc: Float = start + t * along + 4 * t * (1 - t) * BULGE * np.linalg.norm(along) * side
    return arc


def describe_area(area: Area) -> str:
    """An area in a few words: ``lab: keep-out``, ``lobby: price 2, at most 0.6 m/s``."""
    facts = ["keep-out"] if math.isinf(area.cost) else []
    facts += [f"price {area.cost:g}"] if not facts and area.cost != 1 else []
    facts += [f"at most {area.speed:g} m/s"] if area.speed is not None else []
    facts += [] if area.agents is None else [f"for {', '.join(area.agents) or 'nobody'}"]
    return f"{area.name}: {', '.join(facts)}" if facts else area.name


def stair_table(grid: NavGrid) -> Table:
    """A row for each stair, and each steep ramp: its steps side by side, and their middle."""
    names, rows = grid.level_names, []
    for way in find_ways(grid):
        if way.link is None:
            (one, x, y, _), (other, *_) = way.places
            place = f"{x:.2f}, {y:.2f}"
            rows.append((way.name, names[one], names[other], way.num_steps, place))
    headings = ("name", "from", "to", "steps", "mean place x, y [m]")
    return make_table(headings, rows, numbers=("steps",))
