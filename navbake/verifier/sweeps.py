"""Checks what agents move along: paths, drops and jumps with their landings, and lift shafts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import NamedTuple

import fcl
import mujoco
import numpy as np

from navbake.baker.scene.names import body_name, find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene
from navbake.errors import FormatError
from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import Link
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import Path
from navbake.types import Float
from navbake.verifier.cells import compute_floor_tolerance
from navbake.verifier.probes import (
    TOUCHES,
    HeightRange,
    ObstacleProbe,
    PlacedPrism,
    UprightPrism,
)
from navbake.verifier.report import LINK_TOUCHES, NO_LANDING, PATH_TOUCHES, Finding, SweepCounts
from navbake.verifier.sample import STEP_SLACK, AgentSizes, CellNeighborhood

MAX_TRIES_PER_PATH = 20  # how often a start and a goal are drawn to find a path between them
MIN_STRETCH_LENGTH = 1e-6  # shorter parts of a path, at a corner of cells, belong to no cell [m]
SAME_FLOOR_TOLERANCE = 1e-4  # parts of a path whose floors differ by less are swept as one [m]
STRAIGHT_LINK_KINDS = ("drop", "jump")  # kinds of links that run straight between their stops
CAR_MOVE_SPACING = 0.02  # distance between the positions of a lift's car that are checked [m]
TOUCH_PLACE_LENGTH = 0.001  # length of the part of a path to which a touch is narrowed down [m]


class PathStretch(NamedTuple):
    """A straight part of a path over one floor, seen from above.

    Attributes:
        begin: World x and y of its begin, (2,) [m].
        end: World x and y of its end, (2,) [m].
        floor: The height of the floor that the path runs over [m].
        lowest_floor: The lowest floor under the swept cylinder, of those at most a step from
            `floor` [m].
        highest_floor: The highest of these floors [m].
        level_number: The number of its level, 0 for the lowest.
    """

    begin: Float
    end: Float
    floor: float
    lowest_floor: float
    highest_floor: float
    level_number: int


class SweptTouch(NamedTuple):
    """The first place of a stretch at which a swept cylinder touches an obstacle.

    Attributes:
        position: World x and y of the cylinder's axis, (2,) [m].
        obstacle: The obstacle's id.
        depth: How deep the cylinder runs into this obstacle on the whole stretch [m].
    """

    position: Float
    obstacle: int
    depth: float


class PathContacts(NamedTuple):
    """The touches of a cylinder that is swept along a path.

    Attributes:
        findings: The first touch within the heights that have to be free (see `PathSweep`); empty
            if there is none.
        touches_near_ends: Whether the cylinder touches anything outside of these heights, within a
            step of its lower or upper end.
    """

    findings: list[Finding]
    touches_near_ends: bool


class PathSweep:
    """Sweeps a cylinder along paths on a grid that is inflated for the cylinder.

    The cylinder is as high as the agent, less a step at its lower end. It must touch nothing
    between the highest floor under it plus a step, and the lowest floor under it plus the agent's
    height. What it touches above or below that is counted, but is no fault.

    Args:
        grid: The inflated grid.
        probe: The obstacles.
        agent: The agent that the grid was baked for.
        radius: The cylinder's radius [m].
        tolerance: By how much the cylinder is shrunk on all sides [m].
    """

    def __init__(
        self,
        grid: NavGrid,
        probe: ObstacleProbe,
        agent: AgentSizes,
        radius: float,
        tolerance: float,
    ) -> None:
        self._grid = grid
        self._probe = probe
        self._agent = agent
        self._radius = radius
        self._tolerance = tolerance
        self._neighborhood = CellNeighborhood(grid, agent.step)

    def sweep_random_paths(self, num_paths: int, seed: int) -> tuple[SweepCounts, list[Finding]]:
        """Plan paths between random places, and sweep the cylinder along each.

        Args:
            num_paths: How many paths to sweep; fewer if the grid has too few.
            seed: The seed of the random places.

        Returns:
            The counts, and a finding for each path that touches something.

        Raises:
            FormatError: The grid cannot be planned on.
        """
        counts = SweepCounts(self._radius)
        findings = list[Finding]()
        path_finder = PathFinder(self._grid)
        rng = np.random.default_rng(seed)
        for _ in range(num_paths * MAX_TRIES_PER_PATH):
            start = path_finder.random_point(rng) if counts.paths < num_paths else None
            if start is None:
                break
            goal = path_finder.random_point(rng, reachable_from=start)
            path = None if goal is None else path_finder.find_path(start, goal)
            if path is None or path.length == 0.0:
                continue
            contacts = self._sweep_path(path)
            counts.paths += 1
            counts.length += path.length
            counts.beside += contacts.touches_near_ends
            findings += contacts.findings
        counts.touching = len(findings)
        counts.length = round(counts.length, 6)
        return counts, findings

    def _sweep_path(self, path: Path) -> PathContacts:
        """Sweep the cylinder along a path, up to the first touch that is a fault."""
        touches_near_ends = False
        step = self._agent.step
        height = self._agent.height
        for stretch in self._split_path(path):
            free_range = HeightRange(stretch.highest_floor + step, stretch.lowest_floor + height)
            full_range = HeightRange(stretch.floor + step, stretch.floor + height)
            if self._find_touched_obstacle(stretch, free_range) is not None:
                finding = self._path_finding(stretch, free_range)
                return PathContacts([finding], touches_near_ends)
            if not touches_near_ends and free_range != full_range:
                touched_obstacle = self._find_touched_obstacle(stretch, full_range)
                touches_near_ends = touched_obstacle is not None
        return PathContacts([], touches_near_ends)

    def _path_finding(self, stretch: PathStretch, height_range: HeightRange) -> Finding:
        """Return the finding for a cylinder that touches something on a stretch of a path."""
        touch = self._find_first_touch(stretch, height_range)
        name = self._probe.obstacles.geom_name(touch.obstacle)
        depth = touch.depth + self._tolerance
        x, y = touch.position.tolist()
        row, col = self._grid.levels[stretch.level_number].lattice.rows_cols([x, y])
        text = f"a cylinder of {self._radius:g} m on a path touches {name!r} from this place on, "
        text += f"up to {depth:.4f} m deep, "
        text += f"between {height_range.low:.3f} and {height_range.high:.3f} m"
        return Finding(
            PATH_TOUCHES,
            level=stretch.level_number,
            cell=(int(row), int(col)),
            position=(x, y, stretch.floor),
            text=text,
            geom=name,
            size=depth,
        )

    def _find_first_touch(self, stretch: PathStretch, height_range: HeightRange) -> SweptTouch:
        """Return the first place of a stretch at which the cylinder touches something.

        The stretch is halved until the part that touches is shorter than `TOUCH_PLACE_LENGTH`.

        Args:
            stretch: A stretch on which the cylinder touches an obstacle.
            height_range: The heights between which it touches.
        """
        part = stretch
        while np.hypot(*(part.end - part.begin)) > TOUCH_PLACE_LENGTH:
            middle = (part.begin + part.end) / 2
            first_half = part._replace(end=middle)
            second_half = part._replace(begin=middle)
            if self._find_touched_obstacle(first_half, height_range) is not None:
                part = first_half
            elif self._find_touched_obstacle(second_half, height_range) is not None:
                part = second_half
            else:
                break  # the touch is so slight that it depends on rounding
        obstacle = self._find_touched_obstacle(part, height_range)
        assert obstacle is not None
        depths = [
            self._probe.measure_depth(prism, center, obstacle)
            for prism, center in self._swept_prisms(stretch, height_range)
            if self._probe.find_contact(obstacle, prism, center) == TOUCHES
        ]
        position = (part.begin + part.end) / 2
        # prisms of the whole stretch may touch by less than those of its part, by rounding
        return SweptTouch(position, obstacle, max(depths, default=0.0))

    def _split_path(self, path: Path) -> list[PathStretch]:
        """Split a path at the edges of cells, and join stretches with the same floor.

        Parts over links, such as drops, are left out: no agent walks there.
        """
        stretches: list[PathStretch] = []
        positions = path.positions
        levels = path.levels
        is_walked = np.ones(len(positions), dtype=np.bool_)
        for first_point, last_point in path.stops.tolist():
            is_walked[first_point:last_point] = False
        lattices = [level.lattice for level in self._grid.levels]
        for point_index, (begin, end) in enumerate(pairwise(positions)):
            if np.hypot(*(end - begin)[:2]) < MIN_STRETCH_LENGTH:
                continue  # a step up or down between the floors of two cells
            if not is_walked[point_index]:
                continue
            lattice = lattices[int(levels[point_index])]
            fractions = _find_cell_edge_fractions(lattice, begin, end)
            piece_ends = begin[:2] + np.outer(fractions, end[:2] - begin[:2])
            piece_middles = (piece_ends[1:] + piece_ends[:-1]) / 2
            middle_fractions = (fractions[1:] + fractions[:-1]) / 2
            path_heights = begin[2] + middle_fractions * (end[2] - begin[2])

            # where the path changes to another level, the nearer of the two levels' floors counts
            level_numbers = sorted({int(levels[point_index]), int(levels[point_index + 1])})
            rows_cols = [
                lattices[level_number].rows_cols(piece_middles) for level_number in level_numbers
            ]
            level_floors = np.stack(
                [
                    self._neighborhood.find_cells_on_level(
                        level_number, level_number, rows, cols
                    ).floor
                    for level_number, (rows, cols) in zip(level_numbers, rows_cols, strict=True)
                ]
            )
            height_gaps = np.nan_to_num(np.abs(level_floors - path_heights), nan=np.inf)
            nearest_level_index = height_gaps.argmin(axis=0)
            piece_floors = np.take_along_axis(level_floors, nearest_level_index[None], axis=0)[0]
            piece_floors = np.where(np.isnan(piece_floors), path_heights, piece_floors)

            # the cylinder's axis may be half of a cell's diagonal away from the cell's centre
            floor_radius = self._radius + lattice.cell_size * np.sqrt(0.5)
            floors_under = [
                self._neighborhood.find_floors_under(
                    level_number, rows, cols, piece_floors, floor_radius
                )
                for level_number, (rows, cols) in zip(level_numbers, rows_cols, strict=True)
            ]
            for piece_index, nearest_index in enumerate(nearest_level_index.tolist()):
                lowest_floor, highest_floor = floors_under[nearest_index]
                stretch = PathStretch(
                    begin=piece_ends[piece_index],
                    end=piece_ends[piece_index + 1],
                    floor=float(piece_floors[piece_index]),
                    lowest_floor=float(lowest_floor[piece_index]),
                    highest_floor=float(highest_floor[piece_index]),
                    level_number=level_numbers[nearest_index],
                )
                if piece_index and _has_same_floors(stretches[-1], stretch):
                    stretches[-1] = stretches[-1]._replace(end=stretch.end)
                else:
                    stretches.append(stretch)
        return stretches

    def _find_touched_obstacle(self, stretch: PathStretch, height_range: HeightRange) -> int | None:
        """Return an obstacle that the cylinder touches on a stretch, between two heights."""
        swept_prisms = self._swept_prisms(stretch, height_range)
        if not swept_prisms:
            return None
        radius = self._radius - self._tolerance
        low_corner = np.minimum(stretch.begin, stretch.end) - radius
        high_corner = np.maximum(stretch.begin, stretch.end) + radius
        obstacles = self._probe.obstacles.find_overlapping(
            np.array([*low_corner, height_range.low + self._tolerance]),
            np.array([*high_corner, height_range.high - self._tolerance]),
        )
        for obstacle in obstacles:
            for prism, center in swept_prisms:
                if self._probe.find_contact(obstacle, prism, center) == TOUCHES:
                    return obstacle
        return None

    def _swept_prisms(self, stretch: PathStretch, height_range: HeightRange) -> list[PlacedPrism]:
        """Return the swept volume: the cylinder at both ends of a stretch, and a box between them.

        It is empty where the heights leave nothing of the cylinder.
        """
        half_z = (height_range.high - height_range.low) / 2 - self._tolerance
        if half_z <= 0:
            return []
        radius = self._radius - self._tolerance
        middle_z = (height_range.low + height_range.high) / 2
        stretch_vector = stretch.end - stretch.begin
        middle_xy = (stretch.begin + stretch.end) / 2
        yaw = float(np.arctan2(stretch_vector[1], stretch_vector[0]))
        cylinder = UprightPrism(radius, radius, half_z, True)
        box = UprightPrism(float(np.hypot(*stretch_vector)) / 2, radius, half_z, False, yaw)
        return [
            PlacedPrism(cylinder, np.array([*stretch.begin, middle_z])),
            PlacedPrism(cylinder, np.array([*stretch.end, middle_z])),
            PlacedPrism(box, np.array([*middle_xy, middle_z])),
        ]


def _has_same_floors(stretch: PathStretch, next_stretch: PathStretch) -> bool:
    """Return whether two stretches of a straight line can be swept as one."""
    if stretch.level_number != next_stretch.level_number:
        return False
    floors = (stretch.floor, stretch.lowest_floor, stretch.highest_floor)
    next_floors = (next_stretch.floor, next_stretch.lowest_floor, next_stretch.highest_floor)
    return np.allclose(floors, next_floors, rtol=0, atol=SAME_FLOOR_TOLERANCE)


def _find_cell_edge_fractions(lattice: Lattice, begin: Float, end: Float) -> Float:
    """Return where a line crosses cells' edges, as fractions of its length, 0 to 1, ascending."""
    fractions = np.array([0.0, 1.0])
    lattice_corner = np.array([lattice.x_min, lattice.y_max])
    begin_in_cells = (begin[:2] - lattice_corner) / lattice.cell_size
    end_in_cells = (end[:2] - lattice_corner) / lattice.cell_size
    for begin_coordinate, end_coordinate in zip(begin_in_cells, end_in_cells, strict=True):
        edge_coordinates = np.arange(
            np.floor(min(begin_coordinate, end_coordinate)) + 1,
            np.ceil(max(begin_coordinate, end_coordinate)),
        )
        fractions = np.append(
            fractions,
            (edge_coordinates - begin_coordinate) / (end_coordinate - begin_coordinate or 1.0),
        )
    fractions = np.unique(fractions)
    # a line through a corner of cells runs through none of the cells beside the corner
    min_fraction = MIN_STRETCH_LENGTH / np.hypot(*(end - begin)[:2])
    return np.asarray(fractions[np.diff(fractions, append=2.0) > min_fraction])


