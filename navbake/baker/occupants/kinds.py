"""What geoms are: walls, meshes that hold a whole building, its floors and ceilings, or things."""

import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

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

HINTED = re.compile("wall|partition")  # in the names of walls, whatever the case

# A wall begins at most this far over a floor (a window over its sill), and is this high [m]
NEAR_FLOOR = 0.6
TALL = 1.5
# Most thickness, least length and least ratio of both, of a thin wall and of a thick one [m, m, 1]
THIN = ((0.25, 0.5, 3.0), (0.5, 3.0, 6.0))
# The same of one that is thicker still, and meets another at a corner, with tops this near [m]
THICK = (1.2, 3.0, 3.0)
AS_HIGH = 0.1
# Two walls meet at a corner where they are no nearer to one direction than 45 degrees [1]
CROSSWISE = 0.5**0.5
# Least heights of geoms named like a wall, and of those of them that are thin and long [m]
NAMED_TALL = 1.0
LOW = 0.5
# A body is furniture if it is this much deeper than its panel, and at most so deep, so long [m],
# and of so many geoms
DEEPER = 0.1
FURNITURE_DEPTH = 1.2
FURNITURE_LENGTH = 3.0
FURNITURE_PARTS = 200
# A piece that continues a wall is at most this thicker on a side, and so far from its end [m]
IN_LINE = 0.03
TOUCHING = 0.05
PAIRS = 1_000_000  # of walls and pieces that are compared at once, for the memory they take
# Least width both ways of a mesh that holds a building [m], and share of it that is filled at most
BUILDING_WIDTH = 2.0
HOLLOW = 0.5
# Its shape in the report of geoms
TRIANGLES = ("surface", "closed surface", "partly closed", "shell")
# Heights over a floor where such a mesh is wall [m]
WALL_HEIGHTS = (1.5, 1.8)
# Least share of its cells in which a wall reaches that band
UPRIGHT = 0.5


# A thing that one can stand on is at most this large, and lies at most this high over a floor
# unless it is solid down to it [m², m], in at least this share of its cells
THING_AREA = 4.0
THING_HEIGHT = 1.0
MOSTLY = 0.9
# A lower rise is no step on the way up [m]
COVERING = 0.03
# A ceiling is at least this wide both ways [m]
CEILING_WIDTH = 1.5

Steps = tuple[Int, Int, Float]
"""Pairs of geoms whose floors lie side by side: the lower, the higher, and by how much [m]."""


class FloorGeoms(NamedTuple):
    """The geoms that carry floors, by geom id, shape (ngeom,), bool.

    Attributes:
        building: those that belong to the building.
        things: those that only lie on its floors.
        stood_on: those of both that one can stand on somewhere; others carry floor under things.
    """

    building: Bool
    things: Bool
    stood_on: Bool


class GeomHeights(NamedTuple):
    """How geoms stand over floors, by geom id.

    Attributes:
        base: least height of its bottom over a floor of a cell it stands in, inf for none [m].
        rise: greatest height of its top over its bottom or such a floor, whichever is higher,
            -inf for none [m].
        area: how much of a storey it stands in, at most [m²].
        upper_area: the same within `WALL_HEIGHTS`; known for `mark_wall_candidates` only [m²].
    """

    base: Float
    rise: Float
    area: Float
    upper_area: Float


def mark_wall_candidates(scene: Scene, extents: Extents) -> Bool:
    """Mark the geoms that may be walls, panes or hold a building, by their own shape alone."""
    tall = extents.high - extents.low >= TALL
    slender = _is_slender(extents, *THIN, THICK)
    return tall & slender | _may_hold_building(is_surface(scene), extents)


def find_buildings(scene: Scene, extents: Extents, over_floors: GeomHeights) -> Bool:
    """Mark the meshes that hold a whole building: surfaces, tall, wide both ways, and hollow."""
    hollow = over_floors.upper_area < HOLLOW * extents.thin * extents.long
    return _may_hold_building(is_surface(scene), extents) & hollow


def is_surface(scene: Scene) -> Bool:
    """Mark the geoms made of triangles other than hulls."""
    return np.array([report.shape in TRIANGLES for report in scene.geoms], dtype=np.bool_)


