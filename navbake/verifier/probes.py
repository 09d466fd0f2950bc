"""Casts vertical lines through a scene by MuJoCo's rays, and finds what upright prisms touch.

Both FCL and MuJoCo compute whether a prism touches an obstacle. They may contradict each other:
MuJoCo's `mj_geomDistance` is off by centimetres in rare poses of capsules, and FCL's iteration may
end early. Then the prism does not touch if a plane is found that provably separates the two shapes.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import NamedTuple

import fcl
import mujoco
import numpy as np

from navbake.types import Float, Vector3
from navbake.verifier.mesh_parts import CAVITY, SOLID
from navbake.verifier.obstacles import CONVEX, HALF_SPACE, HEIGHT_FIELD, Obstacles

# as numbers: a comparison with a constant of MuJoCo's takes as long as a ray through a box
MESH_TYPE = int(mujoco.mjtGeom.mjGEOM_MESH)
HEIGHT_FIELD_TYPE = int(mujoco.mjtGeom.mjGEOM_HFIELD)

UPWARD = 1
DOWNWARD = -1
RAY_DIRECTIONS = {UPWARD: np.array([0.0, 0.0, 1.0]), DOWNWARD: np.array([0.0, 0.0, -1.0])}
RAY_ADVANCE = 1e-6  # after a hit, the next ray begins this far behind it [m]
RAY_MARGIN = 1.0  # how far outside of an obstacle's bounding box a ray begins [m]
MAX_HITS = 200  # largest number of hits of a ray with one geom

SAME_HEIGHT_TOLERANCE = 1e-5  # surfaces this close together count as one [m]
MIN_UPWARD_NORMAL_Z = 1e-6  # least z of the unit normal of a surface that faces up
NORMAL_Z_SLACK = 1e-6  # what rounding may take from the z of a unit normal
VERTICAL_PLANE_NORMAL_Z = 1e-9  # a plane whose normal's |z| is less is vertical: no line crosses it
DEFAULT_CRACK_WIDTH = 0.03  # a narrower crack in a floor is no gap, by default [m]
EDGE_TOLERANCE = 1e-6  # a line this near to an edge of a surface may meet the surface or not [m]
# a disc with lines at four radii and in all `CIRCLE_DIRECTIONS` has no point that is farther from
# the nearest line than this share of the disc's radius
NEARBY_SPACING = 1 / 3
CIRCLE_DIRECTIONS = [(np.cos(angle), np.sin(angle)) for angle in np.arange(16) * (np.pi / 8)]

# Contacts between a prism and an obstacle. DISPUTED is truthy: while a depth or a gap is measured,
# it counts as a touch.
NO_CONTACT = 0
TOUCHES = 1
DISPUTED = 2

MIN_PROVED_GAP = 1e-7  # least gap that a separating plane has to leave [m]: more than rounding
MAX_MEASURED_GAP = 1.0  # how far from a prism the nearest obstacle is looked for [m]
NUM_BISECTIONS = 14  # of an interval of at most `MAX_MEASURED_GAP`: to a tenth of a millimetre
# MuJoCo need not compute distances beyond these [m]: for a contact, and for the nearest points
MUJOCO_DISTANCE_LIMIT = 1e-3
NEAREST_POINTS_LIMIT = 10.0
MIN_DIRECTION_LENGTH = 1e-12  # shorter vectors between points give no direction [m]


class RayHit(NamedTuple):
    """A point where a vertical ray meets a geom.

    Attributes:
        z: The height [m].
        normal_z: The z of the surface's unit normal.
    """

    z: float
    normal_z: float


class SurfaceHit(NamedTuple):
    """A crossing of a vertical line with an obstacle's surface.

    Attributes:
        z: The height [m].
        normal_z: The z of the surface's unit normal.
        obstacle: The obstacle's id.
    """

    z: float
    normal_z: float
    obstacle: int


class HeightRange(NamedTuple):
    """A range of heights [m]; the lower end may be minus infinity."""

    low: float
    high: float


class SurfaceCrossings(NamedTuple):
    """How often a vertical ray from a point leaves and enters the volume inside of a surface."""

    num_exits: int
    num_entries: int


class ObstacleGap(NamedTuple):
    """The id of the obstacle that is nearest to a prism, and its gap to the prism [m]."""

    gap: float
    obstacle: int


class VerticalLine(NamedTuple):
    """The surfaces and solids that a vertical line meets.

    Attributes:
        hits: All crossings with surfaces, lowest first.
        solid_ranges: The ranges of heights inside of solids, which may overlap.
    """

    hits: list[SurfaceHit]
    solid_ranges: list[HeightRange]

    def is_inside(self, z: float) -> bool:
        """Return whether a height [m] lies inside of a solid, or a solid stands directly on it."""
        return any(low <= z + SAME_HEIGHT_TOLERANCE < high for low, high in self.solid_ranges)

    def has_upward_hit(self, low: float, high: float) -> bool:
        """Return whether the line meets an upward surface between two heights.

        A surface inside of a solid counts as well. A surface may lie below `low` or above `high` by
        the distance `EDGE_TOLERANCE`, measured at right angles to the surface.

        Args:
            low: The lower height [m].
            high: The upper height [m].
        """
        for hit in self.hits:
            if hit.normal_z < MIN_UPWARD_NORMAL_Z:
                continue
            margin = EDGE_TOLERANCE / hit.normal_z
            if low - margin <= hit.z <= high + margin:
                return True
        return False

    def find_standable_hits(self, agent_height: float, min_normal_z: float) -> list[SurfaceHit]:
        """Return the surfaces that an agent can stand on, lowest first.

        Of several surfaces at the same height, one is returned.

        Args:
            agent_height: The least free height above a surface [m].
            min_normal_z: The least z of the unit normal of a surface: the cosine of the steepest
                slope.
        """
        standable_hits: list[SurfaceHit] = []
        for index, hit in enumerate(self.hits):
            if hit.normal_z < min_normal_z - NORMAL_Z_SLACK or self.is_inside(hit.z):
                continue
            heights_above = (
                hit_above.z
                for hit_above in self.hits[index + 1 :]
                if hit_above.z > hit.z + SAME_HEIGHT_TOLERANCE
            )
            ceiling = next(heights_above, np.inf)
            is_new_height = (
                not standable_hits or hit.z - standable_hits[-1].z > SAME_HEIGHT_TOLERANCE
            )
            if ceiling - hit.z >= agent_height and is_new_height:
                standable_hits.append(hit)
        return standable_hits


class UprightPrism(NamedTuple):
    """An upright box or cylinder around its centre.

    Attributes:
        half_x: Half of the box's length, or the cylinder's radius [m].
        half_y: Half of the box's width, or the cylinder's radius [m].
        half_z: Half of the height [m].
        is_round: Whether it is a cylinder.
        yaw: Rotation about the vertical [rad].
    """

    half_x: float
    half_y: float
    half_z: float
    is_round: bool
    yaw: float = 0.0


class PlacedPrism(NamedTuple):
    """An upright prism, and the position of its centre, (3,) [m]."""

    prism: UprightPrism
    center: Float


class PrismObject(NamedTuple):
    """FCL's collision object of a prism, which may be moved, and its rotation matrix, (3, 3)."""

    collision_object: fcl.CollisionObject
    rotation: Float


