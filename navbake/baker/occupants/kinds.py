"""Classifies geoms: walls, meshes of a whole building, floors and ceilings, or things."""

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
from navbake.baker.core.windows import differing_pairs
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
# tops differ in height by at most SAME_TOP [m]
THICK_WALL = WallLimits(1.2, 3.0, 3.0)
SAME_TOP = 0.1
# Two walls meet at a corner if the cosine of their angle is at most that of 45 degrees [1]
MAX_CORNER_COSINE = 0.5**0.5
# Least height of a geom named like a wall, and of one that is also thin and long [m]
MIN_NAMED_HEIGHT = 1.0
MIN_NAMED_THIN_HEIGHT = 0.5
# A body with a panel (a geom with the shape of a wall) is furniture if it is deeper than the panel
# by at least FURNITURE_OVER_PANEL [m], and has at most this depth [m], length [m] and number of
# geoms
FURNITURE_OVER_PANEL = 0.1
FURNITURE_DEPTH = 1.2
FURNITURE_LENGTH = 3.0
FURNITURE_GEOMS = 200
# A geom that continues a wall may be this much thicker on each side, and this far from its end [m]
LINE_SLACK = 0.03
END_GAP = 0.05
MAX_PAIRS = 1_000_000  # of geoms that are compared at once, for the memory they take
# Least width along both axes of a mesh that holds a building [m], and the greatest share of its
# box, seen from above, that it fills within `WALL_HEIGHTS`
BUILDING_WIDTH = 2.0
MAX_FILLED_SHARE = 0.5
# The shapes, in the report of geoms, that such a mesh may have
TRIANGLE_SHAPES = ("surface", "closed surface", "partly closed", "shell")
# Least share of a wall's cells in which it reaches into `WALL_HEIGHTS`
MIN_UPRIGHT_SHARE = 0.5

# A thing that an agent can stand on has at most this area [m²]. In at least this share of its cells
# it lies on a floor: at most this high over it [m], unless the thing is solid down to it
THING_AREA = 4.0
MIN_ON_FLOOR_SHARE = 0.9
THING_HEIGHT = 1.0
# A thing of at most this height only covers the floor, as a rug does: a step up from it counts as
# one from the floor [m]
COVERING = 0.03
# The least width of a ceiling along both axes [m]
CEILING_WIDTH = 1.5


class OccupantSizes(NamedTuple):
    """The heights of geoms over floors, and the areas that they occupy, by geom id.

    Attributes:
        base: the least height of the geom's bottom over the floor of a cell that it occupies [m];
            inf where it occupies no cell, and for an endless plane.
        rise: the greatest height of the geom's top over its bottom, or over the floor of a cell
            that it occupies where the floor is higher than its bottom [m]; -inf where it occupies
            no cell, and for an endless plane.
        area: the area that the geom occupies on the level where that is largest [m²].
        area_at_wall_height: the same, counting only cells that it occupies within `WALL_HEIGHTS`
            [m²]; 0 for geoms whose shape is not that of walls, see `mark_wall_candidates`.
    """

    base: Float
    rise: Float
    area: Float
    area_at_wall_height: Float


class FloorCounts(NamedTuple):
    """Counts the cells in which the surface of a geom is the floor; by geom id, shape (ngeom,).

    Attributes:
        num_cells: number of cells in which the geom's surface is the floor.
        num_on_floors: number of these cells in which the geom lies on the floor of a second geom,
            see `THING_HEIGHT`.
        num_covers: number of these cells in which the geom's surface is at most `COVERING` above
            the floor of a second geom.
        stood_on: whether an agent can stand on the geom in any cell, bool.
    """

    num_cells: Int
    num_on_floors: Int
    num_covers: Int
    stood_on: Bool


class FloorSteps(NamedTuple):
    """Steps between the floors of two geoms in adjacent cells.

    Arrays of shape (n,), with one entry for each pair of cells.

    Attributes:
        lower: id of the geom whose surface is the lower floor.
        higher: id of the geom whose surface is the higher floor.
        rise: height of the step, >= 0 [m].
    """

    lower: Int
    higher: Int
    rise: Float


class FloorGeoms(NamedTuple):
    """Masks by geom id of the geoms whose surfaces are floors, shape (ngeom,), bool.

    Attributes:
        building: the geoms that are parts of the building.
        things: the geoms that lie on the building's floors (rugs, pallets).
        stood_on: the geoms of either mask that an agent can stand on in any cell.
    """

    building: Bool
    things: Bool
    stood_on: Bool


