"""What geoms are: walls, meshes that hold a whole building, its floors and ceilings, or things."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import HeightRange
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
        max_thickness: the most thickness [m].
        min_length: the least length [m].
        min_ratio: the least ratio of length and thickness [1].
    """

    max_thickness: float
    min_length: float
    min_ratio: float


WALL_NAME = re.compile("wall|partition")  # in the names of walls, whatever the case

# A wall begins at most this far over a floor (a window over its sill), and is this high [m]
NEAR_FLOOR = 0.6
MIN_WALL_HEIGHT = 1.5
# A thin wall, and one that is thicker but long
THIN_WALLS = (WallLimits(0.25, 0.5, 3.0), WallLimits(0.5, 3.0, 6.0))
# A wall that is thicker still has to meet another one at a corner, with tops this near [m]
THICK_WALL = WallLimits(1.2, 3.0, 3.0)
SAME_TOP = 0.1
# Two walls meet at a corner if the cosine of their angle is at most that of 45 degrees [1]
MAX_CORNER_COSINE = 0.5**0.5
# Least height of a geom named like a wall, and of one that is also thin and long [m]
MIN_NAMED_HEIGHT = 1.0
MIN_NAMED_THIN_HEIGHT = 0.5
# A body is furniture if it is this much deeper than its panel, and at most so deep, so long [m],
# and of so many geoms
FURNITURE_OVER_PANEL = 0.1
FURNITURE_DEPTH = 1.2
FURNITURE_LENGTH = 3.0
FURNITURE_GEOMS = 200
# A geom that continues a wall is at most this much thicker on a side, and so far from its end [m]
LINE_SLACK = 0.03
END_GAP = 0.05
MAX_PAIRS = 1_000_000  # of geoms that are compared at once, for the memory they take
# Least width both ways of a mesh that holds a building [m], and share of its box that walls fill at
# most
BUILDING_WIDTH = 2.0
MAX_FILLED_SHARE = 0.5
# Its shape in the report of geoms
TRIANGLE_SHAPES = ("surface", "closed surface", "partly closed", "shell")
# Heights over a floor where such a mesh is wall [m]
WALL_HEIGHTS = HeightRange(1.5, 1.8)
# Least share of its cells in which a wall is in `WALL_HEIGHTS`
MIN_UPRIGHT_SHARE = 0.5

# A thing that one can stand on is at most this large [m²]. In at least this share of its cells it
# lies on a floor: at most this high over it [m], unless it is solid down to it
THING_AREA = 4.0
MIN_ON_FLOOR_SHARE = 0.9
THING_HEIGHT = 1.0
# A lower rise is no step on the way up [m]
COVERING = 0.03
# A ceiling is at least this wide both ways [m]
CEILING_WIDTH = 1.5


class OccupantSizes(NamedTuple):
    """How geoms stand over floors, by geom id.

    Attributes:
        base: least height of its bottom over a floor of a cell it occupies, inf for none [m].
        rise: greatest height of its top over its bottom or such a floor, whichever is higher,
            -inf for none [m].
        area: how much of a level it occupies, at most [m²].
        area_at_wall_height: the same within `WALL_HEIGHTS`; 0 but for wall candidates [m²].
    """

    base: Float
    rise: Float
    area: Float
    area_at_wall_height: Float


class FloorCounts(NamedTuple):
    """How often the surfaces of geoms are floors, by geom id, shape (ngeom,).

    Attributes:
        num_cells: in how many cells the geom's surface is the floor.
        num_on_floors: in how many of these the geom lies on another geom's floor.
        num_covers: in how many of these it only covers another floor, by up to `COVERING`.
        stood_on: whether an agent can stand on it anywhere, bool.
    """

    num_cells: Int
    num_on_floors: Int
    num_covers: Int
    stood_on: Bool


class FloorSteps(NamedTuple):
    """Pairs of geoms whose floors lie side by side, one pair for each pair of cells, shape (n,).

    Attributes:
        lower: geom of the lower floor.
        higher: geom of the higher floor.
        rise: height of the step, >= 0 [m].
    """

    lower: Int
    higher: Int
    rise: Float


