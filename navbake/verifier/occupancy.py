"""Whether what the grid calls free is free, and what it calls blocked is blocked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator

import numpy as np

from navbake.types import Bool, Int
from navbake.verifier.obstacles import ENCLOSING, UNCLEAR, Obstacle
from navbake.verifier.probes import DISPUTED, FARTHEST, TOUCHES, Lines, Probes
from navbake.verifier.report import BLOCKED_APART, FREE_TOUCHES, NO_FLOOR, Finding, LevelCounts
from navbake.verifier.sample import Agent, LevelSample, Part

MEASURED = 100  # findings of a kind whose depth or gap is measured


class OccupancyCheck:
    """Checks the cells of levels.

    A free cell's volume, made smaller by the tolerance on all sides, must touch nothing. A blocked
    cell's, made larger by it, must touch something, or lie inside of something. `reach` is that of
    the inflation that closed cells [m], 0 for none. `num_groundless` counts blocked cells without a
    place to stand at their level's ground, of levels that state no floors.
    """

    def __init__(
        self, probes: Probes, lines: Lines, agent: Agent, tolerance: float, reach: float = 0.0
    ) -> None:
        self._probes, self._lines, self._agent = probes, lines, agent
        self._obstacles, self._tolerance, self._reach = probes.obstacles, tolerance, reach
        self._found: Counter[str] = Counter()
        self.num_groundless = 0

    def check_free(
        self, sample: LevelSample, counts: LevelCounts, volume: list[Part]
    ) -> list[Finding]:
        """Check free cells by a volume."""
        asked = sample.free & ~np.isnan(sample.floor)
        touching, part, disputed = self._touch(sample, asked, volume, -self._tolerance)
        within = self._inside(sample, asked & (touching < 0), volume[0])
        by = np.where(within >= 0, within, touching)
        text = "is free, though it has no floor"
        bare = np.flatnonzero(sample.free & ~asked).tolist()
        findings = [sample.finding(NO_FLOOR, cell, text) for cell in bare]
        is_apart, step = asked & (by < 0), self._agent.step + self._tolerance
        text = f"is free, but no floor is within {self._agent.step:g} m of its level's ground"
        for cell in np.flatnonzero(is_apart & (not sample.states_floors)).tolist():
            # a floor is a surface that faces up, also beside a crack or a rim
            x, y, z = at = sample.place(cell)
            on_floor = self._lines.at(x, y).faces_up(z - step, z + step)
            if not on_floor and not self._lines.faces_up_beside(at, step):
                is_apart[cell] = False
                findings.append(sample.finding(NO_FLOOR, cell, text))
        counts.disputed += int((is_apart & disputed).sum())
        counts.free_touches += int((by >= 0).sum())
        counts.free_free += int((is_apart & ~disputed).sum())
        for cell in np.flatnonzero(by >= 0).tolist():
            number, depth = int(by[cell]), None
            name = self._obstacles.name(number)
            text = f"is free, but {name!r} reaches into it"
            if within[cell] >= 0:
                text = f"is free, but lies inside of {name!r}"
            elif self._is_measured(FREE_TOUCHES):
                place = volume[int(part[cell])].put_over(sample, cell)
                depth = self._probes.depth(*place, number)
                text = f"is free, but {name!r} reaches {depth:.4f} m into it"
            findings.append(sample.finding(FREE_TOUCHES, cell, text, name, depth))
        return findings

    def check_blocked(
        self, sample: LevelSample, counts: LevelCounts, volume: list[Part], excused: Bool
    ) -> list[Finding]:
        """Check blocked cells by the baked volume, but those that an inflation closed rightly."""
        asked = ~sample.free & ~np.isnan(sample.floor) & ~excused
        touching, _, disputed = self._touch(sample, asked, volume, self._tolerance)
        apart = asked & (touching < 0) & ~disputed
        apart &= self._inside(sample, apart, volume[0]) < 0
        for cell in np.flatnonzero(apart & (not sample.states_floors)).tolist():
            # where the scene has no place to stand within a step of the ground, it may be blocked
            line, agent, z = self._lines.at(*sample.xy[cell]), self._agent, sample.floor[cell]
            places = line.standable(agent.height, agent.min_up)
            apart[cell] = any(abs(s.z - z) <= agent.step for s in places)
            self.num_groundless += not apart[cell]
        unclear = np.zeros_like(apart)
        for _, cell, leaves, enters in self._crossings(sample, apart, volume[0], (UNCLEAR,)):
            unclear[cell] |= (leaves + enters) % 2 == 1
        apart &= ~unclear
        num_unclear, num_apart = int(unclear.sum()), int(apart.sum())
        counts.disputed += num_unclear
        counts.blocked_apart += num_apart
        counts.blocked_blocked += int((~sample.free).sum()) - num_unclear - num_apart
        findings = []
        for cell in np.flatnonzero(apart).tolist():
            name, gap, text = None, None, "is blocked, but touches nothing"
            if self._reach > 0 and not sample.occupied[cell]:
                text = f"is blocked for {self._reach:g} m, but nothing within that radius is "
                text += "in the way"
            elif self._is_measured(BLOCKED_APART):
                columns = [part.put_over(sample, cell) for part in volume]
                nearest = [found for put in columns if (found := self._probes.nearest(*put))]
                text = f"is blocked, but nothing is within {FARTHEST:g} m"
                if nearest:
                    gap, number = min(nearest)
                    name = self._obstacles.name(number)
                    text = "is blocked, but nothing touches the volume over it: the nearest geom, "
                    text += f"{name!r}, is {gap:.4f} m off"
            findings.append(sample.finding(BLOCKED_APART, cell, text, name, gap))
        return findings

    def _is_measured(self, kind: str) -> bool:
        self._found[kind] += 1
        return self._found[kind] <= MEASURED

    def _touch(
        self, sample: LevelSample, asked: Bool, volume: list[Part], margin: float
    ) -> tuple[Int, Int, Bool]:
        """What touches the volumes over cells, grown by a margin [m].

        Returns the obstacle, -1 for none, the part of the volume, and where libraries disagree.
        """
        by, which = np.full(len(asked), -1), np.zeros(len(asked), np.int64)
        disputed = np.zeros_like(asked)
        for k, part in enumerate(volume):
            asked_here = asked & (part.high > part.low)
            for number, item in enumerate(self._obstacles.items):
                cells = _near(sample, asked_here & (by < 0), item, part, 2 * abs(margin))
                for cell in cells.tolist():
                    answer = self._probes.touches(number, *part.put_over(sample, cell), margin)
                    disputed[cell] |= answer == DISPUTED
                    if answer == TOUCHES:
                        by[cell], which[cell] = number, k
        return by, which, disputed

    def _inside(self, sample: LevelSample, asked: Bool, part: Part) -> Int:
        """The enclosing obstacle that the middle of a cell's volume lies in, -1 for none."""
        found, depth = np.full(len(asked), -1), np.zeros(len(asked), dtype=np.int64)
        for number, cell, leaves, enters in self._crossings(sample, asked, part, ENCLOSING):
            depth[cell] += leaves - enters  # less than 0 in a cavity
            if leaves > enters:
                found[cell] = number
        found[depth <= 0] = -1
        return found

    def _crossings(
        self, sample: LevelSample, asked: Bool, part: Part, kinds: Collection[str]
    ) -> Iterator[tuple[int, int, int, int]]:
        """Obstacles of some kinds and cells in their boxes: how often the way up leaves, enters."""
        middle = (part.low + part.high) / 2
        point = Part(0.0, False, middle, middle)
        for number, item in enumerate(self._obstacles.items):
            for cell in _near(sample, asked, item, point).tolist() if item.kind in kinds else ():
                x, y = sample.xy[cell].tolist()
                yield number, cell, *self._lines.crossings(number, (x, y, float(middle[cell])))


def _near(sample: LevelSample, asked: Bool, item: Obstacle, part: Part, beyond: float = 0.0) -> Int:
    """The asked cells over which a part, larger by `beyond` [m], meets an obstacle's box."""
    lattice, reach = sample.level.lattice, part.half + beyond
    # rows ascend in a sample; those that may meet it
    ends = lattice.y_max - np.array([item.high[1] + reach, item.low[1] - reach])
    first, last = np.clip(ends / lattice.cell_size, 0, lattice.height).astype(np.int64)
    own = slice(*np.searchsorted(sample.rows, [first - 1, last + 1]))
    (x, y), low, high = sample.xy[own].T, part.low[own] - beyond, part.high[own] + beyond
    kept = asked[own] & (low < item.high[2]) & (high > item.low[2])
    kept &= (x + reach > item.low[0]) & (x - reach < item.high[0])
    kept &= (y + reach > item.low[1]) & (y - reach < item.high[1])
    return np.asarray(own.start + np.flatnonzero(kept))