class ClassifiedGeoms(NamedTuple):
    """What geoms are, and warnings.

    Attributes:
        kinds: for each geom, OBJECT, WALL, STRUCTURE or BUILDING, shape (ngeom,), uint8.
        room_kinds: like `kinds`, but for finding rooms, see `StandingOccupants`.
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
    """Classify geoms, and warn of patterns of walls that match nothing.

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
    buildings = mark_buildings(scene, extents, sizes)
    ceilings = mark_ceilings(extents, sizes.base, scene.roles == STATIC_STRUCTURE, agent)
    walls = mark_wall_geoms(scene, extents, sizes, floor_geoms, excluded=buildings)
    kinds = np.full(len(scene.geoms), OBJECT, dtype=np.uint8)
    kinds[floor_geoms.building | ceilings] = STRUCTURE
    kinds[walls] = WALL
    kinds[buildings] = BUILDING
    room_kinds = kinds.copy()
    warnings = list[str]()
    if settings.walls:  # walls of the settings replace those by shape
        walls_by_name, warnings = match_wall_names(scene, settings.walls)
        kinds[kinds == WALL] = OBJECT
        kinds[walls_by_name] = WALL
        room_kinds[walls_by_name] = WALL
    room_kinds[mark_panes(extents, sizes, room_kinds == WALL)] = WALL
    return ClassifiedGeoms(kinds, room_kinds, warnings)


# ---------------------------------------------------------------- walls


def mark_wall_candidates(scene: Scene, extents: Extents) -> Bool:
    """Mark the geoms whose shape alone allows that they are walls, panes, or a whole building.

    Args:
        scene: the scene of the geoms.
        extents: bounding boxes of the geoms.

    Returns:
        A mask by geom id, shape (ngeom,), bool.
    """
    is_tall = extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_slender = _is_slender(extents, *THIN_WALLS, THICK_WALL)
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
    """Mark the geoms of triangles, other than hulls, that are as tall and wide as a building."""
    is_surface = [report.shape in TRIANGLE_SHAPES for report in scene.geoms]
    is_tall = extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_wide = extents.short_side >= BUILDING_WIDTH
    return np.array(is_surface, dtype=np.bool_) & is_tall & is_wide


def match_wall_names(scene: Scene, patterns: Sequence[str]) -> tuple[Bool, list[str]]:
    """Mark the geoms whose names match a pattern of walls.

    A pattern is compared with the names of the geom, of its mesh, of its body, and of all bodies
    above that one.

    Returns:
        A mask by geom id, and a warning for each pattern that matches nothing.
    """
    is_match = np.zeros(len(scene.geoms), dtype=np.bool_)
    warnings: list[str] = []
    names_by_geom = []
    for geom in range(len(scene.geoms)):
        bodies = _bodies_above(scene.model, geom)
        body_names = {body_name(scene.model, body) for body in bodies}
        names_by_geom.append(body_names | set(_names(scene, geom)))
    scene_names = sorted(set().union(*names_by_geom))
    for pattern in patterns:
        matches = {name for name in scene_names if fnmatchcase(name, pattern)}
        is_match |= np.array([not matches.isdisjoint(names) for names in names_by_geom], np.bool_)
        if not matches:
            warnings.append(warn_unmatched("names.walls", pattern, scene_names))
    return is_match, warnings


def mark_wall_geoms(
    scene: Scene, extents: Extents, sizes: OccupantSizes, floor_geoms: FloorGeoms, excluded: Bool
) -> Bool:
    """Mark, by geom id, the geoms whose shapes or names are those of walls.

    By its shape, a geom is a wall if it is static and vertical, begins near a floor, rises at least
    1.5 m, and is long and at most 0.25 m thick. A geom up to 0.5 m thick has to be longer. A geom
    up to 1.2 m thick also has to meet a wall, or a second geom as thick, at a corner, and be as
    high as that, which racks, containers and rows of cupboards don't. Panels of furniture, and
    geoms that an agent can stand on, are no walls.

    By its name, a static geom that begins near a floor is a wall if `wall` or `partition` is in the
    name of the geom, its mesh or its body. Its height has to be at least 1 m, or 0.5 m if it is
    also thin and long.

    Static pieces that continue in the line of a wall (parapets, lintels, stubs, windows) are walls,
    too, unless they carry floors. Excluded geoms are no walls in any case.
    """
    names = [" ".join(geom_names).lower() for geom_names in all_names(scene.model).geoms]
    has_wall_name = np.array([bool(WALL_NAME.search(name)) for name in names], dtype=np.bool_)
    is_static = (scene.roles == STATIC_STRUCTURE) & ~excluded
    is_slender = _is_slender(extents, *THIN_WALLS)
    is_near_floor = is_static & (sizes.base <= MAX_WALL_BOTTOM)

    walls_by_name = is_near_floor & has_wall_name
    walls_by_name &= (sizes.rise >= MIN_NAMED_HEIGHT) | (
        is_slender & (sizes.rise >= MIN_NAMED_THIN_HEIGHT)
    )

    is_upright = is_near_floor & (sizes.rise >= MIN_WALL_HEIGHT)
    is_upright &= ~floor_geoms.stood_on & ~walls_by_name
    is_upright &= sizes.area_at_wall_height >= MIN_UPRIGHT_SHARE * sizes.area
    walls_by_shape = is_upright & is_slender
    subtree_ends = find_subtree_ends(scene.model)
    for geom in np.flatnonzero(walls_by_shape):
        walls_by_shape[geom] = not _is_furniture_panel(scene, extents, int(geom), subtree_ends)

    is_thick = is_upright & ~is_slender & _is_slender(extents, THICK_WALL)
    walls_by_shape |= _meets_at_corner(is_thick, walls_by_name | walls_by_shape, extents)

    may_continue = is_static & ~floor_geoms.building & ~floor_geoms.things
    return _continue_walls(walls_by_name | walls_by_shape, may_continue, extents)


