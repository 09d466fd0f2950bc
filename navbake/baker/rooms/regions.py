"""The regions of the watershed, and the rules that join them into rooms.

Regions that touch form a graph whose edges are passes. Two regions that are one room are
contracted to one node, as in region merging after a watershed (Vincent and Soille, 1991, on the
watershed; Haris et al., 1998, on merging by the region adjacency graph).
"""

import heapq

import numpy as np

from navbake.baker.rooms.kernels.labels import find_passes, measure_regions
from navbake.types import Float, Int, Int32

# How much wider a disc fits where corridors cross than in them
CROSSING = 2**0.5
# Walls at an angle to the lattice make the distance from a corridor's middle to its walls vary by
# at most this, as measured over all angles and offsets [half cells]
ROUGHNESS = 1.0
ROUNDING = 1e-6  # of half a cell: a gap this little over the door's width still has it
# A region is a stair where at least this share of its cells is as steep as one
STAIR_SHARE = 0.5


class Regions:
    """The region that was filled from each seed, and which regions have been joined.

    Args:
        label: the region of each cell from 1, 0 for none.
        distance: squared distance to the walls of each node, see `wall_nodes` [half cells].
        num_wide: regions up to this one hold discs wider than a door; the others are narrow.
    """

    def __init__(self, label: Int32, distance: Int32, num_wide: int) -> None:
        num = int(label.max(initial=0))
        cells, peaks, _ = measure_regions(label, distance, num)
        self._cells: list[int] = cells.tolist()
        # distance to the walls at the region's widest place [half cells]
        self._peak: list[float] = np.sqrt(peaks).tolist()
        self._narrow = [region > num_wide for region in range(num + 1)]
        # the region that each one is part of now, and all parts of those that are left
        self._whole = list(range(num + 1))
        self._parts = [[region] for region in range(num + 1)]
        # by region and neighbour: distance to the walls at the widest place of the pass, and how
        # many edges of cells it has
        self._passes: list[dict[int, tuple[float, int]]] = [{} for _ in range(num + 1)]
        pairs, saddles = find_passes(label, distance)
        key, place = np.unique(pairs[:, 0] * (num + 1) + pairs[:, 1], return_inverse=True)
        saddle = np.zeros(len(key), dtype=np.int32)
        np.maximum.at(saddle, place, saddles)
        length = np.bincount(place, minlength=len(key)).tolist()
        for k, (a, b) in enumerate(zip(*np.divmod(key, num + 1), strict=True)):
            met = (float(np.sqrt(saddle[k])), length[k])
            self._passes[a][int(b)] = self._passes[b][int(a)] = met

    def join_rough_passes(self) -> None:
        """Join regions that only seem separate because walls are not parallel to the lattice.

        The pass is as wide as the smaller one of two wide regions; or as wide as both, where one
        is narrow, because a corridor that opens into a hall is as wide as its mouth.
        """
        passes = [
            (-saddle, a, b)
            for a, met in enumerate(self._passes)
            for b, (saddle, _) in met.items()
            if a < b
        ]
        for negative, first, second in sorted(passes):  # the widest pass first
            a, b = sorted((self._whole[first], self._whole[second]))
            choose = max if self._narrow[a] or self._narrow[b] else min
            if a != b and choose(self._peak[a], self._peak[b]) + negative <= ROUGHNESS + ROUNDING:
                self._join(a, b)

    def join_junctions(self) -> None:
        """Join narrow regions round the bends and crossings between them.

        Where corridors of one width meet, discs fit that are wider than each, by a factor of
        √2 where four meet, less at a bend. Such a region opens to at least two of them as wide
        as they are, and is hardly larger than the crossing.
        """
        widest = [max((saddle for saddle, _ in met.values()), default=0) for met in self._passes]
        crossings = {
            region
            for region, saddle in enumerate(widest)
            if not self._narrow[region]
            and self._peak[region] <= CROSSING * saddle + ROUGHNESS
            and 0 < self._cells[region] <= (2 * saddle) ** 2
        }
        ends = {
            region: [
                other
                for other, (saddle, _) in self._passes[region].items()
                if saddle >= widest[region] - ROUGHNESS - ROUNDING
                and (other in crossings or (self._narrow[other] and self._is_mouth(region, other)))
            ]
            for region in crossings
        }
        junctions = {region for region in crossings if len(ends[region]) >= 2}
        for region in sorted(junctions):
            for other in ends[region]:
                a, b = sorted((self._whole[region], self._whole[other]))
                if a != b and other not in crossings - junctions:
                    self._join(a, b)

    def join_stairs(self, num_steep: Int, heights: Float) -> None:
        """Join a stair to the region that it opens to over its full width; of several, the lowest.

        Regions are stairs by their number of steep cells; `heights` are sums over their cells [m].
        """
        cells = list(self._cells)
        for region in range(1, len(cells)):
            is_stair = num_steep[region] >= STAIR_SHARE * cells[region]
            if self._whole[region] != region or not is_stair:
                continue
            mouths = [other for other in self._passes[region] if self._is_mouth(other, region)]
            if mouths:
                lowest = min(mouths, key=lambda other: (heights[other] / cells[other], other))
                self._join(lowest, region)

    def join_small(self, least: float, at_edge: Int | None = None, widest: float = 0.0) -> None:
        """Join regions of fewer cells, the smallest first, to the one they open to the widest.

        What is at the edge of the grid goes on along it: a ledge round a house goes on round its
        corners and not in at the door. So a region that is there joins the one that has most cells
        there, if it touches any; all that have `widest` are as good. One with more only joins one
        with more, because it is outside of the walls. `at_edge` tells how many each region has.
        """
        none_there = [0] * len(self._cells)
        edge = list(none_there) if at_edge is None else at_edge.tolist()
        queue = [
            (cells, region)
            for region, cells in enumerate(self._cells)
            if region and self._whole[region] == region and cells < least
        ]
        heapq.heapify(queue)
        while queue:
            cells, small = heapq.heappop(queue)
            met = self._passes[small]
            # what has grown since it was queued is queued again
            if self._whole[small] != small or self._cells[small] != cells or not met:
                continue
            there = edge if edge[small] else none_there
            to = max(
                met,
                key=lambda other: (
                    min(there[other], widest), *met[other], self._cells[other], -other
                ),
            )  # fmt: skip
            if edge[small] > widest >= edge[to]:
                continue
            self._join(to, small)
            edge[to] += edge[small]
            if self._cells[to] < least:
                heapq.heappush(queue, (self._cells[to], to))

    def wholes(self, least: float) -> Int32:
        """The region that each one is part of now, 0 for those of fewer cells."""
        kept = [whole if self._cells[whole] >= least else 0 for whole in self._whole]
        return np.array(kept, dtype=np.int32)

    def _is_mouth(self, region: int, other: int) -> bool:
        """Whether a region opens to another one as wide as the other is."""
        return self._passes[region][other][0] >= self._peak[other] - ROUGHNESS - ROUNDING

    def _join(self, to: int, gone: int) -> None:
        """Contract two regions to one; passes of both to a third become one pass."""
        for part in self._parts[gone]:
            self._whole[part] = to
        self._parts[to] += self._parts[gone]
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