def _make_prism_object(prism: UprightPrism) -> PrismObject:
    """Make FCL's collision object of a prism, with its centre at the origin."""
    cos_yaw = np.cos(prism.yaw)
    sin_yaw = np.sin(prism.yaw)
    rotation = np.array([[cos_yaw, -sin_yaw, 0.0], [sin_yaw, cos_yaw, 0.0], [0.0, 0.0, 1.0]])
    if prism.is_round:
        geometry = fcl.Cylinder(prism.half_x, 2 * prism.half_z)
    else:
        geometry = fcl.Box(2 * prism.half_x, 2 * prism.half_y, 2 * prism.half_z)
    transform = fcl.Transform(rotation, np.zeros(3))
    return PrismObject(fcl.CollisionObject(geometry, transform), rotation)


class ObstacleProbe:
    """Casts vertical lines through obstacles, and computes what upright prisms touch.

    It resizes and moves the probe geoms of the obstacles' MuJoCo model, so only one thread may use
    an instance.

    Args:
        obstacles: The obstacles.

    Attributes:
        obstacles: The obstacles.
    """

    def __init__(self, obstacles: Obstacles) -> None:
        self.obstacles = obstacles
        # the prism whose size FCL's object and MuJoCo's geom have at present
        self._prism = UprightPrism(0.0, 0.0, 0.0, False)
        self._prism_object = lru_cache(4096)(_make_prism_object)
        self._geom_type = obstacles.model.geom_type.tolist()
        # views of the rows, which would be made anew for each ray
        self._geom_positions = list(obstacles.geom_positions)
        self._geom_rotations = list(obstacles.geom_rotations)
        self._geom_sizes = list(obstacles.geom_sizes)
        self._normal = np.zeros(3)
        self._ray_origin = np.zeros(3)

    def cast_line(self, x: float, y: float) -> VerticalLine:
        """Return the surfaces and solids that the vertical line at world x, y [m] meets."""
        hits: list[SurfaceHit] = []
        solid_ranges: list[HeightRange] = []
        depth_changes: list[tuple[float, int]] = []  # height, and the change of the depth there
        for obstacle in self.obstacles.find_on_line(x, y):
            kind = self.obstacles.shapes[obstacle].kind
            obstacle_hits = self._find_surface_hits(obstacle, x, y)
            hits += obstacle_hits
            if kind == HALF_SPACE and obstacle_hits and obstacle_hits[0].normal_z > 0:
                solid_ranges.append(HeightRange(-np.inf, obstacle_hits[0].z))
            elif kind in (CONVEX, HEIGHT_FIELD) and obstacle_hits:
                solid_ranges.append(HeightRange(obstacle_hits[0].z, obstacle_hits[-1].z))
            elif kind in (SOLID, CAVITY):
                # a face that faces down is the underside of a solid, above a cavity as well
                depth_changes += [(hit.z, 1 if hit.normal_z < 0 else -1) for hit in obstacle_hits]
        # the line is inside where it has entered more solids than cavities
        inside_depth = 0
        underside_z = 0.0
        for z, depth_change in sorted(depth_changes):
            if inside_depth <= 0 < inside_depth + depth_change:
                underside_z = z
            elif inside_depth > 0 >= inside_depth + depth_change:
                solid_ranges.append(HeightRange(underside_z, z))
            inside_depth += depth_change
        return VerticalLine(sorted(hits), solid_ranges)

    def has_upward_hit_nearby(
        self,
        position: Vector3,
        height_tolerance: float,
        max_distance: float = DEFAULT_CRACK_WIDTH,
        *,
        min_normal_z: float = np.inf,
    ) -> bool:
        """Return whether a surface near a position faces up.

        Lines are cast around the position, as the line through it may run through a crack.

        Args:
            position: World x, y, z [m].
            height_tolerance: How far above or below the position the surface may be [m].
            max_distance: How far beside the position the surface may be [m].
            min_normal_z: A surface counts as a slope to walk on if its unit normal has at least
                this z. A slope may lie farther above or below the position: by as much as it rises
                from one cast line to the next. By default, no surface counts as one.
        """
        x, y, z = position
        half_width = max_distance + EDGE_TOLERANCE
        half_size = np.array([half_width, half_width, height_tolerance])
        if not self.obstacles.find_overlapping(position - half_size, position + half_size):
            return False
        distances = (EDGE_TOLERANCE, max_distance / 4, max_distance / 2, max_distance)
        for distance, (cos, sin) in product(distances, CIRCLE_DIRECTIONS):
            for hit in self.cast_line(x + distance * cos, y + distance * sin).hits:
                if hit.normal_z < MIN_UPWARD_NORMAL_Z:
                    continue
                slope = 0.0
                if hit.normal_z >= min_normal_z:
                    slope = np.sqrt(max(1 / hit.normal_z**2 - 1, 0.0))
                extra_tolerance = slope * max_distance * NEARBY_SPACING
                if abs(hit.z - z) <= height_tolerance + extra_tolerance:
                    return True
        return False

    def count_crossings(self, obstacle: int, point: Vector3) -> SurfaceCrossings:
        """Count how often the vertical ray up from a point leaves and enters an obstacle.

        Args:
            obstacle: The id of a height field or of a part of a mesh.
            point: Where the ray begins, world x, y, z [m].
        """
        geom_ids = self.obstacles.half_meshes.get(obstacle, [obstacle])
        normals_z = [
            hit.normal_z for geom in geom_ids for hit in self._find_hits(geom, *point, UPWARD)
        ]
        if self._geom_type[obstacle] == HEIGHT_FIELD_TYPE:  # its underside is entered first
            return SurfaceCrossings((len(normals_z) + 1) // 2, len(normals_z) // 2)
        num_exits = sum(normal_z > 0 for normal_z in normals_z)
        num_entries = sum(normal_z < 0 for normal_z in normals_z)
        return SurfaceCrossings(num_exits, num_entries)

    def _find_surface_hits(self, obstacle: int, x: float, y: float) -> list[SurfaceHit]:
        """Return the crossings of a vertical line with one obstacle, lowest first."""
        shape = self.obstacles.shapes[obstacle]
        if shape.kind == HALF_SPACE:
            plane_point = self.obstacles.geom_positions[obstacle]
            normal = self.obstacles.geom_rotations[obstacle, 2::3]
            if abs(normal[2]) < VERTICAL_PLANE_NORMAL_Z:
                return []
            z = (
                plane_point[2]
                - ((x - plane_point[0]) * normal[0] + (y - plane_point[1]) * normal[1]) / normal[2]
            )
            return [SurfaceHit(float(z), float(normal[2]), obstacle)]
        z_above = float(shape.high_corner[2]) + RAY_MARGIN
        z_below = float(shape.low_corner[2]) - RAY_MARGIN
        if shape.kind in (CONVEX, HEIGHT_FIELD):
            lowest_hit = self._cast_ray(obstacle, x, y, z_below, UPWARD)
            highest_hit = self._cast_ray(obstacle, x, y, z_above, DOWNWARD)
            hits = [hit for hit in (lowest_hit, highest_hit) if hit is not None]
        else:
            geom_ids = self.obstacles.half_meshes.get(obstacle, [obstacle])
            hits = sorted(
                hit for geom in geom_ids for hit in self._find_hits(geom, x, y, z_above, DOWNWARD)
            )
        return [SurfaceHit(hit.z, hit.normal_z, obstacle) for hit in hits]

    def _find_hits(self, geom: int, x: float, y: float, z: float, direction: int) -> list[RayHit]:
        """Return all hits of a vertical ray from a point with a geom, nearest first."""
        hits: list[RayHit] = []
        while len(hits) < MAX_HITS:
            hit = self._cast_ray(geom, x, y, z, direction)
            if hit is None:
                break
            hits.append(hit)
            z = hit.z + direction * RAY_ADVANCE
        return hits

    def _cast_ray(self, geom: int, x: float, y: float, z: float, direction: int) -> RayHit | None:
        """Return the first hit of a vertical ray from a point with a geom of the model."""
        obstacles = self.obstacles
        geom_type = self._geom_type[geom]
        ray_origin = self._ray_origin
        ray_origin[:] = x, y, z
        ray_vector = RAY_DIRECTIONS[direction]
        hit_normal = self._normal
        if geom_type == MESH_TYPE:
            distance = mujoco.mj_rayMesh(
                obstacles.model, obstacles.data, geom, ray_origin, ray_vector, hit_normal
            )
        elif geom_type == HEIGHT_FIELD_TYPE:
            distance = mujoco.mj_rayHfield(
                obstacles.model, obstacles.data, geom, ray_origin, ray_vector, hit_normal
            )
        else:
            distance = mujoco.mju_rayGeom(
                self._geom_positions[geom],
                self._geom_rotations[geom],
                self._geom_sizes[geom],
                ray_origin,
                ray_vector,
                geom_type,
                hit_normal,
            )
        if distance < 0:
            return None
        return RayHit(z + direction * distance, float(hit_normal[2]))

    def find_contact(
        self, obstacle: int, prism: UprightPrism, center: Float, margin: float = 0.0
    ) -> int:
        """Return the contact of a prism with an obstacle: none, a touch, or a disputed touch.

        Args:
            obstacle: The obstacle's id.
            prism: The prism.
            center: The position of the prism's centre, (3,) [m].
            margin: By how much the prism is enlarged on all sides [m]; a negative margin shrinks
                it. A prism that vanishes by shrinking touches nothing.

        Returns:
            `NO_CONTACT`; `TOUCHES`; or `DISPUTED` if MuJoCo alone finds a touch, and no plane is
            found that separates the two.
        """
        obstacles = self.obstacles
        half_x = prism.half_x + margin
        half_y = prism.half_y + margin
        half_z = prism.half_z + margin
        if min(half_x, half_y, half_z) <= 0:
            return NO_CONTACT
        enlarged_prism = UprightPrism(half_x, half_y, half_z, prism.is_round, prism.yaw)
        if enlarged_prism != self._prism:
            self._resize(enlarged_prism)
        self._center = obstacles.geom_positions[self._geom] = center
        self._object.setTranslation(center)
        shape = obstacles.shapes[obstacle]
        touches_by_fcl = fcl.collide(self._object, shape.collision_object) > 0
        if not shape.is_same_in_mujoco:
            return TOUCHES if touches_by_fcl else NO_CONTACT
        distance = mujoco.mj_geomDistance(
            obstacles.model, obstacles.data, self._geom, obstacle, MUJOCO_DISTANCE_LIMIT, None
        )
        if touches_by_fcl == (distance <= 0):
            return TOUCHES if touches_by_fcl else NO_CONTACT
        if self._is_separated(obstacle):
            return NO_CONTACT
        return TOUCHES if touches_by_fcl else DISPUTED

    def _resize(self, prism: UprightPrism) -> None:
        """Give FCL's object and the probe geom of MuJoCo's model the size of a prism."""
        obstacles = self.obstacles
        self._prism = prism
        self._object, self._rotation = self._prism_object(prism)
        self._geom = geom = len(obstacles.shapes) + prism.is_round
        if prism.is_round:
            geom_size = np.array([prism.half_x, prism.half_z, 0.0])
        else:
            geom_size = np.array([prism.half_x, prism.half_y, prism.half_z])
        obstacles.geom_sizes[geom] = geom_size
        obstacles.geom_rotations[geom] = self._rotation.ravel()
        obstacles.model.geom_rbound[geom] = np.linalg.norm(geom_size) + geom_size.max()

    def _is_separated(self, obstacle: int) -> bool:
        """Return whether a plane provably lies between the prism and a convex obstacle.

        It does if, along some direction, the prism ends before the obstacle begins (separating axis
        theorem). The directions that are tried run between the nearest points that each library
        finds, between the centres, and along the axes of both shapes.
        """
        obstacles = self.obstacles
        mujoco_nearest_points = np.zeros((2, 3))
        mujoco.mj_geomDistance(
            obstacles.model,
            obstacles.data,
            self._geom,
            obstacle,
            NEAREST_POINTS_LIMIT,
            mujoco_nearest_points.ravel(),
        )
        fcl_result = fcl.DistanceResult()
        distance_request = fcl.DistanceRequest(enable_nearest_points=True)
        collision_object = obstacles.shapes[obstacle].collision_object
        fcl.distance(self._object, collision_object, distance_request, fcl_result)
        point_on_prism, point_on_obstacle = fcl_result.nearest_points
        center_offset = obstacles.geom_positions[obstacle] - self._center
        obstacle_rotation = obstacles.geom_rotations[obstacle].reshape(3, 3)
        candidate_vectors = [
            mujoco_nearest_points[1] - mujoco_nearest_points[0],
            np.subtract(point_on_obstacle, point_on_prism),
            center_offset,
            center_offset * [1.0, 1.0, 0.0],
            *np.eye(3),
            *-np.eye(3),
            *self._rotation.T,
            *obstacle_rotation.T,
            *-obstacle_rotation.T,
        ]
        half_x, half_y, half_z, is_round, _ = self._prism
        for candidate_vector in candidate_vectors:
            vector_length = float(np.linalg.norm(candidate_vector))
            if not MIN_DIRECTION_LENGTH < vector_length < np.inf:
                continue
            direction = candidate_vector / vector_length
            direction_x, direction_y, direction_z = np.abs(self._rotation.T @ direction)
            half_width = (
                half_x * np.hypot(direction_x, direction_y)
                if is_round
                else half_x * direction_x + half_y * direction_y
            )
            prism_end = float(self._center @ direction + half_width + half_z * direction_z)
            obstacle_begin = -obstacles.support(obstacle, -direction)
            if obstacle_begin - prism_end > MIN_PROVED_GAP:
                return True
        return False

    def measure_depth(self, prism: UprightPrism, center: Float, obstacle: int) -> float:
        """Measure how deep a prism reaches into an obstacle.

        The depth is by how much the prism has to shrink on all sides until it no longer touches.

        Args:
            prism: A prism that touches the obstacle.
            center: The position of the prism's centre, (3,) [m].
            obstacle: The obstacle's id.

        Returns:
            The depth [m], at most half of the prism's smallest dimension.
        """
        largest_depth = min(prism.half_x, prism.half_y, prism.half_z)
        return -self._bisect_margin(prism, center, obstacle, low=-largest_depth, high=0.0)

    def find_nearest_obstacle(self, prism: UprightPrism, center: Float) -> ObstacleGap | None:
        """Return the obstacle that a growing prism touches first, and its gap to the prism.

        Args:
            prism: The prism.
            center: The position of the prism's centre, (3,) [m].

        Returns:
            The obstacle; None if there is none within `MAX_MEASURED_GAP`.
        """
        half_size = np.array([prism.half_x, prism.half_y, prism.half_z]) + MAX_MEASURED_GAP
        nearest_gap = None
        gap = MAX_MEASURED_GAP
        for obstacle in self.obstacles.find_overlapping(center - half_size, center + half_size):
            if self.find_contact(obstacle, prism, center, gap):
                gap = self._bisect_margin(prism, center, obstacle, low=0.0, high=gap)
                nearest_gap = ObstacleGap(gap, obstacle)
        return nearest_gap

    def _bisect_margin(
        self, prism: UprightPrism, center: Float, obstacle: int, low: float, high: float
    ) -> float:
        """Return the margin [m] at which a prism begins to touch an obstacle, by bisection."""
        for _ in range(NUM_BISECTIONS):
            middle_margin = (low + high) / 2
            if self.find_contact(obstacle, prism, center, middle_margin):
                high = middle_margin
            else:
                low = middle_margin
        return high