def mark_panes(extents: Extents, sizes: OccupantSizes, is_wall: Bool) -> Bool:
    """Mark, by geom id, the panes that close an opening in a wall: glass, sliding doors, leaves.

    A pane is as thin, long and tall as a wall, and begins near a floor or a sill. Each of its two
    ends meets a wall, or a second pane in the same opening.
    """
    is_pane = _is_slender(extents, THIN_WALLS[0])
    is_pane &= extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_pane &= (sizes.base <= MAX_WALL_BOTTOM) & ~is_wall
    # once a pane that meets nothing at an end is left out, its neighbor may meet nothing there
    while is_pane.any():
        panes = np.flatnonzero(is_pane)
        neighbors = np.flatnonzero(
            is_pane | is_wall & (extents.short_side <= THICK_WALL.max_thickness)
        )
        is_held = np.zeros((2, len(is_pane)), dtype=np.bool_)
        for pane, neighbor in _near_pairs(panes, neighbors, extents):
            for side, half in enumerate((-0.5, 0.5)):
                end = _end_of(pane, half, extents)
                holds = (pane != neighbor) & _is_on(end, neighbor, extents)
                is_held[side, pane[holds]] = True
        remains = is_pane & is_held.all(axis=0)
        if (remains == is_pane).all():
            break
        is_pane = remains
    return is_pane


def _is_slender(extents: Extents, *limits: WallLimits) -> Bool:
    """Mark the geoms that are thin and long by at least one of several limits."""
    is_slender = np.zeros(len(extents.short_side), dtype=np.bool_)
    for limit in limits:
        min_length = np.maximum(limit.min_length, limit.min_ratio * extents.short_side)
        is_slender |= (extents.short_side <= limit.max_thickness) & (
            extents.long_side >= min_length
        )
    return is_slender


def _meets_at_corner(is_thick: Bool, is_wall: Bool, extents: Extents) -> Bool:
    """Mark thick geoms that meet a wall, or another thick geom, of the same height at a corner."""
    meets = np.zeros(len(is_thick), dtype=np.bool_)
    if not is_thick.any():
        return meets
    thick_geoms = np.flatnonzero(is_thick)
    neighbors = np.flatnonzero(is_thick | is_wall)
    for geom, neighbor in _near_pairs(thick_geoms, neighbors, extents):
        cosine = np.abs((extents.long_axis[geom] * extents.long_axis[neighbor]).sum(axis=1))
        is_as_high = np.abs(extents.top[geom] - extents.top[neighbor]) <= SAME_TOP
        is_corner = (cosine <= MAX_CORNER_COSINE) & is_as_high
        is_corner &= _ends_at(geom, neighbor, extents) | _ends_at(neighbor, geom, extents)
        meets[geom[is_corner]] = True
    return meets


def _end_of(geoms: Int, half: float, extents: Extents) -> Float:
    """Return the middle of one end of each geom, seen from above, (n, 2) [m].

    Args:
        geoms: ids of the geoms, (n,).
        half: 0.5 for one end, -0.5 for the other.
        extents: bounding boxes of all geoms.
    """
    end: Float = (
        extents.center[geoms] + half * extents.long_side[geoms, None] * extents.long_axis[geoms]
    )
    return end


