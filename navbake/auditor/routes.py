"""Checks a graph of routes on a grid for faults that a person would notice.

The distances of lanes to the squares of occupied cells are exact. No code is shared with the module
that makes graphs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from os import PathLike

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from navbake.auditor.facts import ERROR, REMARK, AuditReport, Facts, Finding, Remark
from navbake.errors import count_of
from navbake.formats.route_files import read_routes
from navbake.navgrid.grid import NavGrid
from navbake.routes.graph import FLOOR, Lane, RouteGraph, split_two_way_lanes
from navbake.types import Bool, Float, Vector3

MIN_ISLAND_AREA = 4.0  # larger islands need a node [m²]
TOUCH_SLACK = 1e-5  # a disc that overlaps something by less only touches it [m]
MAX_NAMES = 5  # number of names that a remark lists


def audit_routes(
    graph: RouteGraph | str | PathLike[str], grid: NavGrid, *, radius: float | None = None
) -> AuditReport:
    """Check a graph of routes for lanes that cross walls, and for unreached places.

    Args:
        graph: the graph, or the path of its file.
        grid: a grid of the graph's scene, inflated or not.
        radius: the agent's radius [m]; None for the radius that the graph states.

    Returns:
        The remarks, errors first.

    Raises:
        FormatError: the file can't be read.
    """
    if not isinstance(graph, RouteGraph):
        graph = read_routes(graph)
    facts = Facts(grid)
    if radius is None:
        radius = graph.radius
    findings = {
        "nodes": check_nodes(graph, facts),
        "lanes": check_lanes(graph, facts, radius),
        "parts": check_components(graph),
        "dead ends": check_dead_ends(graph),
        "islands": check_islands(graph, facts),
    }
    remarks = [
        Remark(check_name, *finding)
        for check_name, check_findings in findings.items()
        for finding in check_findings
    ]
    remarks.sort(key=lambda remark: remark.severity != ERROR)
    return AuditReport(graph.scene_id, remarks, list(findings))


def check_nodes(graph: RouteGraph, facts: Facts) -> Iterator[Finding]:
    """Find nodes on no level, outside the grid, or in a cell that isn't free."""
    for node in graph.nodes:
        problem = None
        if node.level >= len(facts.levels):
            problem = f"is on level {node.level}, which the grid hasn't"
        else:
            lattice = facts.levels[node.level].lattice
            row, col = lattice.rows_cols(node.position)
            if not lattice.holds(row, col):
                problem = "lies outside of the grid"
            elif not facts.passable[node.level][row, col]:
                problem = "stands where no cell is free"
        if problem:
            yield Finding(ERROR, node.level, node.position, f"node {node.name!r} {problem}")


def check_lanes(graph: RouteGraph, facts: Facts, radius: float) -> Iterator[Finding]:
    """Find straight lanes that cross occupied cells, or pass them nearer than the radius."""
    for lane in graph.lanes:
        start = graph.nodes[lane.start]
        end = graph.nodes[lane.end]
        is_straight = lane.kind == FLOOR and start.level == end.level
        if not is_straight or start.level >= len(facts.levels):
            continue
        clearance, place = measure_lane_clearance(graph, lane, facts, radius)
        if clearance == 0.0:
            text = f"lane {lane.name!r} crosses what is occupied"
            yield Finding(ERROR, start.level, place, text)
        elif clearance < radius - TOUCH_SLACK:
            if radius <= facts.grid.inflated_radius + TOUCH_SLACK and _runs_in_free_cells(
                graph, lane, facts
            ):
                continue
            text = f"lane {lane.name!r} passes an obstacle at {clearance:.3f} m"
            text += f", the agent needs {radius:g} m"
            yield Finding(ERROR, start.level, place, text)


def _runs_in_free_cells(graph: RouteGraph, lane: Lane, facts: Facts) -> bool:
    """Whether all cells that a lane runs through are free.

    In a grid that was inflated for its agent, such a lane is free for it, whatever the obstacles
    are: a map doesn't show where they end.
    """
    is_free = facts.free[graph.nodes[lane.start].level]
    clearance, _ = measure_lane_clearance(graph, lane, facts, 0.0, is_solid=~is_free)
    return clearance > 0.0


