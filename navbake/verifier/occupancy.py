"""Whether what the grid calls free is free, and what it calls blocked is blocked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from navbake.types import Bool, Float, Int, Vector3
from navbake.verifier.agent import Agent
from navbake.verifier.lines import Lines
from navbake.verifier.obstacles import UNCLEAR, is_enclosing
from navbake.verifier.probes import (
    APART,
    DISPUTED,
    FARTHEST,
    TOUCHES,
    Column,
    Probes,
    depth_of,
    nearest_to,
)
from navbake.verifier.report import BLOCKED_APART, FREE_TOUCHES, NO_FLOOR, Finding, LevelCounts
from navbake.verifier.sample import Bands, CellIndex, LevelSample, Part, baked_volume, column_of

MEASURED = 100  # findings of a kind whose depth or gap is measured


class OccupancyCheck:
    """Checks the cells of levels.

    A free cell's volume, made smaller by the tolerance on all sides, must touch nothing. A blocked
    cell's, made larger by it, must touch something, or lie inside of something.

    Attributes:
        num_groundless: blocked cells that touch nothing, of levels that state no floors, where the
            scene has no place to stand at the level's ground.
    """

    def __init__(
        self, probes: Probes, lines: Lines, agent: Agent, tolerance: float, reach: float = 0.0
    ) -> None:
        """Take what is asked, and what is looked for.

        Args:
            reach: of the inflation that closed cells [m], 0 for none.
        """
        self._probes, self._lines, self._agent = probes, lines, agent
        self._obstacles, self._tolerance, self._reach = probes.obstacles, tolerance, reach
        self._encloses = is_enclosing(self._obstacles)
        self._found: Counter[str] = Counter()
        self.num_groundless = 0

    def run(
        self, sample: LevelSample, counts: LevelCounts, volume: list[Part], excused: Bool
    ) -> list[Finding]:
        """Check free cells by a volume, blocked ones by the baked volume.

        Args:
            excused: blocked cells that an inflation closed, and that have a reason for it.
        """
        index = CellIndex(sample)
        has_floor = ~np.isnan(sample.floor)
        findings = [
            _finding(NO_FLOOR, sample, cell, "is free, though it has no floor")
            for cell in np.flatnonzero(sample.free & ~has_floor).tolist()
        ]
        findings += self._check_free(index, counts, volume)
        findings += self._check_blocked(index, counts, excused)
        return findings

    def _is_measured(self, kind: str) -> bool:
        self._found[kind] += 1
        return self._found[kind] <= MEASURED

    # ------------------------------------------------------------ free cells

    def _check_free(
        self, index: CellIndex, counts: LevelCounts, volume: list[Part]
    ) -> list[Finding]:
        sample = index.sample
        asked = sample.free & ~np.isnan(sample.floor)
        touched = np.full(len(sample), -1)
        disputed = np.zeros(len(sample), dtype=np.bool_)
        part_of = np.zeros(len(sample), dtype=np.int64)
        for k, part in enumerate(volume):
            for number, cells in self._candidates(index, asked, part):
                cells = cells[touched[cells] < 0]
                answers = self._ask(sample, cells, number, part, -self._tolerance)
                touched[cells[answers == TOUCHES]] = number
                part_of[cells[answers == TOUCHES]] = k
                disputed[cells[answers == DISPUTED]] = True
        within = self._inside(index, asked & (touched < 0), volume[0].bands)
        is_inside = within >= 0
        touched[is_inside] = within[is_inside]
        bare = self._find_bare(sample, asked & (touched < 0))
        disputed &= (touched < 0) & ~bare
        counts.disputed += int(disputed.sum())
        counts.free_touches += int((touched >= 0).sum())
        counts.free_free += int((asked & (touched < 0) & ~disputed & ~bare).sum())
        text = f"is free, but no floor is within {self._agent.step:g} m of its level's ground"
        findings = [
            _finding(NO_FLOOR, sample, cell, text) for cell in np.flatnonzero(bare).tolist()
        ]
        for cell in np.flatnonzero(touched >= 0).tolist():
            number = int(touched[cell])
            name, depth = self._obstacles.name(number), None
            if is_inside[cell]:
                text = f"is free, but lies inside of {name!r}"
            elif self._is_measured(FREE_TOUCHES):
                place = self._place(sample, cell, volume[part_of[cell]])
                depth = depth_of(self._probes, *place, number)
                text = f"is free, but {name!r} reaches {depth:.4f} m into it"
            else:
                text = f"is free, but {name!r} reaches into it"
            findings.append(_finding(FREE_TOUCHES, sample, cell, text, name, depth))
        return findings

    def _find_bare(self, sample: LevelSample, asked: Bool) -> Bool:
        """Which cells of a level that states no floors have none within a step of its ground.

        A floor is a surface that faces up, also beside a crack or a rim.
        """
        bare = np.zeros(len(sample), dtype=np.bool_)
        step = self._agent.step + self._tolerance
        for cell in np.flatnonzero(asked & (not sample.states_floors)).tolist():
            (x, y), z = sample.xy[cell].tolist(), float(sample.floor[cell])
            low, high = z - step, z + step
            bare[cell] = not (
                self._lines.at(x, y).faces_up(low, high)
                or self._lines.faces_up_beside(x, y, low, high)
            )
        return bare

    # ------------------------------------------------------------ blocked cells

    def _check_blocked(self, index: CellIndex, counts: LevelCounts, excused: Bool) -> list[Finding]:
        sample = index.sample
        volume = baked_volume(sample, self._agent)
        asked = ~sample.free & ~np.isnan(sample.floor) & ~excused
        met = np.zeros(len(sample), dtype=np.bool_)
        for part in volume:
            for number, cells in self._candidates(index, asked & ~met, part):
                cells = cells[~met[cells]]
                answers = self._ask(sample, cells, number, part, self._tolerance)
                met[cells[answers != APART]] = True
        bands = volume[0].bands
        met[self._inside(index, asked & ~met, bands) >= 0] = True
        apart = np.flatnonzero(asked & ~met)
        if not sample.states_floors:
            can_stand = self._can_stand(sample, apart)
            self.num_groundless += int(np.count_nonzero(~can_stand))
            apart = apart[can_stand]
        unclear = self._maybe_inside(sample, apart, bands)
        apart = apart[~unclear]
        counts.disputed += int(unclear.sum())
        counts.blocked_apart += len(apart)
        num_blocked = int(np.count_nonzero(~sample.free))
        counts.blocked_blocked += num_blocked - int(unclear.sum()) - len(apart)
        return [self._describe_apart(sample, cell, volume) for cell in apart.tolist()]

    def _can_stand(self, sample: LevelSample, cells: Int) -> Bool:
        """Where the scene has a place to stand within a step of the level's ground."""
        agent, found = self._agent, []
        for cell in cells.tolist():
            x, y = sample.xy[cell].tolist()
            places = self._lines.at(x, y).standable(agent.height, agent.min_up)
            found.append(any(abs(s.z - sample.floor[cell]) <= agent.step for s in places))
        return np.array(found, dtype=np.bool_)

    def _describe_apart(self, sample: LevelSample, cell: int, volume: list[Part]) -> Finding:
        if self._reach > 0 and not sample.occupied[cell]:
            text = f"is blocked for {self._reach:g} m, but nothing within that radius is in the way"
            return _finding(BLOCKED_APART, sample, cell, text)
        if not self._is_measured(BLOCKED_APART):
            return _finding(BLOCKED_APART, sample, cell, "is blocked, but touches nothing")
        gaps = [nearest_to(self._probes, *self._place(sample, cell, part)) for part in volume]
        known = [gap for gap in gaps if gap is not None]
        if not known:
            text = f"is blocked, but nothing is within {FARTHEST:g} m"
            return _finding(BLOCKED_APART, sample, cell, text)
        gap, number = min(known)
        name = self._obstacles.name(number)
        text = (
            "is blocked, but nothing touches the volume over it: the nearest geom, "
            f"{name!r}, is {gap:.4f} m off"
        )
        return _finding(BLOCKED_APART, sample, cell, text, name, gap)

    # ------------------------------------------------------------ questions

    def _place(self, sample: LevelSample, cell: int, part: Part) -> tuple[Column, Float]:
        """The column of a part over a cell, and its centre [m]."""
        middle = (part.bands.low[cell] + part.bands.high[cell]) / 2
        return column_of(part, cell), np.array([*sample.xy[cell], middle])

    def _candidates(self, index: CellIndex, asked: Bool, part: Part) -> Iterator[tuple[int, Int]]:
        """Each obstacle with the cells that are asked and whose boxes meet its own."""
        margin = 2 * self._tolerance
        bands = Bands(part.bands.low - margin, part.bands.high + margin)
        asked = asked & (part.bands.high > part.bands.low)
        for number in range(len(self._obstacles.items)):
            low, high = self._obstacles.low[number], self._obstacles.high[number]
            cells = index.under(low, high, part.half + margin, bands)
            cells = cells[asked[cells]]
            if len(cells):
                yield number, cells

    def _ask(self, sample: LevelSample, cells: Int, number: int, part: Part, margin: float) -> Int:
        """How the columns of cells, grown by a margin, stand to an obstacle."""
        answers = np.full(len(cells), APART)
        middle = (part.bands.low[cells] + part.bands.high[cells]) / 2
        centers = np.column_stack([sample.xy[cells], middle])
        last: Column | None = None
        probe = None
        for k, (cell, center) in enumerate(zip(cells.tolist(), centers, strict=True)):
            column = column_of(part, cell)
            if column != last:
                last, grown = column, column.grown(margin)
                probe = None if grown is None else self._probes.of(grown)
            if probe is not None:
                probe.place(center)
                answers[k] = probe.touches(number)
        return answers

    def _inside(self, index: CellIndex, asked: Bool, bands: Bands) -> Int:
        """The enclosing obstacle that a cell's column lies in, -1 for none."""
        sample = index.sample
        found = np.full(len(sample), -1)
        depth = np.zeros(len(sample), dtype=np.int64)
        for number in np.flatnonzero(self._encloses).tolist():
            low, high = self._obstacles.low[number], self._obstacles.high[number]
            cells = index.under(low, high, 0.0, bands)
            for cell in cells[asked[cells]].tolist():
                leaves, enters = self._lines.crossings(number, _middle(sample, cell, bands))
                depth[cell] += leaves - enters  # less than 0 in a cavity
                if leaves > enters:
                    found[cell] = number
        found[depth <= 0] = -1
        return found

    def _maybe_inside(self, sample: LevelSample, cells: Int, bands: Bands) -> Bool:
        """Which cells lie in a part of a mesh that may enclose them or not."""
        maybe = np.zeros(len(cells), dtype=np.bool_)
        items = self._obstacles.items
        for number in [k for k, item in enumerate(items) if item.kind == UNCLEAR]:
            low, high = self._obstacles.low[number], self._obstacles.high[number]
            for k, cell in enumerate(cells.tolist()):
                point = _middle(sample, cell, bands)
                if ((low < point) & (point < high)).all():
                    maybe[k] |= sum(self._lines.crossings(number, point)) % 2 == 1
        return maybe


def _middle(sample: LevelSample, cell: int, bands: Bands) -> Vector3:
    """The middle of the volume over a cell [m]."""
    x, y = sample.xy[cell].tolist()
    return x, y, float(bands.low[cell] + bands.high[cell]) / 2


def _finding(
    kind: str,
    sample: LevelSample,
    cell: int,
    text: str,
    geom: str | None = None,
    size: float | None = None,
) -> Finding:
    z = float(sample.floor[cell])
    z = sample.level.ground if np.isnan(z) else z
    position = (float(sample.xy[cell, 0]), float(sample.xy[cell, 1]), z)
    place = int(sample.rows[cell]), int(sample.cols[cell])
    return Finding(kind, sample.number, place, position, text, geom, size)
