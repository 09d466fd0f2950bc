"""Rows of flights through voxels: scipy's Dijkstra, dijkstra3d, and a loop over an octree."""

from __future__ import annotations

import heapq
import itertools
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import navbake
from benchmarks.measure import Job, Row, beside, here, why_missing
from navbake.voxels.finder import VoxelFinder

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from oracles.flights import find_costs, make_large_graph

SCENES = {"house": 0.05, "warehouse": 0.03, "tower": 0.1}
"""Where flights are measured, and what they may take, in searches of scipy to all voxels."""
RES = 0.1  # [m]
RADIUS = 0.25  # of the ball [m]
NUM_FLIGHTS = 8

Voxel = tuple[int, int, int]


def make_rows() -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""
    rows: dict[str, Callable[[], Row]] = {
        f"flights-{name}": partial(flights_row, name, ratio) for name, ratio in SCENES.items()
    }
    return {**rows, "flight-octree": octree_row}


def make_finder(name: str) -> VoxelFinder:
    return VoxelFinder(navbake.create_voxel_grid(navbake.samples.path(name), res=RES), RADIUS)


def draw_pairs(finder: VoxelFinder, count: int) -> NDArray[np.int64]:
    """Draw pairs of voxels of the largest island, as flat numbers, shape (count, 2)."""
    voxel_numbers = np.flatnonzero(finder.islands.labels == 1)
    return np.random.default_rng(0).choice(voxel_numbers, (count, 2))


def to_positions(finder: VoxelFinder, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
    """World x, y, z of the centres of voxels, by their flat numbers."""
    indices = np.stack(np.unravel_index(numbers, finder.voxels.shape), axis=-1)
    return np.asarray(finder.voxels.bounds[0] + (indices + 0.5) * finder.voxels.res)


def to_voxel(finder: VoxelFinder, number: np.int64) -> Voxel:
    x, y, z = np.unravel_index(number, finder.voxels.shape)
    return int(x), int(y), int(z)


def flights_row(name: str, ratio: float) -> Row:
    """Flights in a scene, whose costs must be scipy's, next to scipy and dijkstra3d."""
    finder = make_finder(name)
    pairs = draw_pairs(finder, NUM_FLIGHTS)
    places = to_positions(finder, pairs)
    graph = make_large_graph(finder.voxels, RADIUS)
    for (start, goal), (begin, end) in zip(pairs, places, strict=True):
        flight = finder.find_path(begin, end)
        expected = find_costs(graph, [int(start)])[0, goal]
        if flight is None or abs(flight.cost - expected) > 1e-9:
            raise SystemExit(f"a flight in {name} and scipy differ")

    def fly() -> None:
        for begin, end in places:
            finder.find_path(begin, end)

    def search_graph() -> None:
        for start in pairs[:, 0]:
            find_costs(graph, [int(start)])

    job = here(f"{NUM_FLIGHTS} flights, {name}, voxels of {RES} m", fly)
    scipy_job = here("scipy csgraph, its graph given", search_graph)
    try:
        import dijkstra3d
    except ImportError:
        return Row(job, [scipy_job], ratio=ratio, missing=why_missing("dijkstra3d"))
    is_free = np.asfortranarray(finder.free)
    voxel_pairs = [(to_voxel(finder, start), to_voxel(finder, goal)) for start, goal in pairs]

    def search_volume() -> None:
        for start, goal in voxel_pairs:
            dijkstra3d.binary_dijkstra(is_free, start, goal, connectivity=26)

    peers = [scipy_job, here("dijkstra3d, free voxels given", search_volume)]
    return Row(job, peers, ratio=ratio)


def octree_row() -> Row:
    """One flight next to A* in Python that asks an octree about each voxel, as one writes it."""
    finder = make_finder("house")
    pairs = draw_pairs(finder, 1)
    [(begin, end)] = to_positions(finder, pairs)

    def peer(octomap: Any) -> Job:
        tree = octomap.OcTree(RES)
        centers = to_positions(finder, np.flatnonzero(~finder.free))
        tree.updateNodes(centers, True, lazy_eval=True)
        tree.updateInnerOccupancy()
        search = partial(search_octree, octomap, tree, begin, end, finder.voxels.bounds)
        return here("a loop in Python over octomap-python", search)

    job = here("a flight, house, voxels of 0.1 m", lambda: finder.find_path(begin, end))
    return beside(job, "octomap", peer, ratio=0.02)


def search_octree(
    octomap: Any,
    tree: Any,
    begin: NDArray[np.float64],
    end: NDArray[np.float64],
    bounds: NDArray[np.float64],
) -> float:
    """Search a route over 26 neighbours by A*, in an octree of voxels where the ball fits nowhere.

    Args:
        octomap: its module.
        tree: the octree; what it has no node for is free.
        begin: centre of the first voxel, world x, y, z [m].
        end: centre of the last voxel [m].
        bounds: lower and upper corner of the box in which the ball may fly [m], shape (2, 3).

    Returns:
        The length of the route [m]; infinite if there is none.
    """
    steps = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]
    lengths = [RES * math.hypot(*step) for step in steps]
    lower, upper = bounds.tolist()
    goal = tuple(np.round((end - begin) / RES).astype(int).tolist())
    costs = {(0, 0, 0): 0.0}
    queue = [(RES * math.dist(goal, (0, 0, 0)), (0, 0, 0))]
    is_done = set()
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == goal:
            return costs[goal]
        if cell in is_done:
            continue
        is_done.add(cell)
        for step, length in zip(steps, lengths, strict=True):
            neighbor = (cell[0] + step[0], cell[1] + step[1], cell[2] + step[2])
            cost = costs[cell] + length
            if cost >= costs.get(neighbor, math.inf):
                continue
            place = begin + RES * np.array(neighbor)
            if (place < lower).any() or (place > upper).any():
                continue
            try:
                if tree.isNodeOccupied(tree.search(place)):
                    continue
            except octomap.NullPointerException:
                pass  # it has no such node
            costs[neighbor] = cost
            heapq.heappush(queue, (cost + RES * math.dist(goal, neighbor), neighbor))
    return math.inf