def measure_lane_clearance(
    graph: RouteGraph, lane: Lane, facts: Facts, radius: float, is_solid: Bool | None = None
) -> tuple[float, Vector3]:
    """Return the distance from a lane to the nearest occupied cell, and the position of that cell.

    A cell counts as a square, and a cell without a floor as occupied. Squares where another level
    has a free cell, within the agent's height of the lane, don't count: stairs continue there.

    Args:
        graph: the lane's graph.
        lane: a lane along a straight line on one level.
        facts: the facts about the grid.
        radius: the largest distance to search [m].
        is_solid: the cells that count as occupied, shape (height, width) of the lane's level; None
            for those of its layer `solid`.

    Returns:
        The distance [m], inf if no square is within the radius; and the square's centre, at the
        lane's height.
    """
    start = graph.nodes[lane.start]
    end = graph.nodes[lane.end]
    level = facts.levels[start.level]
    lattice = level.lattice
    lane_ends = np.array([start.position, end.position])
    margin = radius + lattice.cell_size
    lower_left = lane_ends.min(axis=0)[:2] - margin
    upper_right = lane_ends.max(axis=0)[:2] + margin
    (bottom_row, top_row), (left_col, right_col) = lattice.rows_cols(
        np.array([lower_left, upper_right])
    )
    first_row = max(int(top_row), 0)
    first_col = max(int(left_col), 0)
    if is_solid is None:
        is_solid = level.solid != 0
    is_near_solid = is_solid[first_row : int(bottom_row) + 1, first_col : int(right_col) + 1]
    rows, cols = np.nonzero(is_near_solid)
    centers = lattice.positions(rows + first_row, cols + first_col)
    centers = centers[~_mark_free_on_other_level(facts, start.level, centers, lane_ends[:, 2])]
    if not len(centers):
        return math.inf, start.position
    distances = measure_distances_to_squares(lane_ends[:, :2], centers, lattice.cell_size / 2)
    nearest_index = int(np.argmin(distances))
    x, y = centers[nearest_index].tolist()
    clearance = float(distances[nearest_index]) if distances[nearest_index] <= radius else math.inf
    return clearance, (x, y, start.position[2])


def _mark_free_on_other_level(
    facts: Facts, lane_level: int, positions: Float, lane_heights: Float
) -> Bool:
    """Mark positions at which another level has a free cell near the heights of a lane.

    Args:
        facts: the facts about the grid.
        lane_level: the index of the lane's level.
        positions: world x, y, shape (n, 2) [m].
        lane_heights: the heights of the lane's two ends, shape (2,) [m].

    Returns:
        A mask of the positions, shape (n,).
    """
    has_free_cell = np.zeros(len(positions), dtype=np.bool_)
    for level_number, level in enumerate(facts.levels):
        row, col = level.lattice.rows_cols(positions)
        is_inside = level.lattice.holds(row, col)
        if level_number == lane_level or not is_inside.any():
            continue
        row = row[is_inside]
        col = col[is_inside]
        floor = facts.floors[level_number][row, col]
        agent_height = facts.grid.agent_height
        is_near = (floor > lane_heights.min() - agent_height) & (
            floor < lane_heights.max() + agent_height
        )  # False for NaN
        has_free_cell[is_inside] |= is_near & level.free_for_point[row, col]
    return has_free_cell


def measure_distances_to_squares(ends: Float, centers: Float, half_edge: float) -> Float:
    """Return the distances from a line segment to axis-aligned squares.

    Args:
        ends: the ends of the segment, shape (2, 2) [m].
        centers: the centres of the squares, shape (n, 2) [m].
        half_edge: half of a square's edge [m].

    Returns:
        Distances, shape (n,) [m]; 0 where the segment enters the square.
    """
    start = ends[0]
    direction = ends[1] - ends[0]
    # the shares of the segment at which it enters and leaves each square's strips along x and y
    inner_half = half_edge - TOUCH_SLACK
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing_fractions = np.sort(
            [(centers + side - start) / direction for side in (-inner_half, inner_half)], axis=0
        )
    # a segment along an axis is in a strip of the other axis always or never
    is_in_strip = np.abs(centers - start) < inner_half
    entry_of_parallel = np.where(is_in_strip, -np.inf, np.inf)
    entry_fractions = np.where(direction == 0, entry_of_parallel, crossing_fractions[0]).max(axis=1)
    exit_fractions = np.where(direction == 0, -entry_of_parallel, crossing_fractions[1]).min(axis=1)
    is_entered = np.maximum(entry_fractions, 0.0) <= np.minimum(exit_fractions, 1.0)
    # otherwise, the shortest distance is from an end to the square, or from a corner to the segment
    distances = []
    for end in ends:
        offsets = np.maximum(np.abs(centers - end) - half_edge, 0.0)
        distances.append(np.linalg.norm(offsets, axis=1))
    for corner in half_edge * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]):
        corner_offset = centers + corner - start
        fractions = corner_offset @ direction / max(float(direction @ direction), 1e-300)
        nearest_offset = np.clip(fractions, 0.0, 1.0)[:, None] * direction
        distances.append(np.linalg.norm(corner_offset - nearest_offset, axis=1))
    return np.where(is_entered, 0.0, np.min(distances, axis=0))