def _ends_at(geoms: Int, neighbors: Int, extents: Extents) -> Bool:
    """Mark the geoms that end at their neighbor: the middle of an end lies on it, from above.

    Args:
        geoms: ids of the geoms, (n,).
        neighbors: the id of the neighbor that each geom is compared with, (n,).
        extents: bounding boxes of all geoms.
    """
    ends = np.zeros(len(geoms), dtype=np.bool_)
    for half in (-0.5, 0.5):
        ends |= _is_on(_end_of(geoms, half, extents), neighbors, extents)
    return ends


def _is_on(points: Float, geoms: Int, extents: Extents) -> Bool:
    """Mark the points that lie on a geom, or at most `END_GAP` beside it, seen from above.

    Args:
        points: the points, (n, 2) [m].
        geoms: the id of the geom that each point is compared with, (n,).
        extents: bounding boxes of all geoms.
    """
    offset = points - extents.center[geoms]
    beyond_side = (
        np.abs((offset * extents.short_axis[geoms]).sum(axis=1)) - extents.short_side[geoms] / 2
    )
    beyond_end = (
        np.abs((offset * extents.long_axis[geoms]).sum(axis=1)) - extents.long_side[geoms] / 2
    )
    return np.asarray(np.maximum(beyond_side, beyond_end) <= END_GAP)


def _continue_walls(is_wall: Bool, may_continue: Bool, extents: Extents) -> Bool:
    """Add to the walls the pieces that continue in the line of one, and are no thicker than it is.

    Args:
        is_wall: mask by geom id of the walls; it is not changed.
        may_continue: mask by geom id of the geoms that may be such pieces.
        extents: bounding boxes of all geoms.

    Returns:
        A mask by geom id of the walls and the pieces.
    """
    is_wall = is_wall.copy()
    is_thin = extents.short_side <= THICK_WALL.max_thickness
    may_continue = may_continue & is_thin
    new_walls = np.flatnonzero(is_wall & is_thin)
    while len(new_walls):
        max_thickness = extents.short_side[new_walls].max() + 2 * LINE_SLACK
        pieces = np.flatnonzero(may_continue & ~is_wall & (extents.short_side <= max_thickness))
        continues = np.zeros(len(is_wall), dtype=np.bool_)
        for wall, piece in _near_pairs(new_walls, pieces, extents):
            offset = extents.center[piece] - extents.center[wall]
            across = extents.short_axis[wall]
            along = extents.long_axis[wall]
            to_side = np.abs((offset * across).sum(axis=1)) + extents.half_widths(piece, across)
            to_end = np.abs((offset * along).sum(axis=1)) - extents.half_widths(piece, along)
            is_in_line = to_side <= extents.short_side[wall] / 2 + LINE_SLACK
            is_in_line &= to_end <= extents.long_side[wall] / 2 + END_GAP
            continues[piece[is_in_line]] = True
        new_walls = np.flatnonzero(continues)
        is_wall |= continues
    return is_wall