class FloorGeoms(NamedTuple):
    """The geoms whose surfaces are floors, by geom id, shape (ngeom,), bool.

    Attributes:
        building: those that belong to the building.
        things: those that only lie on its floors.
        stood_on: those of both that an agent can stand on somewhere; others are floor under things.
    """

    building: Bool
    things: Bool
    stood_on: Bool


class ClassifiedGeoms(NamedTuple):
    """Kinds of geoms by geom id, see `StandingOccupants`, and warnings."""

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
        scene: the scene whose geoms stand.
        extents: boxes round the geoms.
        sizes: how the geoms stand over floors.
        floor_geoms: the geoms that are floors.
        agent: its height.
        settings: patterns of the names of walls.
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
    """Mark the geoms that may be walls, panes or hold a building, by their own shape alone.

    Args:
        scene: the scene whose geoms stand.
        extents: boxes round the geoms.

    Returns:
        The mark of each geom, by id, shape (ngeom,), bool.
    """
    is_tall = extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_slender = _is_slender(extents, *THIN_WALLS, THICK_WALL)
    return is_tall & is_slender | _may_hold_building(scene, extents)


def mark_buildings(scene: Scene, extents: Extents, sizes: OccupantSizes) -> Bool:
    """Mark the meshes that hold a whole building: surfaces, tall, wide both ways, and hollow."""
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
    """Mark the geoms that patterns name as walls, and warn of each pattern that matches nothing.

    A pattern may match the name of the geom, of its mesh, or of a body from its own to the topmost.
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
    """Mark the walls by their shapes and names; excluded geoms are none.

    A wall is static, rises from near a floor over 1.5 m, straight up, and is thin (0.25 m) and
    long; a thicker one (0.5 m) is longer. One that is thicker still (1.2 m) has to meet a wall, or
    another such one, at a corner, and be as high, unlike a rack, a container or a row of cupboards.
    A panel of a deeper piece of furniture is none, nor is what one can stand on.

    With `wall` or `partition` in its geom's, mesh's or body's name, 1 m is tall enough, whatever
    else; and 0.5 m if it is thin and long. Pieces that continue in the line of a wall are walls,
    too (parapets, lintels, stubs, windows), unless they carry floors.
    """
    names = [" ".join(geom_names).lower() for geom_names in all_names(scene.model).geoms]
    has_wall_name = np.array([bool(WALL_NAME.search(name)) for name in names], dtype=np.bool_)
    is_static = (scene.roles == STATIC_STRUCTURE) & ~excluded
    is_slender = _is_slender(extents, *THIN_WALLS)
    is_near_floor = is_static & (sizes.base <= NEAR_FLOOR)

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
    """Mark what closes an opening in a wall: fixed panes, sliding doors, closed leaves.

    A pane is as thin, long and tall as a wall, begins near a floor or a sill, and ends on both
    sides at walls or other panes of the opening.
    """
    is_pane = _is_slender(extents, THIN_WALLS[0])
    is_pane &= extents.top - extents.bottom >= MIN_WALL_HEIGHT
    is_pane &= (sizes.base <= NEAR_FLOOR) & ~is_wall
    # without a pane that ends nowhere, its neighbor may end nowhere, too
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
    """Mark what is thin and long by any of several limits."""
    is_slender = np.zeros(len(extents.short_side), dtype=np.bool_)
    for limit in limits:
        min_length = np.maximum(limit.min_length, limit.min_ratio * extents.short_side)
        is_slender |= (extents.short_side <= limit.max_thickness) & (
            extents.long_side >= min_length
        )
    return is_slender


def _meets_at_corner(is_thick: Bool, is_wall: Bool, extents: Extents) -> Bool:
    """Mark thick geoms that meet a wall, or another thick one, at a corner, as high as it."""
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
    """Return the middle of one end of each geom, seen from above, (n, 2) [m]; `half`: +-0.5."""
    end: Float = (
        extents.center[geoms] + half * extents.long_side[geoms, None] * extents.long_axis[geoms]
    )
    return end


def _ends_at(geoms: Int, neighbors: Int, extents: Extents) -> Bool:
    """Mark the geoms that have the middle of an end on their neighbor, seen from above."""
    ends = np.zeros(len(geoms), dtype=np.bool_)
    for half in (-0.5, 0.5):
        ends |= _is_on(_end_of(geoms, half, extents), neighbors, extents)
    return ends


def _is_on(points: Float, geoms: Int, extents: Extents) -> Bool:
    """Mark the points, (n, 2) [m], that are on their geom, seen from above."""
    offset = points - extents.center[geoms]
    beyond_side = (
        np.abs((offset * extents.short_axis[geoms]).sum(axis=1)) - extents.short_side[geoms] / 2
    )
    beyond_end = (
        np.abs((offset * extents.long_axis[geoms]).sum(axis=1)) - extents.long_side[geoms] / 2
    )
    return np.asarray(np.maximum(beyond_side, beyond_end) <= END_GAP)


def _continue_walls(is_wall: Bool, may_continue: Bool, extents: Extents) -> Bool:
    """Add the pieces that touch a wall's end and continue in its line, no thicker than it is."""
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
    """Yield the pairs of geoms and neighbors whose boxes touch, some of the geoms at a time."""
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
    """Return whether a body that holds the geom is furniture, see `FURNITURE_DEPTH`."""
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

    a. Its floor, with the floors that continue it at the same height, covers at most 4 m².
    b. In at least 90 % of its cells there is another floor below it,
    c. which is at most 1 m lower, or down to which it is solid.
    d. It covers 90 % of its cells by at most 3 cm, or no step leads up from it to the building.

    All else is the building's: floors, stairs, ramps, platforms, terrain.

    Args:
        counts: how often each geom is a floor, and lies on another one (b, c) or covers it (d).
        steps: where floors of two geoms lie side by side.
        cell_size: edge of a cell [m].
        max_step: the agent's highest step [m].
    """
    num_geoms = len(counts.num_cells)
    is_floor = counts.num_cells > 0
    is_on_floor = counts.num_on_floors >= MIN_ON_FLOOR_SHARE * counts.num_cells
    covers_floor = counts.num_covers >= MIN_ON_FLOOR_SHARE * counts.num_cells

    is_level = steps.rise <= SAME_HEIGHT
    level_pairs = np.stack([steps.lower[is_level], steps.higher[is_level]])
    plateau = label_components(level_pairs, num_geoms)  # floors at one height, side by side
    plateau_area = np.bincount(plateau, counts.num_cells)[plateau] * cell_size**2
    things = is_floor & is_on_floor & (plateau_area <= THING_AREA + LIMIT_SLACK)

    is_step = (steps.rise > SAME_HEIGHT) & (steps.rise <= max_step + LIMIT_SLACK)
    is_step &= ~covers_floor[steps.lower]
    lower = steps.lower[is_step]
    higher = steps.higher[is_step]
    # a thing that leads to the building is part of it, and may make another one lead there
    while True:
        leads_to_building = np.unique(lower[things[lower] & ~things[higher]])
        if not len(leads_to_building):
            break
        things[leads_to_building] = False
    return FloorGeoms(building=is_floor & ~things, things=things, stood_on=counts.stood_on)


def mark_ceilings(extents: Extents, base: Float, is_static: Bool, agent: AgentSettings) -> Bool:
    """Mark ceilings and roofs: static, wide both ways, no taller than wide, and above head height.

    `base` is the least height of each geom over a floor that it hangs over, inf for none [m].
    """
    is_flat = extents.top - extents.bottom <= extents.short_side
    is_above_heads = base >= agent.height - LIMIT_SLACK
    is_wide = extents.short_side >= CEILING_WIDTH
    ceilings: Bool = is_static & is_wide & is_flat & is_above_heads
    return ceilings


def find_steps(floors: Floors, floor_geom: Int32, lattice: Lattice) -> FloorSteps:
    """Find where the floors of two geoms lie side by side, on one level or on two.

    Args:
        floors: the floors of all levels, and the links between levels.
        floor_geom: the geom whose surface each floor is, -1 for none, shape (levels, cells).
        lattice: the cells.
    """
    num_cells = floor_geom.shape[1]
    # cells of all levels are numbered on: level * num_cells + cell
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