def match_walls(scene: Scene, patterns: Sequence[str]) -> tuple[Bool, list[str]]:
    """Mark the geoms whose own, mesh's or body's name matches, up to the topmost body.

    Also warns of each pattern that matches nothing.
    """
    matched = np.zeros(len(scene.geoms), dtype=np.bool_)
    warnings: list[str] = []
    by_geom = []
    for geom in range(len(scene.geoms)):
        above = (body_name(scene.model, body) for body in _bodies_above(scene.model, geom))
        by_geom.append({*_names(scene, geom), *above})
    known = sorted(set().union(*by_geom))
    for pattern in patterns:
        hits = {name for name in known if fnmatchcase(name, pattern)}
        matched |= np.array([not hits.isdisjoint(names) for names in by_geom], dtype=np.bool_)
        if not hits:
            warnings.append(warn_unmatched("names.walls", pattern, known))
    return matched, warnings


def find_walls(
    scene: Scene, extents: Extents, over_floors: GeomHeights, carriers: FloorGeoms, excluded: Bool
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
    named_by_geom = [" ".join(names).lower() for names in all_names(scene.model).geoms]
    hinted = np.array([bool(HINTED.search(names)) for names in named_by_geom], dtype=np.bool_)
    static = (scene.roles == STATIC_STRUCTURE) & ~excluded
    slender = _is_slender(extents, *THIN)
    stands = static & (over_floors.base <= NEAR_FLOOR)
    named = stands & hinted
    named &= (over_floors.rise >= NAMED_TALL) | (slender & (over_floors.rise >= LOW))
    upright = stands & (over_floors.rise >= TALL) & ~carriers.stood_on & ~named
    upright &= over_floors.upper_area >= UPRIGHT * over_floors.area
    shaped = upright & slender
    ends = find_subtree_ends(scene.model)
    for geom in np.flatnonzero(shaped):
        shaped[geom] = not _is_furniture_panel(scene, extents, int(geom), ends)
    thick = upright & ~slender & _is_slender(extents, THICK)
    shaped |= _meets_at_corner(thick, named | shaped, extents)
    pieces = static & ~carriers.building & ~carriers.things
    return _in_line(named | shaped, pieces, extents)


def find_panes(extents: Extents, over_floors: GeomHeights, walls: Bool) -> Bool:
    """Mark what closes an opening in a wall: fixed panes, sliding doors, closed leaves.

    A pane is as thin, long and tall as a wall, begins near a floor or a sill, and ends on both
    sides at walls or other panes of the opening.
    """
    thin, long, ratio = THIN[0]
    panes = _is_slender(extents, (thin, long, ratio)) & (extents.high - extents.low >= TALL)
    panes &= (over_floors.base <= NEAR_FLOOR) & ~walls
    while panes.any():
        asked = np.flatnonzero(panes)
        beside = np.flatnonzero(panes | walls & (extents.thin <= THICK[0]))
        held = np.zeros((2, len(panes)), dtype=np.bool_)
        for one, other in _near_pairs(asked, beside, extents):
            for side, half in enumerate((-0.5, 0.5)):
                end = extents.center[one] + half * extents.long[one, None] * extents.along[one]
                held[side, one[(one != other) & _is_in(end, other, extents)]] = True
        kept = panes & held.all(axis=0)
        if (kept == panes).all():
            break
        panes = kept
    return panes


def _is_slender(extents: Extents, *limits: tuple[float, float, float]) -> Bool:
    """Mark what is thin and long by any of several limits; see `THIN`."""
    slender = np.zeros(len(extents.thin), dtype=np.bool_)
    for thin, long, ratio in limits:
        is_long = extents.long >= np.maximum(long, ratio * extents.thin)
        slender |= (extents.thin <= thin) & is_long
    return slender


def _meets_at_corner(thick: Bool, walls: Bool, extents: Extents) -> Bool:
    """Mark thick geoms that meet a wall, or another thick one, at a corner, as high as it."""
    meets = np.zeros(len(thick), dtype=np.bool_)
    if not thick.any():
        return meets
    for one, other in _near_pairs(np.flatnonzero(thick), np.flatnonzero(thick | walls), extents):
        turn = np.abs((extents.along[one] * extents.along[other]).sum(axis=1))
        corner = (turn <= CROSSWISE) & (np.abs(extents.high[one] - extents.high[other]) <= AS_HIGH)
        corner &= _ends_at(one, other, extents) | _ends_at(other, one, extents)
        meets[one[corner]] = True
    return meets


def _ends_at(one: Int, other: Int, extents: Extents) -> Bool:
    """Whether the middle of an end of each geom is on another one, seen from above."""
    ends = np.zeros(len(one), dtype=np.bool_)
    for half in (-0.5, 0.5):
        end = extents.center[one] + half * extents.long[one, None] * extents.along[one]
        ends |= _is_in(end, other, extents)
    return ends


def _is_in(points: Float, geoms: Int, extents: Extents) -> Bool:
    """Whether each point, (n, 2) [m], is on its geom, seen from above."""
    off = points - extents.center[geoms]
    across = np.abs((off * extents.across[geoms]).sum(axis=1)) - extents.thin[geoms] / 2
    along = np.abs((off * extents.along[geoms]).sum(axis=1)) - extents.long[geoms] / 2
    return np.asarray(np.maximum(across, along) <= TOUCHING)


def _may_hold_building(surface: Bool, extents: Extents) -> Bool:
    tall = extents.high - extents.low >= TALL
    return surface & tall & (extents.thin >= BUILDING_WIDTH)


def _in_line(walls: Bool, candidates: Bool, extents: Extents) -> Bool:
    """Add the pieces that touch a wall's end and continue in its line, no thicker than it is."""
    walls = walls.copy()
    thin = extents.thin <= THICK[0]
    candidates = candidates & thin
    new = np.flatnonzero(walls & thin)
    while len(new):
        thickest = extents.thin[new].max() + 2 * IN_LINE
        pieces = np.flatnonzero(candidates & ~walls & (extents.thin <= thickest))
        found = np.zeros(len(walls), dtype=np.bool_)
        for wall, piece in _near_pairs(new, pieces, extents):
            offset = extents.center[piece] - extents.center[wall]
            across = extents.across[wall]
            along = extents.along[wall]
            beyond = np.abs((offset * across).sum(axis=1)) + extents.half_widths(piece, across)
            gap = np.abs((offset * along).sum(axis=1)) - extents.half_widths(piece, along)
            fits = beyond <= extents.thin[wall] / 2 + IN_LINE
            fits &= gap <= extents.long[wall] / 2 + TOUCHING
            found[piece[fits]] = True
        new = np.flatnonzero(found)
        walls |= found
    return walls


def _near_pairs(walls: Int, pieces: Int, extents: Extents) -> Iterator[tuple[Int, Int]]:
    """Pairs of walls and pieces whose boxes touch, a block of walls at a time."""
    geoms = np.arange(len(extents.thin))
    center = np.column_stack([extents.center, (extents.low + extents.high) / 2])
    x, y = (extents.half_widths(geoms, axis) for axis in np.eye(2))
    reach = np.column_stack([x, y, (extents.high - extents.low) / 2])
    for block in np.array_split(walls, len(walls) * len(pieces) // PAIRS + 1):
        touch = np.ones((len(block), len(pieces)), dtype=np.bool_)
        for axis in range(3):
            apart = np.abs(center[block, axis, None] - center[pieces, axis])
            touch &= apart <= reach[block, axis, None] + reach[pieces, axis] + TOUCHING
        wall, piece = np.nonzero(touch)
        yield block[wall], pieces[piece]


def _is_furniture_panel(scene: Scene, extents: Extents, geom: int, ends: Int) -> bool:
    """Whether a body that holds the geom is furniture, see `FURNITURE_DEPTH`."""
    model = scene.model
    for body in _bodies_above(model, geom):
        inside = geoms_of_bodies(model, body, int(ends[body]))
        parts = inside[~np.isnan(extents.thin[inside])]
        if len(parts) > FURNITURE_PARTS:
            return False
        sides = []
        for way in (extents.across[geom], extents.along[geom]):
            middle = extents.center[parts] @ way
            half = extents.half_widths(parts, way)
            sides.append(float((middle + half).max() - (middle - half).min()))
        is_deeper = extents.thin[geom] + DEEPER <= sides[0] <= FURNITURE_DEPTH
        if is_deeper and sides[1] <= FURNITURE_LENGTH:
            return True
    return False


def _names(scene: Scene, geom: int) -> list[str]:
    """The names of a geom, of its body and of its mesh."""
    names = all_names(scene.model).geoms[geom]
    return [name for name in (names.geom, names.body, names.mesh) if name]


def _bodies_above(model: Any, geom: int) -> Iterator[int]:
    """The bodies from a geom's up to the topmost."""
    body = int(model.geom_bodyid[geom])
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


def classify_floor_geoms(
    counts: Int, stood_on: Bool, cell_size: float, step: float, steps: Steps
) -> FloorGeoms:
    """Classify geoms that carry floors as parts of the building or things on its floors.

    A geom is a thing (a rug, a pallet, a low box, a boulder) if all of these hold:

    a. Its floor, with the floors that continue it at the same height, covers at most 4 m².
    b. In at least 90 % of its cells there is another floor below it,
    c. which is at most 1 m lower, or down to which it is solid.
    d. It covers 90 % of its cells by at most 3 cm, or no step leads up from it to the building.

    All else is the building's: floors, stairs, ramps, platforms, terrain.

    Args:
        counts: in how many cells each geom carries the floor, in how many of those it lies on
            another one (c), and in how many it only covers that (d), (3, ngeom).
        stood_on: whether one can stand on it anywhere, (ngeom,).
        step: the highest one [m].
    """
    cells, over, near = counts
    carries = cells > 0
    is_over = over >= MOSTLY * cells
    covering = near >= MOSTLY * cells
    low, high, rise = steps
    is_level = rise <= SAME_HEIGHT
    plateau = label_components(np.stack([low[is_level], high[is_level]]), len(cells))
    area = np.bincount(plateau, cells)[plateau] * cell_size**2
    things = carries & (area <= THING_AREA + LIMIT_SLACK) & is_over
    is_step = (rise > SAME_HEIGHT) & (rise <= step + LIMIT_SLACK) & ~covering[low]
    low = low[is_step]
    high = high[is_step]
    # a thing that leads to the building is part of it, and may make another one lead there
    while (leads_up := np.unique(low[things[low] & ~things[high]])).size:
        things[leads_up] = False
    return FloorGeoms(carries & ~things, things, stood_on)


def find_ceilings(extents: Extents, base: Float, static: Bool, agent: AgentSettings) -> Bool:
    """Mark ceilings and roofs: static, wide both ways, no taller than wide, and above head height.

    `base` is the least height of each geom over a floor that it hangs over, inf for none [m].
    """
    flat = extents.high - extents.low <= extents.thin
    high = base >= agent.height - LIMIT_SLACK
    ceilings: Bool = static & (extents.thin >= CEILING_WIDTH) & flat & high
    return ceilings


def find_steps(floors: Floors, carrier: Int32, lattice: Lattice) -> Steps:
    """Find where the floors of two geoms lie side by side.

    `carrier` is the geom that carries each floor, shape (levels, cells), -1 for none.
    """
    floor = np.concatenate([level.floor.ravel() for level in floors.levels])
    pairs = [floors.links[:, [0, 2]] * carrier.shape[1] + floors.links[:, [1, 3]]]
    for number, geom in enumerate(carrier.reshape(-1, *lattice.shape)):
        cells = differing_pairs(geom).T
        meet = (carrier[number][cells] >= 0).all(axis=1)
        pairs.append(cells[meet] + number * geom.size)  # cells of all levels are numbered on
    cells = np.concatenate(pairs)
    rise = floor[cells[:, 1]] - floor[cells[:, 0]]
    geoms = carrier.ravel()[cells].astype(np.int64)
    geoms[rise < 0] = geoms[rise < 0, ::-1]
    return geoms[:, 0], geoms[:, 1], np.abs(rise)


Classified = tuple[NDArray[np.uint8], NDArray[np.uint8], list[str]]
"""Kinds and partitions by geom id, see `StandingOccupants`, and warnings."""


def classify_geoms(
    scene: Scene,
    extents: Extents,
    over_floors: GeomHeights,
    carriers: FloorGeoms,
    agent: AgentSettings,
    settings: NameSettings,
) -> Classified:
    """Kinds and partitions of geoms, see `StandingOccupants`, and warnings."""
    buildings = find_buildings(scene, extents, over_floors)
    ceilings = find_ceilings(extents, over_floors.base, scene.roles == STATIC_STRUCTURE, agent)
    kinds = np.full(len(scene.geoms), OBJECT, dtype=np.uint8)
    kinds[carriers.building | ceilings] = STRUCTURE
    kinds[find_walls(scene, extents, over_floors, carriers, buildings)] = WALL
    kinds[buildings] = BUILDING
    partitions = kinds.copy()
    warnings = list[str]()
    if settings.walls:  # walls of the settings replace those by shape
        named, warnings = match_walls(scene, settings.walls)
        kinds[kinds == WALL] = OBJECT
        kinds[named] = partitions[named] = WALL
    partitions[find_panes(extents, over_floors, partitions == WALL)] = WALL
    return kinds, partitions, warnings
