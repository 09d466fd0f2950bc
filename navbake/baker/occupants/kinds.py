"""Classifies geoms as walls, meshes of a whole building, floors, ceilings or things."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.components import label_components
from navbake.baker.core.constants import BUILDING, OBJECT, STRUCTURE, WALL
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.core.windows import list_differing_pairs
from navbake.baker.floors.levels import Floors
from navbake.baker.geometry.extents import Extents
from navbake.baker.scene.names import (
    all_names,
    body_name,
    find_subtree_ends,
    geoms_of_bodies,
    warn_unmatched,
)
from navbake.baker.scene.roles import STATIC_STRUCTURE
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, NameSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:  # what describes a model doesn't load MuJoCo
    import mujoco


class WallLimits(NamedTuple):
    """Limits of a wall's shape, seen from above.

    Attributes:
        max_thickness: the greatest thickness of a wall [m].
        min_length: the least length of a wall [m].
        min_ratio: the least ratio of length to thickness.
    """

    max_thickness: float
    min_length: float
    min_ratio: float


WALL_NAME = re.compile("wall|partition")  # in the names of walls, whatever the case

# The largest height of a wall's bottom above a floor (of a window, above its sill), and the least
# height of a wall [m]
MAX_WALL_BOTTOM = 0.6
MIN_WALL_HEIGHT = 1.5
# The limits of a thin wall, and of a thicker wall that has to be long
THIN_WALLS = (WallLimits(0.25, 0.5, 3.0), WallLimits(0.5, 3.0, 6.0))
# The limits of a wall that is thicker still. It has to meet a second wall at a corner, and their
# tops differ in height by at most MAX_TOP_DIFFERENCE [m]
THICK_WALL = WallLimits(1.2, 3.0, 3.0)
MAX_TOP_DIFFERENCE = 0.1
# Two walls meet at a corner if the cosine of their angle is at most that of 45 degrees [1]
MAX_CORNER_COSINE = 0.5**0.5
# Least height of a geom named like a wall, and of one that is also thin and long [m]
MIN_NAMED_HEIGHT = 1.0
MIN_NAMED_THIN_HEIGHT = 0.5
# A body with a panel (a geom with the shape of a wall) is furniture if it is deeper than the panel
# by at least MIN_DEPTH_BEYOND_PANEL [m], and has at most this depth [m], length [m] and number of
# geoms
MIN_DEPTH_BEYOND_PANEL = 0.1
MAX_FURNITURE_DEPTH = 1.2
MAX_FURNITURE_LENGTH = 3.0
MAX_FURNITURE_GEOMS = 200
# A geom that continues a wall may be this much thicker on each side, and this far from its end [m]
MAX_EXTRA_THICKNESS = 0.03
MAX_END_GAP = 0.05
MAX_PAIRS = 1_000_000  # of geoms that are compared at once, for the memory they take
# Least width along both axes of a mesh that holds a building [m], and the greatest share of its
# box, seen from above, that it fills within `WALL_HEIGHTS`
MIN_BUILDING_WIDTH = 2.0
MAX_FILLED_SHARE = 0.5
# The shapes, in the report of geoms, that such a mesh may have
TRIANGLE_SHAPES = ("surface", "closed surface", "partly closed surface", "shell")
# Least share of a wall's cells in which it reaches into `WALL_HEIGHTS`
MIN_UPRIGHT_SHARE = 0.5

# A thing that an agent can stand on has at most this area [m²]. In at least this share of its cells
# it lies on a floor: at most this high over it [m], unless the thing is solid down to it
MAX_THING_AREA = 4.0
MIN_ON_FLOOR_SHARE = 0.9
MAX_THING_HEIGHT = 1.0
# A thing of at most this height only covers the floor, as a rug does: a step up from it counts as
# one from the floor [m]
MAX_COVERING_HEIGHT = 0.03
# The least width of a ceiling along both axes [m]
MIN_CEILING_WIDTH = 1.5


class OccupantSizes(NamedTuple):
    """The heights of geoms over floors, and the areas that they occupy, by geom id.

    Attributes:
        min_bottom_over_floor: the least height of the geom's bottom over the floor of a cell that
            it occupies [m]; inf where it occupies no cell, and for an endless plane.
        max_top_over_bottom: the greatest height of the geom in a cell that it occupies: of its top
            over its bottom, or over the cell's floor where that is higher [m]; -inf where it
            occupies no cell, and for an endless plane.
        area: the area that the geom occupies on the level where that is largest [m²].
        area_at_wall_height: the same, counting only cells that it occupies within `WALL_HEIGHTS`
            [m²]; 0 for geoms whose shape is not that of walls, see `mark_wall_candidates`.
    """

    min_bottom_over_floor: Float
    max_top_over_bottom: Float
    area: Float
    area_at_wall_height: Float


class FloorCounts(NamedTuple):
    """Counts of the cells whose floor is the surface of a geom; by geom id, shape (ngeom,).

    Attributes:
        num_cells: number of cells in which the geom's surface is the floor.
        num_on_floors: number of these cells in which the geom lies on the floor of a second geom:
            at most `MAX_THING_HEIGHT` above it, or solid down to it.
        num_covering: number of these cells in which the geom's surface is at most
            `MAX_COVERING_HEIGHT` above the floor of a second geom.
        is_stood_on: whether an agent can stand on the geom in any cell, bool.
    """

    num_cells: Int
    num_on_floors: Int
    num_covering: Int
    is_stood_on: Bool


class FloorSteps(NamedTuple):
    """Steps between the floors of two geoms in adjacent cells.

    Arrays of shape (n,), with one entry for each pair of cells.

    Attributes:
        lower_geom: id of the geom whose surface is the lower floor.
        higher_geom: id of the geom whose surface is the higher floor.
        height: height of the step, >= 0 [m].
    """

    lower_geom: Int
    higher_geom: Int
    height: Float


class FloorGeoms(NamedTuple):
    """Masks by geom id of the geoms whose surfaces are floors, shape (ngeom,), bool.

    Attributes:
        is_building: the geoms that are parts of the building.
        is_thing: the geoms that lie on the building's floors (rugs, pallets).
        is_stood_on: the geoms of either mask that an agent can stand on in any cell.
    """

    is_building: Bool
    is_thing: Bool
    is_stood_on: Bool


class ClassifiedGeoms(NamedTuple):
    """The kinds of all geoms, such as wall or object, and warnings.

    Attributes:
        kinds: for each geom, OBJECT, WALL, STRUCTURE or BUILDING, shape (ngeom,), uint8.
        room_kinds: like `kinds`, but for finding rooms: panes, and geoms with the shape of a wall,
            are WALL whatever their names are.
        warnings: warnings about patterns of walls, one line each.
    """

    kinds: NDArray[np.uint8]
    room_kinds: NDArray[np.uint8]
    warnings: list[str]


def classify_geoms(
    scene: Scene,
    extents: Extents,
    sizes: OccupantSizes,
    floor_geoms: FloorGeoms,
    agent: AgentSettings,
    settings: NameSettings,
) -> ClassifiedGeoms:
    """Classify each geom as a wall, the mesh of a whole building, a floor or ceiling, or a thing.

    Args:
        scene: the scene of the geoms.
        extents: bounding boxes of the geoms.
        sizes: the heights of the geoms over floors, and the areas that they occupy.
        floor_geoms: the geoms whose surfaces are floors.
        agent: the agent; its height is read.
        settings: the patterns of wall names.

    Returns:
        The kind of each geom, and a warning for each pattern of walls that matches nothing.
    """
    is_building = mark_buildings(scene, extents, sizes)
    is_ceiling = mark_ceilings(
        extents, sizes.min_bottom_over_floor, scene.roles == STATIC_STRUCTURE, agent
    )
    is_wall = mark_wall_geoms(scene, extents, sizes, floor_geoms, is_excluded=is_building)
    kinds = np.full(len(scene.geoms), OBJECT, dtype=np.uint8)
    kinds[floor_geoms.is_building | is_ceiling] = STRUCTURE
    kinds[is_wall] = WALL
    kinds[is_building] = BUILDING
    room_kinds = kinds.copy()
    warnings = list[str]()
    if settings.walls:  # walls of the settings replace those by shape
        is_named_wall, warnings = match_wall_names(scene, settings.walls)
        kinds[kinds == WALL] = OBJECT
        kinds[is_named_wall] = WALL
        room_kinds[is_named_wall] = WALL
    room_kinds[mark_panes(extents, sizes, room_kinds == WALL)] = WALL
    return ClassifiedGeoms(kinds, room_kinds, warnings)


# ---------------------------------------------------------------- walls


def mark_wall_candidates(scene: Scene, extents: Extents) -> Bool:
    """Mark the geoms that have the shape of a wall, of a pane, or of a whole building.

    Args:
        scene: the scene of the geoms.
        extents: bounding boxes of the geoms.

    Returns:
        A mask by geom id, shape (ngeom,), bool.
    """
    is_tall = extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_slender = _mark_slender(extents, *THIN_WALLS, THICK_WALL)
    return is_tall & is_slender | _may_hold_building(scene, extents)


def mark_buildings(scene: Scene, extents: Extents, sizes: OccupantSizes) -> Bool:
    """Mark the meshes that hold a whole building: tall, wide along both axes, and hollow.

    Args:
        scene: the scene of the geoms.
        extents: bounding boxes of the geoms.
        sizes: the areas that the geoms occupy.

    Returns:
        A mask by geom id, shape (ngeom,), bool.
    """
    box_area = extents.short_side * extents.long_side
    is_hollow = sizes.area_at_wall_height < MAX_FILLED_SHARE * box_area
    return _may_hold_building(scene, extents) & is_hollow


def _may_hold_building(scene: Scene, extents: Extents) -> Bool:
    """Mark the meshes that are as tall and wide as a building; convex hulls are not marked."""
    is_surface = [report.shape in TRIANGLE_SHAPES for report in scene.geoms]
    is_tall = extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_wide = extents.short_side >= MIN_BUILDING_WIDTH
    return np.array(is_surface, dtype=np.bool_) & is_tall & is_wide


def match_wall_names(scene: Scene, patterns: Sequence[str]) -> tuple[Bool, list[str]]:
    """Mark the geoms that the patterns of the settings name as walls.

    A pattern is compared with the names of the geom, of its mesh, of its body, and of all bodies
    above that one.

    Args:
        scene: the scene of the geoms.
        patterns: the patterns of `names.walls`.

    Returns:
        A mask by geom id, and a warning for each pattern that matches nothing.
    """
    is_match = np.zeros(len(scene.geoms), dtype=np.bool_)
    warnings: list[str] = []
    names_by_geom = []
    for geom in range(len(scene.geoms)):
        body_ids = _bodies_above(scene.model, geom)
        body_names = {body_name(scene.model, body) for body in body_ids}
        names_by_geom.append(body_names | set(_names(scene, geom)))
    scene_names = sorted(set().union(*names_by_geom))
    for pattern in patterns:
        matching_names = {name for name in scene_names if fnmatchcase(name, pattern)}
        is_match |= np.array(
            [not matching_names.isdisjoint(names) for names in names_by_geom], np.bool_
        )
        if not matching_names:
            warnings.append(warn_unmatched("names.walls", pattern, scene_names))
    return is_match, warnings


def mark_wall_geoms(
    scene: Scene, extents: Extents, sizes: OccupantSizes, floor_geoms: FloorGeoms, is_excluded: Bool
) -> Bool:
    """Mark, by geom id, the geoms that are walls by their shapes or by their names.

    By its shape, a geom is a wall if it is static and vertical, begins near a floor, rises at least
    1.5 m, and is long and at most 0.25 m thick. A geom up to 0.5 m thick has to be longer. A geom
    up to 1.2 m thick also has to meet, at a corner, a wall or a second geom of such a thickness
    that is equally high. So racks, containers and rows of cupboards are no walls. Neither are
    panels of furniture, and geoms that an agent can stand on.

    By its name, a static geom that begins near a floor is a wall if `wall` or `partition` is in the
    name of the geom, its mesh or its body. Its height has to be at least 1 m, or 0.5 m if it is
    also thin and long.

    Static pieces that continue in the line of a wall (parapets, lintels, stubs, windows) are walls,
    too, unless they carry floors. Excluded geoms are no walls in any case.

    Args:
        scene: the scene of the geoms.
        extents: upright bounding boxes of the geoms.
        sizes: the heights of the geoms over floors, and the areas that they occupy.
        floor_geoms: the geoms whose surfaces are floors.
        is_excluded: mask by geom id of the geoms that are no walls, such as meshes of a whole
            building.
    """
    names = [" ".join(geom_names).lower() for geom_names in all_names(scene.model).geoms]
    has_wall_name = np.array([bool(WALL_NAME.search(name)) for name in names], dtype=np.bool_)
    is_static = (scene.roles == STATIC_STRUCTURE) & ~is_excluded
    is_slender = _mark_slender(extents, *THIN_WALLS)
    is_near_floor = is_static & (sizes.min_bottom_over_floor <= MAX_WALL_BOTTOM)

    is_wall_by_name = is_near_floor & has_wall_name
    is_wall_by_name &= (sizes.max_top_over_bottom >= MIN_NAMED_HEIGHT) | (
        is_slender & (sizes.max_top_over_bottom >= MIN_NAMED_THIN_HEIGHT)
    )

    is_upright = is_near_floor & (sizes.max_top_over_bottom >= MIN_WALL_HEIGHT)
    is_upright &= ~floor_geoms.is_stood_on & ~is_wall_by_name
    is_upright &= sizes.area_at_wall_height >= MIN_UPRIGHT_SHARE * sizes.area
    is_wall_by_shape = is_upright & is_slender
    subtree_ends = find_subtree_ends(scene.model)
    for geom in np.flatnonzero(is_wall_by_shape):
        is_wall_by_shape[geom] = not _is_furniture_panel(scene, extents, int(geom), subtree_ends)

    is_thick = is_upright & ~is_slender & _mark_slender(extents, THICK_WALL)
    is_wall_by_shape |= _mark_meeting_at_corner(
        is_thick, is_wall_by_name | is_wall_by_shape, extents
    )

    may_continue_wall = is_static & ~floor_geoms.is_building & ~floor_geoms.is_thing
    return _add_wall_pieces(is_wall_by_name | is_wall_by_shape, may_continue_wall, extents)


def mark_panes(extents: Extents, sizes: OccupantSizes, is_wall: Bool) -> Bool:
    """Mark, by geom id, the panes that close an opening in a wall: glass, sliding doors, leaves.

    A pane is as thin, long and tall as a wall, and begins near a floor or a sill. Each of its two
    ends meets a wall, or a second pane in the same opening.

    Args:
        extents: upright bounding boxes of the geoms.
        sizes: the heights of the geoms over floors, and the areas that they occupy.
        is_wall: mask by geom id of the walls.
    """
    is_pane = _mark_slender(extents, THIN_WALLS[0])
    is_pane &= extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_pane &= (sizes.min_bottom_over_floor <= MAX_WALL_BOTTOM) & ~is_wall
    # once a pane that meets nothing at an end is left out, its neighbor may meet nothing there
    while is_pane.any():
        panes = np.flatnonzero(is_pane)
        neighbors = np.flatnonzero(
            is_pane | is_wall & (extents.short_side <= THICK_WALL.max_thickness)
        )
        meets_at_end = np.zeros((2, len(is_pane)), dtype=np.bool_)
        for pane_ids, neighbor_ids in _iterate_near_pairs(panes, neighbors, extents):
            for end_number, end_factor in enumerate((-0.5, 0.5)):
                end_point = _find_end_points(pane_ids, end_factor, extents)
                is_meeting = (pane_ids != neighbor_ids) & _mark_points_on(
                    end_point, neighbor_ids, extents
                )
                meets_at_end[end_number, pane_ids[is_meeting]] = True
        still_is_pane = is_pane & meets_at_end.all(axis=0)
        if (still_is_pane == is_pane).all():
            break
        is_pane = still_is_pane
    return is_pane


def _mark_slender(extents: Extents, *wall_limits: WallLimits) -> Bool:
    """Mark the geoms that are thin and long by at least one of several limits."""
    is_slender = np.zeros(len(extents.short_side), dtype=np.bool_)
    for wall_limit in wall_limits:
        min_length = np.maximum(wall_limit.min_length, wall_limit.min_ratio * extents.short_side)
        is_slender |= (extents.short_side <= wall_limit.max_thickness) & (
            extents.long_side >= min_length
        )
    return is_slender


def _mark_meeting_at_corner(is_thick: Bool, is_wall: Bool, extents: Extents) -> Bool:
    """Mark thick geoms that meet, at a corner, a wall or a thick geom of the same height."""
    is_at_corner = np.zeros(len(is_thick), dtype=np.bool_)
    if not is_thick.any():
        return is_at_corner
    thick_geoms = np.flatnonzero(is_thick)
    neighbors = np.flatnonzero(is_thick | is_wall)
    for geom_ids, neighbor_ids in _iterate_near_pairs(thick_geoms, neighbors, extents):
        cosine = np.abs((extents.long_axis[geom_ids] * extents.long_axis[neighbor_ids]).sum(axis=1))
        is_equally_high = (
            np.abs(extents.top[geom_ids] - extents.top[neighbor_ids]) <= MAX_TOP_DIFFERENCE
        )
        is_corner = (cosine <= MAX_CORNER_COSINE) & is_equally_high
        is_corner &= _mark_ends_at(geom_ids, neighbor_ids, extents) | _mark_ends_at(
            neighbor_ids, geom_ids, extents
        )
        is_at_corner[geom_ids[is_corner]] = True
    return is_at_corner


def _find_end_points(geoms: Int, end_factor: float, extents: Extents) -> Float:
    """Return the middle of one end of each geom, seen from above, (n, 2) [m].

    Args:
        geoms: ids of the geoms, (n,).
        end_factor: 0.5 for one end, -0.5 for the other.
        extents: bounding boxes of all geoms.
    """
    end_point: Float = (
        extents.center[geoms]
        + end_factor * extents.long_side[geoms, None] * extents.long_axis[geoms]
    )
    return end_point


def _mark_ends_at(geoms: Int, neighbors: Int, extents: Extents) -> Bool:
    """Mark the geoms that end at a neighbor: seen from above, the middle of an end lies on it.

    Args:
        geoms: ids of the geoms, (n,).
        neighbors: for each geom, the id of the neighbor that it is compared with, (n,).
        extents: bounding boxes of all geoms.
    """
    is_end_at_neighbor = np.zeros(len(geoms), dtype=np.bool_)
    for end_factor in (-0.5, 0.5):
        is_end_at_neighbor |= _mark_points_on(
            _find_end_points(geoms, end_factor, extents), neighbors, extents
        )
    return is_end_at_neighbor


def _mark_points_on(points: Float, geoms: Int, extents: Extents) -> Bool:
    """Mark the points that lie on a geom, or at most `MAX_END_GAP` beside it, seen from above.

    Args:
        points: the points, (n, 2) [m].
        geoms: the id of the geom that each point is compared with, (n,).
        extents: bounding boxes of all geoms.
    """
    offset_from_center = points - extents.center[geoms]
    distance_beyond_side = (
        np.abs((offset_from_center * extents.short_axis[geoms]).sum(axis=1))
        - extents.short_side[geoms] / 2
    )
    distance_beyond_end = (
        np.abs((offset_from_center * extents.long_axis[geoms]).sum(axis=1))
        - extents.long_side[geoms] / 2
    )
    return np.asarray(np.maximum(distance_beyond_side, distance_beyond_end) <= MAX_END_GAP)


def _add_wall_pieces(is_wall: Bool, may_continue_wall: Bool, extents: Extents) -> Bool:
    """Add to the walls the pieces that continue a wall in its line, and are no thicker than it.

    Args:
        is_wall: mask by geom id of the walls; it is not changed.
        may_continue_wall: mask by geom id of the geoms that may be such pieces.
        extents: bounding boxes of all geoms.

    Returns:
        A mask by geom id of the walls and the pieces.
    """
    is_wall = is_wall.copy()
    is_thin = extents.short_side <= THICK_WALL.max_thickness
    may_continue_wall = may_continue_wall & is_thin
    new_walls = np.flatnonzero(is_wall & is_thin)
    while len(new_walls):
        max_thickness = extents.short_side[new_walls].max() + 2 * MAX_EXTRA_THICKNESS
        pieces = np.flatnonzero(
            may_continue_wall & ~is_wall & (extents.short_side <= max_thickness)
        )
        continues_wall = np.zeros(len(is_wall), dtype=np.bool_)
        for wall_ids, piece_ids in _iterate_near_pairs(new_walls, pieces, extents):
            offset_from_center = extents.center[piece_ids] - extents.center[wall_ids]
            short_axis = extents.short_axis[wall_ids]
            long_axis = extents.long_axis[wall_ids]
            side_distance = np.abs(
                (offset_from_center * short_axis).sum(axis=1)
            ) + extents.half_widths(piece_ids, short_axis)
            end_distance = np.abs(
                (offset_from_center * long_axis).sum(axis=1)
            ) - extents.half_widths(piece_ids, long_axis)
            is_in_line = side_distance <= extents.short_side[wall_ids] / 2 + MAX_EXTRA_THICKNESS
            is_in_line &= end_distance <= extents.long_side[wall_ids] / 2 + MAX_END_GAP
            continues_wall[piece_ids[is_in_line]] = True
        new_walls = np.flatnonzero(continues_wall)
        is_wall |= continues_wall
    return is_wall


def _iterate_near_pairs(geoms: Int, neighbors: Int, extents: Extents) -> Iterator[tuple[Int, Int]]:
    """Yield the pairs of geoms and neighbors whose boxes touch, in chunks.

    Args:
        geoms: ids of the first geoms of pairs.
        neighbors: ids of the second geoms of pairs.
        extents: bounding boxes of all geoms.

    Yields:
        The first and the second geom of each pair, two arrays of ids.
    """
    all_geoms = np.arange(len(extents.short_side))
    center = np.column_stack([extents.center, (extents.bottom + extents.top) / 2])
    half_size = np.column_stack(
        [
            extents.half_widths(all_geoms, np.array([1.0, 0.0])),
            extents.half_widths(all_geoms, np.array([0.0, 1.0])),
            (extents.top - extents.bottom) / 2,
        ]
    )
    for geom_chunk in np.array_split(geoms, len(geoms) * len(neighbors) // MAX_PAIRS + 1):
        is_touching = np.ones((len(geom_chunk), len(neighbors)), dtype=np.bool_)
        for axis in range(3):
            center_distance = np.abs(center[geom_chunk, axis, None] - center[neighbors, axis])
            max_distance = (
                half_size[geom_chunk, axis, None] + half_size[neighbors, axis] + MAX_END_GAP
            )
            is_touching &= center_distance <= max_distance
        geom_index, neighbor_index = np.nonzero(is_touching)
        yield geom_chunk[geom_index], neighbors[neighbor_index]


def _is_furniture_panel(scene: Scene, extents: Extents, geom: int, subtree_ends: Int) -> bool:
    """Return whether a geom is a panel of furniture, such as the side of a cupboard.

    That is so if its body, or a body that this one belongs to, is deeper than the geom, but not
    larger than furniture is, see `MAX_FURNITURE_DEPTH`.
    """
    model = scene.model
    for body in _bodies_above(model, geom):
        body_geoms = geoms_of_bodies(model, body, int(subtree_ends[body]))
        body_geoms = body_geoms[~np.isnan(extents.short_side[body_geoms])]
        if len(body_geoms) > MAX_FURNITURE_GEOMS:
            return False
        depth = _measure_width(body_geoms, extents.short_axis[geom], extents)
        length = _measure_width(body_geoms, extents.long_axis[geom], extents)
        is_deeper = (
            extents.short_side[geom] + MIN_DEPTH_BEYOND_PANEL <= depth <= MAX_FURNITURE_DEPTH
        )
        if is_deeper and length <= MAX_FURNITURE_LENGTH:
            return True
    return False


def _measure_width(geoms: Int, axis: Float, extents: Extents) -> float:
    """Return how far some geoms together extend along a horizontal axis, a unit vector (2,) [m]."""
    center_on_axis = extents.center[geoms] @ axis
    half_width = extents.half_widths(geoms, axis)
    return float((center_on_axis + half_width).max() - (center_on_axis - half_width).min())


def _names(scene: Scene, geom: int) -> list[str]:
    """Return the names of a geom, of its body and of its mesh, as far as they have any."""
    names = all_names(scene.model).geoms[geom]
    return [name for name in (names.geom, names.body, names.mesh) if name]


def _bodies_above(model: mujoco.MjModel, geom: int) -> Iterator[int]:
    """Yield the bodies from a geom's own up to the topmost."""
    body = int(model.geom_bodyid[geom])
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