def check_links(
    grid: GridBase, scene: Scene, probe: ObstacleProbe, agent: AgentSizes, tolerance: float
) -> tuple[list[Finding], list[str]]:
    """Check the drops and jumps of a grid, and the lifts that the bake detected.

    In a drop or a jump, the agent's body must touch nothing over each cell between the stops, at
    the height of the higher stop's floor. Over the landing it must touch nothing from there down,
    and the landing's floor must be a surface. The car of a lift must touch nothing between the ends
    of its joint's range. If the links cannot be read, nothing is checked: the audit reports that.

    Args:
        grid: The grid.
        scene: The scene, in the pose that the probe's obstacles were made in.
        probe: The obstacles.
        agent: The agent that the grid was baked for.
        tolerance: By how much the agent's body, and the range of a car, are shrunk [m].

    Returns:
        The findings, and a note for each lift whose car is not in the scene.
    """
    try:
        links = grid.links
    except FormatError:
        return [], []
    findings = list[Finding]()
    notes = list[str]()
    model = scene.model
    body_names = [body_name(model, body) for body in range(model.nbody)] if links else []
    for link in links:
        if link.kind in STRAIGHT_LINK_KINDS and len(link.stops) == 2:
            findings += _check_drop_or_jump(link, grid, probe, agent, tolerance)
        elif link.kind == "lift" and link.auto:
            # the car's body has the link's name, to which the bake may have added a number
            for name in (link.name, link.name.rpartition("#")[0]):
                car_body = body_names.index(name) if name in body_names else 0
                joint_id = int(model.body_jntadr[car_body])
                if joint_id >= 0 and model.jnt_type[joint_id] == mujoco.mjtJoint.mjJNT_SLIDE:
                    findings += _check_shaft(link, car_body, grid, scene, probe, tolerance)
                    break
            else:
                notes.append(f"lift {link.name!r} was not checked: no body of its name slides")
    return findings, notes


