"""Looks at a graph of routes on a grid for what a person would notice.

Lanes are held against occupied squares by exact distances; nothing here is shared with what makes
graphs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from os import PathLike

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from navbake.auditor.facts import ERROR, REMARK, AuditReport, Facts, Found, Remark
from navbake.errors import count_of
from navbake.formats.route_files import read_routes
from navbake.navgrid.grid import NavGrid
from navbake.routes.graph import FLOOR, Lane, RouteGraph, directed
from navbake.types import Bool, Float, Vector3

LEAST_AREA = 4.0  # m² of an island that has to be reached
SLACK = 1e-5  # metres by which a disc may overlap what it touches
SHOWN = 5  # names that a remark lists


def audit_routes(
    graph: RouteGraph | str | PathLike[str], grid: NavGrid, *, radius: float | None = None
) -> AuditReport:
    """Look at a graph of routes, or its file, for lanes that cross walls and what isn't reached.

    The grid is of the graph's scene, inflated or not, or a map of one level. The agent's `radius`
    is that of the graph if None [m]. Raises a FormatError if the file can't be read.
    """
    if not isinstance(graph, RouteGraph):
        graph = read_routes(graph)
    facts = Facts(grid)
    radius = graph.radius if radius is None else radius
    checks = {
        "nodes": check_nodes(graph, facts),
        "lanes": check_lanes(graph, facts, radius),
        "parts": check_parts(graph),
        "dead ends": check_dead_ends(graph),
        "islands": check_islands(graph, facts),
    }
    remarks = [Remark(name, *entry) for name, found in checks.items() for entry in found]
    remarks.sort(key=lambda remark: remark.severity != ERROR)
    return AuditReport(graph.scene_id, remarks, list(checks))


def check_nodes(graph: RouteGraph, facts: Facts) -> Iterator[Found]:
    for node in graph.nodes:
        what = None
        if node.level >= len(facts.levels):
            what = f"is on level {node.level}, which the grid hasn't"
        else:
            lattice = facts.levels[node.level].lattice
            row, col = lattice.rows_cols(node.position)
            if not lattice.holds(row, col):
                what = "lies outside of the grid"
            elif not facts.passable[node.level][row, col]:
                what = "stands where no cell is free"
        if what:
            yield ERROR, node.level, node.position, f"node {node.name!r} {what}"


def check_lanes(graph: RouteGraph, facts: Facts, radius: float) -> Iterator[Found]:
    for lane in graph.lanes:
        one = graph.nodes[lane.start]
        other = graph.nodes[lane.end]
        if lane.kind != FLOOR or one.level != other.level or one.level >= len(facts.levels):
            continue
        clear, at = lane_clearance(graph, lane, facts, radius)
        if clear < radius - SLACK or clear == 0.0:
            what = "crosses what is occupied" if clear == 0.0 else f"passes it at {clear:.3f} m"
            needs = f", the agent needs {radius:g} m" if clear else ""
            yield ERROR, one.level, at, f"lane {lane.name!r} {what}{needs}"


def lane_clearance(
    graph: RouteGraph, lane: Lane, facts: Facts, radius: float
) -> tuple[float, Vector3]:
    """The distance from a lane to the nearest occupied square within a radius [m], and where it is.

    Cells without a floor count as occupied. Squares where another level has a free cell, within
    the agent's height of the lane, don't: they are where stairs go on. inf if there is nothing.
    """
    one = graph.nodes[lane.start]
    other = graph.nodes[lane.end]
    level = facts.levels[one.level]
    ends = np.array([one.position, other.position])
    lattice = level.lattice
    reach = radius + level.lattice.cell_size
    corners = np.array([ends.min(axis=0)[:2] - reach, ends.max(axis=0)[:2] + reach])
    (bottom, top), (left, right) = lattice.rows_cols(corners)
    window = np.s_[max(int(top), 0) : int(bottom) + 1, max(int(left), 0) : int(right) + 1]
    rows, cols = np.nonzero(level.solid[window])
    rows = rows + window[0].start
    cols = cols + window[1].start
    centers = lattice.positions(rows, cols)
    centers = centers[~_is_over(facts, one.level, centers, ends[:, 2])]
    if not len(centers):
        return math.inf, one.position
    far = distances(ends[:, :2], centers, lattice.cell_size / 2)
    nearest = int(np.argmin(far))
    x, y = centers[nearest].tolist()
    return (float(far[nearest]) if far[nearest] < radius else math.inf), (x, y, one.position[2])


def _is_over(facts: Facts, number: int, places: Float, z: Float) -> Bool:
    """Whether another level has a free cell at places x, y near the heights of a lane [m]."""
    found = np.zeros(len(places), dtype=np.bool_)
    for other, level in enumerate(facts.levels):
        row, col = level.lattice.rows_cols(places)
        inside = level.lattice.holds(row, col)
        if other == number or not inside.any():
            continue
        row = row[inside]
        col = col[inside]
        floor = facts.floors[other][row, col]
        reach = facts.grid.agent_height
        near = (floor > z.min() - reach) & (floor < z.max() + reach)  # False for NaN
        found[inside] |= near & level.free_for_point[row, col]
    return found


def distances(ends: Float, centers: Float, half: float) -> Float:
    """Distances from a line to squares along the axes, shape (n,); 0 where it enters them [m].

    `ends` has shape (2, 2), `centers` (n, 2); a square reaches `half` to each side.
    """
    start = ends[0]
    way = ends[1] - ends[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (-half + SLACK, half - SLACK)
        cuts = np.sort([(centers + side - start) / way for side in sides], axis=0)
    within = np.abs(centers - start) < half - SLACK  # of a line along an axis
    enter = np.where(way == 0, np.where(within, -np.inf, np.inf), cuts[0]).max(axis=1)
    leave = np.where(way == 0, np.where(within, np.inf, -np.inf), cuts[1]).min(axis=1)
    meets = np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)
    beyond = [np.linalg.norm(np.maximum(np.abs(centers - end) - half, 0.0), axis=1) for end in ends]
    for corner in half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]):
        own = centers + corner - start
        share = np.clip(own @ way / max(float(way @ way), 1e-300), 0.0, 1.0)
        beyond.append(np.linalg.norm(own - share[:, None] * way, axis=1))
    return np.where(meets, 0.0, np.min(beyond, axis=0))


def check_parts(graph: RouteGraph) -> Iterator[Found]:
    if not graph.nodes:
        yield ERROR, None, None, "the graph has no nodes"
        return
    size = len(graph.nodes)
    ends = np.array([(lane.start, lane.end) for lane in directed(graph.lanes)]).reshape(-1, 2)
    matrix = csr_array((np.ones(len(ends)), tuple(ends.T)), shape=(size, size))
    _, part = connected_components(matrix, directed=False)
    sizes = np.bincount(part)
    for number in np.argsort(-sizes, kind="stable")[1:].tolist():
        node = graph.nodes[int(np.argmax(part == number))]
        text = f"{count_of(int(sizes[number]), 'node')} from {node.name!r} on are a part apart"
        yield REMARK, node.level, node.position, text
    _, strong = connected_components(matrix, connection="strong")
    lanes = [lane for lane in graph.lanes if strong[lane.start] != strong[lane.end]]
    for lane in lanes:
        start = graph.nodes[lane.start]
        end = graph.nodes[lane.end]
        text = f"no lanes lead back from {end.name!r} to {start.name!r}"
        yield REMARK, end.level, end.position, text


def check_dead_ends(graph: RouteGraph) -> Iterator[Found]:
    ends: list[set[int]] = [set() for _ in graph.nodes]
    for lane in graph.lanes:
        ends[lane.start].add(lane.end)
        ends[lane.end].add(lane.start)
    found = [node for node, own in zip(graph.nodes, ends, strict=True) if len(own) < 2]
    found = [node for node in found if node.kind in ("junction", "waypoint")]
    if found:
        listed = ", ".join(repr(node.name) for node in found[:SHOWN])
        more = ", …" if len(found) > SHOWN else ""
        text = f"{count_of(len(found), 'dead end')}: {listed}{more}"
        yield REMARK, found[0].level, found[0].position, text


def check_islands(graph: RouteGraph, facts: Facts) -> Iterator[Found]:
    """Islands of the grid, as it is, that are large and have no node."""
    areas: dict[int, float] = {}
    for level, islands in zip(facts.levels, facts.islands, strict=True):
        for number, count in enumerate(np.bincount(islands.ravel()).tolist()):
            areas[number] = areas.get(number, 0.0) + count * level.lattice.cell_size**2
    reached = set()
    for node in graph.nodes:
        if node.level < len(facts.levels):
            lattice = facts.levels[node.level].lattice
            row, col = lattice.rows_cols(node.position)
            if lattice.holds(row, col):
                reached.add(int(facts.islands[node.level][row, col]))
    for number, area in areas.items():
        if number and area >= LEAST_AREA and number not in reached:
            on = next(k for k, islands in enumerate(facts.islands) if (islands == number).any())
            text = f"no node is on island {number} ({area:.2f} m²)"
            yield REMARK, on, facts.first(on, facts.islands[on] == number), text