# ---------------------------------------------------------------- floors and ceilings


def classify_floor_geoms(
    counts: FloorCounts, steps: FloorSteps, cell_size: float, max_step: float
) -> FloorGeoms:
    """Classify geoms whose surfaces are floors as parts of the building or things on its floors.

    A geom is a thing (a rug, a pallet, a low box, a boulder) if all of these hold:

    a. Its floor, together with floors that continue it at the same height, covers at most 4 m².
    b. In at least 90 % of its cells the floor of a second geom lies below it.
    c. That lower floor is at most 1 m lower, or the thing is solid down to it.
    d. It is at most 3 cm above that lower floor in 90 % of its cells, or no step leads up from the
       thing to a part of the building.

    All other geoms are parts of the building: floors, stairs, ramps, platforms, terrain.

    Args:
        counts: in how many cells each geom is the floor, lies on a second floor (b, c), and covers
            it (d).
        steps: the steps between floors of two geoms in adjacent cells.
        cell_size: edge of a cell [m].
        max_step: the agent's highest step [m].

    Returns:
        Masks by geom id: parts of the building, things, and geoms that an agent can stand on.
    """
    num_geoms = len(counts.num_cells)
    is_floor = counts.num_cells > 0
    is_on_floor = counts.num_on_floors >= MIN_ON_FLOOR_SHARE * counts.num_cells
    covers_floor = counts.num_covering >= MIN_ON_FLOOR_SHARE * counts.num_cells

    is_same_height = steps.height <= SAME_HEIGHT
    same_height_pairs = np.stack(
        [steps.lower_geom[is_same_height], steps.higher_geom[is_same_height]]
    )
    # floors of several geoms that continue each other at the same height
    joined_floor_of_geom = label_components(same_height_pairs, num_geoms)
    joined_area = (
        np.bincount(joined_floor_of_geom, counts.num_cells)[joined_floor_of_geom] * cell_size**2
    )
    is_thing = is_floor & is_on_floor & (joined_area <= MAX_THING_AREA + LIMIT_SLACK)

    is_step = (steps.height > SAME_HEIGHT) & (steps.height <= max_step + LIMIT_SLACK)
    is_step &= ~covers_floor[steps.lower_geom]
    lower_geoms = steps.lower_geom[is_step]
    higher_geoms = steps.higher_geom[is_step]
    # a thing that leads to the building is a part of it; other things may then lead to that
    while True:
        geoms_below_building = np.unique(
            lower_geoms[is_thing[lower_geoms] & ~is_thing[higher_geoms]]
        )
        if not len(geoms_below_building):
            break
        is_thing[geoms_below_building] = False
    return FloorGeoms(
        is_building=is_floor & ~is_thing, is_thing=is_thing, is_stood_on=counts.is_stood_on
    )


