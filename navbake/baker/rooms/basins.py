"""What a flood filled from its seeds, and what of it is one room after all."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.labels import find_passes, measure_basins

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Labels = NDArray[np.int32]

# How much wider a disc fits where corridors cross than in them
CROSSING = 2**0.5
# What walls that don't follow the lattice make the width of one and the same corridor vary by,
# to each side of its middle, in half cells: measured over all angles and offsets, at most this
ROUGHNESS = 1.0
SLACK = 1e-6  # of half a cell: a gap this little over the door's width still has it
# A place is a stair where this much of it is as steep
HALF = 0.5


class Basins:
    """What the flood filled from each seed, and what of it is joined to one room."""

    def __init__(self, label: Labels, distance: Labels, num_wide: int) -> None:
        num_basins = int(label.max(initial=0))
        cells, peaks, _ = measure_basins(label, distance, num_basins)
        self._cells: list[int] = cells.tolist()
        # how far from the walls at the widest place [half cells]
        self._peak: list[float] = np.sqrt(peaks).tolist()
        self._narrow = [basin > num_wide for basin in range(num_basins + 1)]
        self._parent = list(range(num_basins + 1))
        # what each basin meets: how far from the walls at the widest place, along how many cells
        self._passes: list[dict[int, tuple[float, int]]] = [{} for _ in range(num_basins + 1)]
        pairs, saddles = find_passes(label, distance)
        key, place = np.unique(pairs[:, 0] * (num_basins + 1) + pairs[:, 1], return_inverse=True)
        saddle = np.zeros(len(key), dtype=np.int32)
        np.maximum.at(saddle, place, saddles)
        length = np.bincount(place, minlength=len(key)).tolist()
        for k, (a, b) in enumerate(zip(*np.divmod(key, num_basins + 1), strict=True)):
            met = (float(np.sqrt(saddle[k])), length[k])
            self._passes[a][int(b)] = self._passes[b][int(a)] = met

    def join_rough_passes(self) -> None:
        """Join what is parted by no more than the roughness of walls off the lattice.

        The pass is as wide as the smaller one of two wide basins; or as wide as both, where one
        is narrow, because a corridor that opens into a hall is as wide as its mouth.
        """
        passes = [
            (-saddle, a, b)
            for a, met in enumerate(self._passes)
            for b, (saddle, _) in met.items()
            if a < b
        ]
        for negative, first, second in sorted(passes):
            a, b = self._root(first), self._root(second)
            if a == b:
                continue
            choose = max if self._narrow[a] or self._narrow[b] else min
            if choose(self._peak[a], self._peak[b]) + negative <= ROUGHNESS + SLACK:
                self._join(min(a, b), max(a, b))

    def join_junctions(self) -> None:
        """Join narrow places round the bends and crossings between them.

        Where corridors of one width meet, discs fit that are wider than each, by a factor of
        √2 where four meet, less at a bend. Such a place opens to at least two of them as wide
        as they are, and is hardly larger than the crossing.
        """
        widest = [max((saddle for saddle, _ in met.values()), default=0) for met in self._passes]
        places = {
            basin
            for basin, saddle in enumerate(widest)
            if not self._narrow[basin]
            and self._peak[basin] <= CROSSING * saddle + ROUGHNESS
            and 0 < self._cells[basin] <= (2 * saddle) ** 2
        }
        ends = {
            basin: [
                other
                for other, (saddle, _) in self._passes[basin].items()
                if saddle >= widest[basin] - ROUGHNESS - SLACK
                and (other in places or (self._narrow[other] and self._is_mouth(basin, other)))
            ]
            for basin in places
        }
        junctions = {basin for basin in places if len(ends[basin]) >= 2}
        for basin in sorted(junctions):
            for other in ends[basin]:
                a, b = self._root(basin), self._root(other)
                if a != b and other not in places - junctions:
                    self._join(min(a, b), max(a, b))

    def join_stairs(self, num_steep: Int, heights: Float) -> None:
        """Join stairs to where they open to as wide as they are; of several, to the lowest.

        Args:
            num_steep: how many cells of each basin are as steep as stairs.
            heights: sum of the heights of each basin's cells [m].
        """
        cells = list(self._cells)
        for basin in range(1, len(cells)):
            if self._parent[basin] != basin or num_steep[basin] < HALF * cells[basin]:
                continue
            mouths = [other for other in self._passes[basin] if self._is_mouth(other, basin)]
            if mouths:
                lowest = min(mouths, key=lambda other: (heights[other] / cells[other], other))
                self._join(lowest, basin)

    def join_small(self, least: float) -> None:
        """Join basins of fewer cells, the smallest first, to the one they open to the widest."""
        queue = [
            (cells, basin)
            for basin, cells in enumerate(self._cells)
            if basin and self._parent[basin] == basin and cells < least
        ]
        heapq.heapify(queue)
        while queue:
            cells, small = heapq.heappop(queue)
            met = self._passes[small]
            if self._parent[small] != small or self._cells[small] != cells or not met:
                continue
            to = max(met, key=lambda other: (*met[other], self._cells[other], -other))
            self._join(to, small)
            if self._cells[to] < least:
                heapq.heappush(queue, (self._cells[to], to))

    def joined(self, least: float) -> Labels:
        """The basin that each one is part of now, 0 for those of fewer cells."""
        roots = [self._root(basin) for basin in range(len(self._parent))]
        kept = [root if self._cells[root] >= least else 0 for root in roots]
        return np.array(kept, dtype=np.int32)

    def _is_mouth(self, basin: int, other: int) -> bool:
        """Whether a basin opens to another one as wide as the other is."""
        return self._passes[basin][other][0] >= self._peak[other] - ROUGHNESS - SLACK

    def _root(self, basin: int) -> int:
        while self._parent[basin] != basin:
            basin = self._parent[basin]
        return basin

    def _join(self, to: int, gone: int) -> None:
        self._parent[gone] = to
        self._cells[to] += self._cells[gone]
        self._peak[to] = max(self._peak[to], self._peak[gone])
        self._narrow[to] = self._narrow[to] or self._narrow[gone]
        for other, (saddle, length) in self._passes[gone].items():
            del self._passes[other][gone]
            if other != to:
                known, known_length = self._passes[to].get(other, (0.0, 0))
                met = (max(saddle, known), length + known_length)
                self._passes[to][other] = self._passes[other][to] = met
        self._passes[gone] = {}