def check_components(graph: RouteGraph) -> Iterator[Finding]:
    """Find nodes that no lanes connect with most others, and lanes without a way back."""
    if not graph.nodes:
        yield Finding(ERROR, None, None, "the graph has no nodes")
        return
    num_nodes = len(graph.nodes)
    lane_ends = np.array(
        [(lane.start, lane.end) for lane in split_two_way_lanes(graph.lanes)]
    ).reshape(-1, 2)
    adjacency = csr_array(
        (np.ones(len(lane_ends)), tuple(lane_ends.T)), shape=(num_nodes, num_nodes)
    )
    _, component_of_node = connected_components(adjacency, directed=False)
    component_sizes = np.bincount(component_of_node)
    _, first_nodes = np.unique(component_of_node, return_index=True)
    for component_number in np.argsort(-component_sizes, kind="stable")[1:].tolist():
        node = graph.nodes[int(first_nodes[component_number])]
        node_count_text = count_of(int(component_sizes[component_number]), "node")
        text = f"no lane joins {node_count_text}, {node.name!r} first, with most others"
        yield Finding(REMARK, node.level, node.position, text)
    _, strong_component_of_node = connected_components(adjacency, connection="strong")
    for lane in graph.lanes:
        if strong_component_of_node[lane.start] != strong_component_of_node[lane.end]:
            start = graph.nodes[lane.start]
            end = graph.nodes[lane.end]
            text = f"no lanes lead back from {end.name!r} to {start.name!r}"
            yield Finding(REMARK, end.level, end.position, text)


def check_dead_ends(graph: RouteGraph) -> Iterator[Finding]:
    """Find junctions and waypoints with fewer than two neighbours."""
    neighbors: list[set[int]] = [set() for _ in graph.nodes]
    for lane in graph.lanes:
        neighbors[lane.start].add(lane.end)
        neighbors[lane.end].add(lane.start)
    dead_ends = [
        node
        for node, node_neighbors in zip(graph.nodes, neighbors, strict=True)
        if len(node_neighbors) < 2 and node.kind in ("junction", "waypoint")
    ]
    if dead_ends:
        names = ", ".join(repr(node.name) for node in dead_ends[:MAX_NAMES])
        ellipsis = ", …" if len(dead_ends) > MAX_NAMES else ""
        text = f"{count_of(len(dead_ends), 'dead end')}: {names}{ellipsis}"
        yield Finding(REMARK, dead_ends[0].level, dead_ends[0].position, text)


def check_islands(graph: RouteGraph, facts: Facts) -> Iterator[Finding]:
    """Find large islands of the grid, with doors and links as they are, that have no node."""
    areas: dict[int, float] = {}
    for level, islands in zip(facts.levels, facts.islands, strict=True):
        for island, num_cells in enumerate(np.bincount(islands.ravel()).tolist()):
            areas[island] = areas.get(island, 0.0) + num_cells * level.lattice.cell_size**2
    reached_islands = set()
    for node in graph.nodes:
        if node.level < len(facts.levels):
            lattice = facts.levels[node.level].lattice
            row, col = lattice.rows_cols(node.position)
            if lattice.holds(row, col):
                reached_islands.add(int(facts.islands[node.level][row, col]))
    for island, area in areas.items():
        if island == 0 or area < MIN_ISLAND_AREA or island in reached_islands:
            continue
        level_number = next(
            level_index
            for level_index, islands in enumerate(facts.islands)
            if (islands == island).any()
        )
        place = facts.find_first_position(level_number, facts.islands[level_number] == island)
        yield Finding(REMARK, level_number, place, f"no node is on island {island} ({area:.2f} m²)")
