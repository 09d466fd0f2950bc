"""Poses the leaves of doors in each of their states, and finds the cells that they block.

A leaf is a body that may be a door, see `DoorCandidate`. All leaves are posed, also those that turn
out to be no doors. The cells that a leaf blocks are found above the floors of structure, regardless
of other geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import Columns, TiledShapes, cast_columns, tile_shapes
from navbake.baker.core.constants import HINGE
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import Window
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.geometry.extents import Extents, measure_extents
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import check_occupancy
from navbake.baker.rooms.leaves import ClosedLeaf, LeafLines
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.leaves import (
    DoorCandidate,
    find_geom_of_largest_side,
    mark_candidate_geoms,
)
from navbake.baker.scene.pose import data_with_joints
from navbake.baker.scene.scene import Scene
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import DOOR_STATES
from navbake.threads import limit_threads
from navbake.types import Float, Int

# The length of lines of sight from each side of a closed leaf [m]; they reach at least this many
# cells beyond those that the leaf blocks [cells]
SIGHT_LENGTH = 0.6
SIGHT_CELLS = 2.0
# How far beyond a leaf's ends a frame is looked for, if it is no wall [m]
FRAME_LENGTH = 0.5
# Where lines of sight begin along the leaf, as shares of its width from its middle; not at its
# ends, where the frame is
SIGHT_OFFSETS = (-0.3, -0.15, 0.0, 0.15, 0.3)
# A door's top that agents could walk on is worth a warning if it has at least this area [m²]
MIN_CARRIED_AREA = 0.5

CellsByState = Mapping[str, Sequence[Int]]
"""State of a door -> for each level, ids of cells on the whole lattice, ascending."""


class LeafWindow(NamedTuple):
    """The window of the lattice near a leaf in one state.

    Attributes:
        window: the window's rows and columns of the whole lattice.
        tiled_shapes: the leaf's geometry, by tiles of the window.
        columns: the leaf's hits on the vertical line through the centre of each cell of the window.
    """

    window: Window
    tiled_shapes: TiledShapes
    columns: Columns


@dataclass(frozen=True, eq=False)
class Leaf:
    """The geometry of a door candidate in each of its states.

    Attributes:
        candidate: the door candidate of the scene.
        windows: by state, the window of the lattice near the leaf, None if no cell is near. States
            with the same joint position share a window.
        lines: the cells along straight lines that start at the closed leaf: on both sides of it,
            and beyond its two ends. None if the leaf has no finite geometry.
        top_shapes: the leaf's geometry by state; only of states in which the leaf, seen from above,
            is large enough to walk on.
        width: horizontal width of the closed leaf, along its longer side [m]; None if it has no
            finite geometry.
        travel_text: how far the leaf's joint opens it, as text with the unit; empty without a
            joint.
    """

    candidate: DoorCandidate
    windows: dict[str, LeafWindow | None]
    lines: LeafLines | None
    top_shapes: dict[str, Shapes]
    width: float | None
    travel_text: str


@dataclass(frozen=True, eq=False)
class LeafCells:
    """The cells that a leaf's own geometry blocks, in each state.

    Attributes:
        leaf: the leaf.
        blocked: state -> for each level, ids of the cells where the leaf overlaps the footprint of
            an agent at the cell's centre (the cell's square joined with the agent's disc).
        blocked_squares: the same for the cell's own square, without the disc; empty if the disc
            doesn't reach beyond the square.
    """

    leaf: Leaf
    blocked: CellsByState
    blocked_squares: CellsByState

    @property
    def closed_leaf(self) -> ClosedLeaf:
        """The cells and lines of the closed leaf, from which rooms are found."""
        return ClosedLeaf(self.blocked["closed"], self.leaf.lines)


# ---------------------------------------------------------------- geometry


def pose_shapes(scene: Scene, doors: Sequence[DoorCandidate], state: str) -> Shapes:
    """Return the geometry of door candidates in a state.

    A candidate without that state is returned as modelled.

    Args:
        scene: the scene of the candidates.
        doors: the candidates.
        state: one of `DOOR_STATES` except ``removed``.
    """
    is_door_geom = mark_candidate_geoms(scene.model.ngeom, doors)
    joint_positions: dict[int, float] = {}
    for door in doors:
        position = door.position(state)
        if position is not None and position != door.positions["modelled"]:
            joint_positions[door.joint_id] = float(position)
    if not joint_positions:
        return scene.shapes.only(is_door_geom)
    posed_data = data_with_joints(scene.model, scene.data, joint_positions)
    shapes, *_ = collect_shapes(
        scene.model,
        posed_data,
        selections=scene.selections,
        exact_meshes=scene.exact_meshes,
        geom_ids=np.flatnonzero(is_door_geom).tolist(),
        meshes=scene.meshes,
    )
    return shapes


def pose_leaves(
    scene: Scene, candidates: Sequence[DoorCandidate], lattice: Lattice, reach: float
) -> list[Leaf]:
    """Pose door candidates in each state, and find which vertical lines of cells meet them.

    Args:
        scene: the scene of the candidates.
        candidates: the door candidates to pose.
        lattice: the whole lattice.
        reach: cells farther from a leaf than this are left out [m].

    Returns:
        A leaf for each candidate, in the same order.
    """
    if not candidates:
        return []
    shapes_by_state = {
        state: pose_shapes(scene, candidates, state) for state in DOOR_STATES if state != "removed"
    }
    extents_by_state = {
        state: measure_extents(shapes, scene.model.ngeom)
        for state, shapes in shapes_by_state.items()
    }
    with limit_threads(1):  # a door is too small to be worth more
        return [
            _pose_leaf(
                candidate,
                scene,
                shapes_by_state=shapes_by_state,
                extents_by_state=extents_by_state,
                lattice=lattice,
                reach=reach,
            )
            for candidate in candidates
        ]


def _pose_leaf(
    candidate: DoorCandidate,
    scene: Scene,
    shapes_by_state: Mapping[str, Shapes],
    extents_by_state: Mapping[str, Extents],
    lattice: Lattice,
    reach: float,
) -> Leaf:
    """Make the leaf of a door candidate.

    Args:
        candidate: the candidate.
        scene: the scene of the candidate.
        shapes_by_state: state -> the geometry of all candidates.
        extents_by_state: state -> bounding boxes of the geoms of all candidates.
        lattice: the whole lattice.
        reach: how far from the geometry cells are considered [m].
    """
    leaf_shapes = {state: candidate.only(shapes) for state, shapes in shapes_by_state.items()}
    windows = dict[str, LeafWindow | None]()
    # states at one position of the joint share what the first of them finds
    first_state_at_position = dict[float | None, str]()
    for state, shapes in leaf_shapes.items():
        first_state = first_state_at_position.setdefault(candidate.position(state), state)
        if first_state == state:
            windows[state] = _cast_near_shapes(shapes, lattice, reach)
        else:
            windows[state] = windows[first_state]
    # seen from above, most doors are too small to walk on, which is quickly found
    top_shapes = dict[str, Shapes]()
    for state, extents in extents_by_state.items():
        area = np.nansum((extents.short_side * extents.long_side)[candidate.geoms])
        if area >= MIN_CARRIED_AREA - LIMIT_SLACK:
            top_shapes[state] = leaf_shapes[state]
    travel_text = ""
    if candidate.positions:
        opening_distance = abs(candidate.positions["open"] - candidate.positions["closed"])
        is_hinge = int(scene.model.jnt_type[candidate.joint_id]) == HINGE
        travel_text = (
            f"{np.degrees(opening_distance):.3g}°" if is_hinge else f"{opening_distance:.3g} m"
        )
    return Leaf(
        candidate=candidate,
        windows=windows,
        lines=_find_line_cells(extents_by_state["closed"], candidate.geoms, lattice, reach),
        top_shapes=top_shapes,
        width=_measure_width(extents_by_state["closed"], candidate.geoms),
        travel_text=travel_text,
    )


def _measure_width(extents: Extents, geoms: Int) -> float | None:
    """Measure how wide a leaf is, along the longer side of its largest geom [m].

    Args:
        extents: bounding boxes of all geoms, NaN where a geom has no finite geometry.
        geoms: ids of the leaf's geoms.

    Returns:
        The width, rounded to 0.1 mm; None without finite geometry.
    """
    finite_geoms = geoms[np.isfinite(extents.long_side[geoms])]
    if not len(finite_geoms):
        return None
    axis = extents.long_axis[find_geom_of_largest_side(extents, finite_geoms)]
    middles = extents.center[finite_geoms] @ axis
    half_widths = extents.half_widths(finite_geoms, axis)
    return round(float((middles + half_widths).max() - (middles - half_widths).min()), 4)


def _cast_near_shapes(shapes: Shapes, lattice: Lattice, reach: float) -> LeafWindow | None:
    """Find where the vertical lines of cells within `reach` [m] of shapes meet these shapes.

    Returns:
        The window with these cells, with the shapes and their hits; None if no cell is that near.
    """
    bounds = shapes.bounds
    window = None if bounds is None else lattice.window(bounds, reach)
    if window is None:
        return None
    tiled_shapes = tile_shapes(shapes, lattice.cut(*window), reach)
    return LeafWindow(window, tiled_shapes, cast_columns(tiled_shapes))


def _find_line_cells(
    extents: Extents, geoms: Int, lattice: Lattice, reach: float
) -> LeafLines | None:
    """Find the cells along lines away from the sides of a closed leaf, and on from its ends.

    Args:
        extents: bounding boxes of the geoms of closed leaves.
        geoms: ids of the leaf's geoms; the one with the largest side is the panel of the leaf.
        lattice: the whole lattice.
        reach: how far from its geometry the leaf may block cells [m].

    Returns:
        The cells along the lines; None if the leaf has no finite geometry.
    """
    panel_geom = find_geom_of_largest_side(extents, geoms)
    center = extents.center[panel_geom]
    if not np.isfinite(center).all():
        return None
    across_direction = extents.short_axis[panel_geom]
    along_direction = np.array([-across_direction[1], across_direction[0]])
    step_length = lattice.cell_size / 2
    both_sides = np.array([-1.0, 1.0])

    # lines of sight away from both sides: points of shape (sides, lines, steps, 2) [m]
    sight_length = max(SIGHT_LENGTH, reach + SIGHT_CELLS * lattice.cell_size)
    distances = extents.short_side[panel_geom] / 2 + np.arange(0.0, sight_length, step_length)
    start_points = (
        center + along_direction * np.array(SIGHT_OFFSETS)[:, None] * extents.long_side[panel_geom]
    )
    directions = across_direction * both_sides[:, None, None, None]
    sight_points = start_points[:, None] + directions * distances[:, None]

    # lines on from both ends: points of shape (ends, steps, 2) [m]
    distances = extents.long_side[panel_geom] / 2 + np.arange(
        0.0, FRAME_LENGTH + step_length, step_length
    )
    directions = along_direction * both_sides[:, None, None]
    end_points = center + directions * distances[:, None]
    return LeafLines(_cells_at(sight_points, lattice), _cells_at(end_points, lattice))


def _cells_at(points: Float, lattice: Lattice) -> Int:
    """Return the id of the cell that each point, (…, 2) [m], is in, -1 outside the lattice."""
    rows, cols = lattice.rows_cols(points)
    is_inside = (rows >= 0) & (rows < lattice.height) & (cols >= 0) & (cols < lattice.width)
    return np.where(is_inside, rows * lattice.width + cols, -1)


# ---------------------------------------------------------------- blocked cells


def find_blocked_cells(
    leaves: Sequence[Leaf], floors: Sequence[LevelFloor], footprint: Footprint, lattice: Lattice
) -> list[LeafCells]:
    """Find the cells that each leaf blocks in each state, over the floors of each level.

    Args:
        leaves: the posed leaves.
        floors: the floors of each level, on the whole lattice.
        footprint: the volume over a floor that has to be free.
        lattice: the whole lattice.

    Returns:
        The blocked cells of each leaf, in the order of `leaves`.
    """
    with limit_threads(1):  # a door is too small to be worth more
        return [_find_cells_by_state(leaf, floors, footprint, lattice) for leaf in leaves]


def _find_cells_by_state(
    leaf: Leaf, floors: Sequence[LevelFloor], footprint: Footprint, lattice: Lattice
) -> LeafCells:
    """Find the cells that a leaf blocks in each state, once for all states with the same pose."""
    no_cells: list[Int] = [np.empty(0, dtype=np.int64)] * len(floors)
    blocked = dict[str, list[Int]]()
    blocked_squares = dict[str, list[Int]]()
    for state, leaf_window in leaf.windows.items():
        states_in_same_pose = [
            earlier_state for earlier_state in blocked if leaf.windows[earlier_state] is leaf_window
        ]
        if leaf_window is None:
            blocked[state] = no_cells
            blocked_squares[state] = no_cells
        elif states_in_same_pose:
            blocked[state] = blocked[states_in_same_pose[0]]
            blocked_squares[state] = blocked_squares[states_in_same_pose[0]]
        else:
            blocked[state], blocked_squares[state] = _find_blocked(
                leaf_window, floors, footprint, lattice
            )
    # a leaf that can't move is closed as it is modelled; when it is open, it blocks nothing
    if not leaf.candidate.positions:
        blocked["open"] = no_cells
        blocked_squares["open"] = no_cells
    return LeafCells(leaf, blocked, blocked_squares if footprint.radius > 0.0 else {})


def _find_blocked(
    leaf_window: LeafWindow, floors: Sequence[LevelFloor], footprint: Footprint, lattice: Lattice
) -> tuple[list[Int], list[Int]]:
    """Find the cells that a leaf in one state blocks over the floors of each level.

    Args:
        leaf_window: the leaf's geometry, and the window of the lattice near it.
        floors: the floors of each level, on the whole lattice.
        footprint: the volume over a floor that has to be free.
        lattice: the whole lattice.

    Returns:
        For each level, the ids of the cells where the leaf overlaps the footprint; and the same for
        the cell's own square, without the agent's disc.
    """
    rows, cols = leaf_window.window
    blocked = list[Int]()
    blocked_squares = list[Int]()
    for level in floors:
        floor = level.floor[rows, cols].ravel()
        window_cells: Int = np.flatnonzero(~np.isnan(floor))
        occupancy = check_occupancy(
            leaf_window.columns,
            leaf_window.tiled_shapes,
            footprint,
            window_cells,
            floor[window_cells],
        )
        row, col = np.divmod(window_cells, cols.stop - cols.start)
        cells = (row + rows.start) * lattice.width + col + cols.start
        blocked.append(cells[occupancy.occupied])
        blocked_squares.append(cells[occupancy.square_occupied])
    return blocked, blocked_squares
