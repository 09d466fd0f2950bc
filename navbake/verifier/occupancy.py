"""Whether what the grid calls free is free, and what it calls blocked is blocked."""

from __future__ import annotations

import numpy as np

from navbake.types import Bool, Float, Int
from navbake.verifier.lines import UP, Lines
from navbake.verifier.mesh_parts import CAVITY, UNCLEAR
from navbake.verifier.obstacles import is_enclosing
from navbake.verifier.probes import DISPUTED, TOUCHES, Column, Probes, depth_of
from navbake.verifier.report import BLOCKED_APART, FREE_TOUCHES, NO_FLOOR, Finding, LevelCounts
from navbake.verifier.sample import Agent, Bands, CellIndex, LevelSample, baked_bands, column_of

FARTHEST = 1.0  # how far from a blocked cell the nearest geom is looked for [m]
Footprint = list[tuple[float, bool]]
"""Half-size of each part, and whether it is round."""


class OccupancyCheck:
    """Checks the cells of one level.

    A free cell's footprint, made smaller by the tolerance on all sides, must touch nothing. A
    blocked cell's, made larger by it, must touch something, or lie inside of something.
    """

    def __init__(self, probes: Probes, lines: Lines, agent: Agent, tolerance: float) -> None:
        self._probes, self._lines, self._agent = probes, lines, agent
        self._obstacles, self._tolerance = probes.obstacles, tolerance
        self._encloses = is_enclosing(self._obstacles)

    def run(
        self,
        sample: LevelSample,
        counts: LevelCounts,
        footprint: Footprint,
        bands: Bands,
    ) -> list[Finding]:
        """Check free cells by a footprint and its bands, blocked ones by the baked footprint."""
        has_floor = ~np.isnan(sample.floor)
        findings = [
            _finding(NO_FLOOR, sample, cell, "is free, though it has no floor")
            for cell in np.flatnonzero(sample.free & ~has_floor).tolist()
        ]
        counts.blocked_blocked += int(np.count_nonzero(~sample.free & ~has_floor))
        findings += self._check_free(sample, counts, footprint, bands)
        findings += self._check_blocked(sample, counts)
        return findings

    # ------------------------------------------------------------ free cells

    def _check_free(
        self, sample: LevelSample, counts: LevelCounts, footprint: Footprint, bands: Bands
    ) -> list[Finding]:
        asked = sample.free & ~np.isnan(sample.floor) & (bands.high > bands.low)
        touched = np.full(len(sample), -1)
        disputed = np.zeros(len(sample), dtype=np.bool_)
        part_of = np.zeros(len(sample), dtype=np.int64)
        for part, (half, is_round) in enumerate(footprint):
            for number, cells in self._candidates(sample, asked, half, bands):
                cells = cells[touched[cells] < 0]
                answers = self._ask(sample, cells, number, half, is_round, bands, -self._tolerance)
                touched[cells[answers == TOUCHES]] = number
                part_of[cells[answers == TOUCHES]] = part
                disputed[cells[answers == DISPUTED]] = True
        inside = self._inside(sample, asked & (touched < 0), bands)
        touched[inside >= 0] = inside[inside >= 0]
        disputed &= touched < 0
        counts.disputed += int(disputed.sum())
        counts.free_touches += int((touched >= 0).sum())
        counts.free_free += int((asked & (touched < 0) & ~disputed).sum())
        findings = []
        for cell in np.flatnonzero(touched >= 0).tolist():
            half, is_round = footprint[part_of[cell]]
            low, high = bands.low[cell], bands.high[cell]
            column = column_of(half, is_round, (low, high))
            center = np.array([*sample.xy[cell], (low + high) / 2])
            depth = depth_of(self._probes, column, center, int(touched[cell]))
            name = self._obstacles.name(int(touched[cell]))
            text = f"is free, but {name!r} reaches {depth:.4f} m into it"
            findings.append(_finding(FREE_TOUCHES, sample, cell, text, name, depth))
        return findings

    # ------------------------------------------------------------ blocked cells

    def _check_blocked(self, sample: LevelSample, counts: LevelCounts) -> list[Finding]:
        agent, bands = self._agent, baked_bands(sample, self._agent)
        blocked = sample.occupied & ~sample.free & ~np.isnan(sample.floor)
        counts.blocked_blocked += int(
            np.count_nonzero(~sample.free & ~sample.occupied & ~np.isnan(sample.floor))
        )  # by an inflation, which is looked at by itself
        footprint = agent.footprint(sample.level.lattice.cell_size)
        met = np.zeros(len(sample), dtype=np.bool_)
        for half, is_round in footprint:
            for number, cells in self._candidates(sample, blocked, half, bands):
                cells = cells[~met[cells]]
                answers = self._ask(sample, cells, number, half, is_round, bands, self._tolerance)
                met[cells[answers != 0]] = True
        met[self._inside(sample, blocked & ~met, bands) >= 0] = True
        apart = np.flatnonzero(blocked & ~met)
        unclear = self._maybe_inside(sample, apart, bands)
        counts.disputed += int(unclear.sum())
        counts.blocked_blocked += int(met.sum())
        apart = apart[~unclear]
        counts.blocked_apart += len(apart)
        findings = []
        for cell in apart.tolist():
            gap = self._gap(sample, cell, footprint, bands)
            how = "nothing is within 1 m" if gap is None else f"the nearest geom is {gap:.4f} m off"
            text = f"is blocked, but {how}"
            findings.append(_finding(BLOCKED_APART, sample, cell, text, None, gap))
        return findings

    def _gap(
        self, sample: LevelSample, cell: int, footprint: Footprint, bands: Bands
    ) -> float | None:
        """By how much a footprint has to grow until it touches something [m]; None if by much."""
        only = np.zeros(len(sample), dtype=np.bool_)
        only[cell] = True
        touching = None
        margins = np.geomspace(self._tolerance, FARTHEST, 24)
        for margin in margins:
            wide = Bands(bands.low - margin, bands.high + margin)
            for half, is_round in footprint:
                for number, cells in self._candidates(sample, only, half + margin, wide):
                    if (
                        len(cells)
                        and self._ask(
                            sample, cells, number, half, is_round, bands, float(margin)
                        ).any()
                    ):
                        touching = float(margin)
            if touching is not None:
                return touching
        return None

    # ------------------------------------------------------------ questions

    def _candidates(
        self, sample: LevelSample, asked: Bool, reach: float, bands: Bands
    ) -> list[tuple[int, Int]]:
        """Each obstacle with the cells whose boxes meet its own."""
        margin = 2 * self._tolerance
        index = CellIndex(sample, bands.low - margin, bands.high + margin)
        found = []
        for number in range(len(self._obstacles.items)):
            low, high = self._obstacles.low[number], self._obstacles.high[number]
            cells = index.under(low, high, reach + margin)
            cells = cells[asked[cells]]
            if len(cells):
                found.append((number, cells))
        return found

    def _ask(
        self,
        sample: LevelSample,
        cells: Int,
        number: int,
        half: float,
        is_round: bool,
        bands: Bands,
        margin: float,
    ) -> Int:
        """How the columns of cells, grown by a margin, stand to an obstacle."""
        answers = np.zeros(len(cells), dtype=np.int64)
        xy, middle = sample.xy[cells], (bands.low[cells] + bands.high[cells]) / 2
        centers = np.column_stack([xy, middle])
        last: Column | None = None
        probe = None
        for k, (cell, center) in enumerate(zip(cells.tolist(), centers, strict=True)):
            column = column_of(half, is_round, (bands.low[cell], bands.high[cell]))
            if column != last:
                last, grown = column, column.grown(margin)
                probe = None if grown is None else self._probes.of(grown)
            if probe is not None:
                probe.place(center)
                answers[k] = probe.touches(number)
        return answers

    def _inside(self, sample: LevelSample, asked: Bool, bands: Bands) -> Int:
        """The enclosing obstacle that a cell's column lies in, -1 for none."""
        found = np.full(len(sample), -1)
        if not self._encloses.any():
            return found
        index = CellIndex(sample, bands.low, bands.high)
        depth = np.zeros(len(sample), dtype=np.int64)
        for number in np.flatnonzero(self._encloses).tolist():
            cells = index.under(self._obstacles.low[number], self._obstacles.high[number], 0.0)
            sign = -1 if self._obstacles.items[number].kind == CAVITY else 1
            for cell in cells[asked[cells]].tolist():
                middle = (bands.low[cell] + bands.high[cell]) / 2
                if self._crossings(number, np.array([*sample.xy[cell], middle])) % 2:
                    depth[cell] += sign
                    if sign > 0:
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
                point = np.array([*sample.xy[cell], (bands.low[cell] + bands.high[cell]) / 2])
                if ((low < point) & (point < high)).all():
                    maybe[k] |= self._crossings(number, point) % 2 == 1
        return maybe

    def _crossings(self, number: int, point: Float) -> int:
        """How often the way up from a point crosses an obstacle's surface."""
        count, start = 0, point.copy()
        for _ in range(200):
            distance, _ = self._lines.ray(number, start, UP)
            if distance < 0:
                break
            count += 1
            start[2] += distance + 1e-6
        return count


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