class WalkedPart(NamedTuple):
    """How far an agent walks along a link before it has to leave the floor.

    Attributes:
        last_point_index: The index of the last point on the floor, -1 for none.
        floor: The height of the floor there [m].
    """

    last_point_index: int
    floor: float


def _walk_from_stop(level: SceneGrid2D, line_points: Float, max_step: float) -> WalkedPart:
    """Return how far an agent walks on a level over points of a straight line, (n, 2) [m].

    It ends before the first point that is not free, has no floor, or is more than a step higher or
    lower than the point before.
    """
    rows, cols = level.lattice.rows_cols(line_points)
    is_inside = level.lattice.holds(rows, cols)
    rows = rows[is_inside]
    cols = cols[is_inside]
    floor_heights = level.floor_of(rows, cols)
    is_too_high_step = (
        np.abs(np.diff(floor_heights, prepend=floor_heights[:1])) > max_step + STEP_SLACK
    )
    is_blocked = ~level.free[rows, cols] | np.isnan(floor_heights) | is_too_high_step
    last_point_index = int(np.argmax(np.append(is_blocked, True))) - 1
    return WalkedPart(last_point_index, float(floor_heights[max(last_point_index, 0)]))


def _check_drop_or_jump(
    link: Link, grid: GridBase, probe: ObstacleProbe, agent: AgentSizes, tolerance: float
) -> list[Finding]:
    """Check that a drop or a jump touches nothing, and lands on a surface."""
    stop_positions = []
    for stop in link.stops:
        level = grid.levels[stop.level]
        row, col = divmod(stop.cell, level.width)
        stop_positions.append(level.lattice.positions(row, col))
    start_position, end_position = stop_positions
    start_level = grid.levels[link.stops[0].level]
    end_level = grid.levels[link.stops[1].level]
    cell_size = start_level.lattice.cell_size
    link_vector = end_position - start_position
    num_cells = max(round(float(np.abs(link_vector).max()) / cell_size), 1)
    line_points = start_position + np.linspace(0.0, 1.0, num_cells + 1)[:, None] * link_vector

    start_walk = _walk_from_stop(start_level, line_points, agent.step)
    landing_walk = _walk_from_stop(end_level, line_points[::-1], agent.step)
    # from the last point on the floor of the start, to the first one on the floor of the landing,
    # which is walked from the end
    num_walked_at_start = max(start_walk.last_point_index, 0)
    num_walked_at_end = max(landing_walk.last_point_index, 0)
    crossed_points = line_points[num_walked_at_start : len(line_points) - num_walked_at_end]
    if len(crossed_points) < 2:  # the agent walks from stop to stop
        return []

    higher_floor = max(start_walk.floor, landing_walk.floor)
    floors = np.full(len(crossed_points), higher_floor)
    floors[0] = start_walk.floor
    floors[-1] = landing_walk.floor
    half_cell_size = cell_size / 2
    for (x, y), floor in zip(crossed_points.tolist(), floors.tolist(), strict=True):
        low_z = floor + agent.step + tolerance
        high_z = higher_floor + agent.height - tolerance
        half_z = (high_z - low_z) / 2
        center = np.array([x, y, (low_z + high_z) / 2])
        prisms = [UprightPrism(half_cell_size, half_cell_size, half_z, False)]
        if agent.radius > half_cell_size:
            prisms.append(UprightPrism(agent.radius, agent.radius, half_z, True))
        half_width = max(half_cell_size, agent.radius)
        half_size = np.array([half_width, half_width, half_z])
        for obstacle in probe.obstacles.find_overlapping(center - half_size, center + half_size):
            contacts = (probe.find_contact(obstacle, prism, center, -tolerance) for prism in prisms)
            if TOUCHES in contacts:
                name = probe.obstacles.geom_name(obstacle)
                text = f"{link.kind} {link.name!r} runs into {name!r}"
                return [_link_finding(LINK_TOUCHES, link, grid, (x, y, floor), text, name)]

    x, y = crossed_points[-1].tolist()
    landing_z = landing_walk.floor
    height_tolerance = compute_floor_tolerance(x, y, landing_z)
    vertical_line = probe.cast_line(x, y)
    if vertical_line.has_upward_hit(landing_z - height_tolerance, landing_z + height_tolerance):
        return []
    if probe.has_upward_hit_nearby((x, y, landing_z), height_tolerance):
        return []
    text = f"{link.kind} {link.name!r} lands at {landing_z:.3f} m, where no surface is"
    return [_link_finding(NO_LANDING, link, grid, (x, y, landing_z), text, None)]