def mark_ceilings(
    extents: Extents, min_height_above_floor: Float, is_static: Bool, agent: AgentSettings
) -> Bool:
    """Mark the geoms that are ceilings or roofs.

    They are static, at least `MIN_CEILING_WIDTH` wide along both axes, not taller than wide, and
    above an agent's head over every floor below them.

    Args:
        extents: bounding boxes of all geoms.
        min_height_above_floor: the least height of each geom above a floor below it [m]; inf if
            there is none.
        is_static: for each geom, whether it is static.
        agent: the agent; its height is read.

    Returns:
        A mask by geom id, shape (ngeom,), bool.
    """
    is_flat = extents.top - extents.bottom <= extents.short_side
    is_above_heads = min_height_above_floor >= agent.height - LIMIT_SLACK
    is_wide = extents.short_side >= MIN_CEILING_WIDTH
    is_ceiling: Bool = is_static & is_wide & is_flat & is_above_heads
    return is_ceiling


def find_steps(
    floors: Floors, floor_geoms_by_level: Sequence[Int32], lattice: Lattice
) -> FloorSteps:
    """Find the steps between the floors of two geoms in adjacent cells, on one level or on two.

    Args:
        floors: the floors of all levels, and the steps between levels.
        floor_geoms_by_level: for each level, the id of the geom whose surface is the floor, -1 for
            none, shape (cells,).
        lattice: the lattice of the floors.

    Returns:
        The steps, one for each pair of adjacent cells.
    """
    num_steps = len(floors.steps)
    geom_pairs = np.empty((num_steps, 2), dtype=np.int64)
    heights = np.empty((num_steps, 2))
    for end_of_step, (level_col, cell_col) in enumerate(((0, 1), (2, 3))):
        for level_number, level in enumerate(floors.levels):
            is_on_level = floors.steps[:, level_col] == level_number
            cells = floors.steps[is_on_level, cell_col]
            geom_pairs[is_on_level, end_of_step] = floor_geoms_by_level[level_number][cells]
            heights[is_on_level, end_of_step] = level.floor.ravel()[cells]
    geom_pair_arrays = [geom_pairs]
    height_arrays = [heights]
    for level, level_floor_geoms in zip(floors.levels, floor_geoms_by_level, strict=True):
        cell_pairs = list_differing_pairs(level_floor_geoms.reshape(lattice.shape)).T
        cell_pairs = cell_pairs[(level_floor_geoms[cell_pairs] >= 0).all(axis=1)]
        geom_pair_arrays.append(level_floor_geoms[cell_pairs].astype(np.int64))
        height_arrays.append(level.floor.ravel()[cell_pairs])
    geom_pairs = np.concatenate(geom_pair_arrays)
    height_difference = np.diff(np.concatenate(height_arrays), axis=1)[:, 0]
    geom_pairs[height_difference < 0] = geom_pairs[height_difference < 0, ::-1]
    return FloorSteps(
        lower_geom=geom_pairs[:, 0], higher_geom=geom_pairs[:, 1], height=np.abs(height_difference)
    )