def _near_pairs(geoms: Int, neighbors: Int, extents: Extents) -> Iterator[tuple[Int, Int]]:
    """Yield the pairs of geoms and neighbors whose boxes touch, in chunks.

    Args:
        geoms: ids of the first geoms of pairs.
        neighbors: ids of the second geoms of pairs.
        extents: bounding boxes of all geoms.

    Yields:
        The first and the second geom of each pair, two arrays of ids.
    """
    every_geom = np.arange(len(extents.short_side))
    center = np.column_stack([extents.center, (extents.bottom + extents.top) / 2])
    half_size = np.column_stack(
        [
            extents.half_widths(every_geom, np.array([1.0, 0.0])),
            extents.half_widths(every_geom, np.array([0.0, 1.0])),
            (extents.top - extents.bottom) / 2,
        ]
    )
    for geom_chunk in np.array_split(geoms, len(geoms) * len(neighbors) // MAX_PAIRS + 1):
        touches = np.ones((len(geom_chunk), len(neighbors)), dtype=np.bool_)
        for axis in range(3):
            distance = np.abs(center[geom_chunk, axis, None] - center[neighbors, axis])
            reach = half_size[geom_chunk, axis, None] + half_size[neighbors, axis] + END_GAP
            touches &= distance <= reach
        row, col = np.nonzero(touches)
        yield geom_chunk[row], neighbors[col]


def _is_furniture_panel(scene: Scene, extents: Extents, geom: int, subtree_ends: Int) -> bool:
    """Return whether a geom is a panel of furniture: of a body that is deeper than the panel.

    The body is the geom's own, or one above it; see `FURNITURE_DEPTH` for the limits.
    """
    model = scene.model
    for body in _bodies_above(model, geom):
        body_geoms = geoms_of_bodies(model, body, int(subtree_ends[body]))
        body_geoms = body_geoms[~np.isnan(extents.short_side[body_geoms])]
        if len(body_geoms) > FURNITURE_GEOMS:
            return False
        depth = _width_along(body_geoms, extents.short_axis[geom], extents)
        length = _width_along(body_geoms, extents.long_axis[geom], extents)
        is_deeper = extents.short_side[geom] + FURNITURE_OVER_PANEL <= depth <= FURNITURE_DEPTH
        if is_deeper and length <= FURNITURE_LENGTH:
            return True
    return False


def _width_along(geoms: Int, axis: Float, extents: Extents) -> float:
    """Return the width of some geoms together along a horizontal axis, (2,) [m]."""
    middle = extents.center[geoms] @ axis
    half = extents.half_widths(geoms, axis)
    return float((middle + half).max() - (middle - half).min())


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
    covers_floor = counts.num_covers >= MIN_ON_FLOOR_SHARE * counts.num_cells

    is_same_height = steps.rise <= SAME_HEIGHT
    same_height_pairs = np.stack([steps.lower[is_same_height], steps.higher[is_same_height]])
    # floors of several geoms that continue each other at the same height
    joined_floor = label_components(same_height_pairs, num_geoms)
    joined_area = np.bincount(joined_floor, counts.num_cells)[joined_floor] * cell_size**2
    things = is_floor & is_on_floor & (joined_area <= THING_AREA + LIMIT_SLACK)

    is_step = (steps.rise > SAME_HEIGHT) & (steps.rise <= max_step + LIMIT_SLACK)
    is_step &= ~covers_floor[steps.lower]
    lower = steps.lower[is_step]
    higher = steps.higher[is_step]
    # a thing that leads to the building is a part of it; other things may then lead to that
    while True:
        leads_to_building = np.unique(lower[things[lower] & ~things[higher]])
        if not len(leads_to_building):
            break
        things[leads_to_building] = False
    return FloorGeoms(building=is_floor & ~things, things=things, stood_on=counts.stood_on)


def mark_ceilings(extents: Extents, base: Float, is_static: Bool, agent: AgentSettings) -> Bool:
    """Mark the geoms that are ceilings or roofs; returns a mask by geom id, (ngeom,).

    They are static, at least `CEILING_WIDTH` wide along both axes, not taller than wide, and over
    no floor lower than the agent's head.

    Args:
        extents: bounding boxes of all geoms.
        base: the least height of each geom above a floor below it [m]; inf if there is none.
        is_static: for each geom, whether it is static.
        agent: the agent; its height is read.
    """
    is_flat = extents.top - extents.bottom <= extents.short_side
    is_above_heads = base >= agent.height - LIMIT_SLACK
    is_wide = extents.short_side >= CEILING_WIDTH
    ceilings: Bool = is_static & is_wide & is_flat & is_above_heads
    return ceilings


def find_steps(floors: Floors, floor_geom: Int32, lattice: Lattice) -> FloorSteps:
    """Find the steps between the floors of two geoms in adjacent cells, on one level or on two.

    Args:
        floors: the floors of all levels, and the steps between levels.
        floor_geom: the id of the geom whose surface is the floor, -1 for none, shape (levels,
            cells).
        lattice: the lattice of the floors.

    Returns:
        The steps, one for each pair of adjacent cells.
    """
    num_cells = floor_geom.shape[1]
    # cells of all levels are numbered one level after the other: level * num_cells + cell
    floor = np.concatenate([level.floor.ravel() for level in floors.levels])
    from_level, from_cell, to_level, to_cell = floors.links.T
    from_number = from_level * num_cells + from_cell
    to_number = to_level * num_cells + to_cell
    pairs = [np.stack([from_number, to_number], axis=1)]
    for level, geoms in enumerate(floor_geom):
        cell_pairs = differing_pairs(geoms.reshape(lattice.shape)).T
        have_floors = (geoms[cell_pairs] >= 0).all(axis=1)
        pairs.append(cell_pairs[have_floors] + level * num_cells)
    cell_pairs = np.concatenate(pairs)
    rise = floor[cell_pairs[:, 1]] - floor[cell_pairs[:, 0]]
    geom_pairs = floor_geom.ravel()[cell_pairs].astype(np.int64)
    geom_pairs[rise < 0] = geom_pairs[rise < 0, ::-1]
    return FloorSteps(lower=geom_pairs[:, 0], higher=geom_pairs[:, 1], rise=np.abs(rise))