def _check_shaft(
    link: Link, car_body: int, grid: GridBase, scene: Scene, probe: ObstacleProbe, tolerance: float
) -> list[Finding]:
    """Move a lift's car through its joint's range, and check by FCL that it touches nothing."""
    findings = list[Finding]()
    model = scene.model
    obstacles = probe.obstacles
    up_direction = np.array([0.0, 0.0, 1.0])
    joint_id = int(model.body_jntadr[car_body])
    car_geoms = geoms_of_bodies(model, car_body, int(find_subtree_ends(model)[car_body])).tolist()
    joint_axis_z = float(scene.data.xaxis[joint_id, 2])
    joint_position = float(scene.data.qpos[model.jnt_qposadr[joint_id]])
    lowest_move, highest_move = sorted(
        joint_axis_z * (range_end - joint_position) for range_end in model.jnt_range[joint_id]
    )
    # what the car rests on or reaches at the ends of its range is no obstacle
    num_moves = max(int((highest_move - lowest_move) / CAR_MOVE_SPACING), 1) + 1
    car_moves = np.linspace(lowest_move + tolerance, highest_move - tolerance, num_moves)
    for car_shape in obstacles.shapes:
        if car_shape.geom not in car_geoms:
            continue
        # the box that the shape passes through
        shaft_low_corner = car_shape.low_corner + up_direction * car_moves[0]
        shaft_high_corner = car_shape.high_corner + up_direction * car_moves[-1]
        shaft_obstacles = [
            obstacle
            for obstacle in obstacles.find_overlapping(shaft_low_corner, shaft_high_corner)
            if obstacles.shapes[obstacle].geom not in car_geoms
        ]
        car_object = car_shape.collision_object
        modelled_position = np.array(car_object.getTranslation())
        for car_move, obstacle in product(car_moves.tolist(), shaft_obstacles):
            car_object.setTranslation(modelled_position + up_direction * car_move)
            if fcl.collide(car_object, obstacles.shapes[obstacle].collision_object) > 0:
                name = obstacles.geom_name(obstacle)
                text = f"the car of {link.kind} {link.name!r} runs into {name!r}, "
                text += f"moved by {car_move:.2f} m"
                position = (
                    car_shape.low_corner + car_shape.high_corner
                ) / 2 + up_direction * car_move
                findings.append(
                    _link_finding(LINK_TOUCHES, link, grid, position.tolist(), text, name)
                )
                break
        car_object.setTranslation(modelled_position)
    return findings


def _link_finding(
    kind: str, link: Link, grid: GridBase, position: Sequence[float], text: str, geom: str | None
) -> Finding:
    """Return a finding about a link, at the cell of its first stop."""
    stop = link.stops[0]
    cell = divmod(stop.cell, grid.levels[stop.level].width)
    x, y, z = position
    return Finding(kind, stop.level, cell, (float(x), float(y), float(z)), text, geom)
