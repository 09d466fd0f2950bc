"""Find floors that are on no level because they lie a little below the ground of a given level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navbake.baker.core.area_test import is_large_enough, make_area_test
from navbake.baker.core.arrays import HeightRange
from navbake.baker.floors.level_assignment import (
    CONFIGURED_GROUND_TOLERANCE,
    list_level_height_ranges,
)
from navbake.baker.floors.region_kernels import RegionSurfaces
from navbake.baker.floors.regions import Patch, Regions, describe_surfaces
from navbake.config.settings import FloorSettings, LevelSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool

# A configured ground may have been set too high by a slab's thickness: a floor up to this far below
# it may belong to its level [m]
MAX_GROUND_ERROR = 0.5
# What lies below a ground is searched in slices of this height, which begin half as far apart. A
# slice of a stair has one tread, and a slice of a ramp is short, so neither is a large floor [m]
SLICE_HEIGHT = 0.1
LOWER_GROUND_DECIMALS = 2  # grounds to give in place of others are rounded to centimetres
NO_SURFACES = RegionSurfaces(
    cell=np.empty(0, dtype=np.int64),
    z=np.empty(0),
    geom=np.empty(0, dtype=np.int32),
    surface_id=np.empty(0, dtype=np.int64),
)


@dataclass(frozen=True)
class FloorBelowGround:
    """Floor that is on no level because it lies a little below the ground of a given level.

    Attributes:
        ground: the ground of the level [m].
        lower_ground: a lower ground for the level, with which it has the floor [m].
        patch: the surfaces of the floor.
    """

    ground: float
    lower_ground: float
    patch: Patch


def find_floors_below_grounds(
    regions: Regions,
    is_included: Bool,
    level_settings: Sequence[LevelSettings],
    settings: FloorSettings,
) -> list[FloorBelowGround]:
    """Find floors that are on no level and lie at most `MAX_GROUND_ERROR` below a given ground.

    Deeper floors belong to a lower storey, which may be left out on purpose. Stairs and ramps that
    lead down to it are not found, either, but only what is large enough for a floor by itself.

    Args:
        regions: all regions.
        is_included: the regions that are on levels as far as their heights allow, shape (regions,),
            bool.
        level_settings: the levels of the configuration, lowest first; empty if they are found.
        settings: the settings of `floors`; `min_area` and `shrink` are used.

    Returns:
        The floor below each ground that has some, lowest ground first.
    """
    floors_below_grounds = []
    range_end_below = -np.inf  # where the range of the level below ends
    for level_setting, height_range in zip(
        level_settings, list_level_height_ranges(level_settings), strict=True
    ):
        gap = HeightRange(
            max(level_setting.ground - MAX_GROUND_ERROR, range_end_below), height_range.low
        )
        surfaces = _list_surfaces_in_range(regions, is_included, gap)
        lowest_z = _find_lowest_large_floor(regions.lattice, settings, gap, surfaces)
        if lowest_z is not None:
            # rounded by less than CONFIGURED_GROUND_TOLERANCE
            lower_ground = max(round(lowest_z, LOWER_GROUND_DECIMALS), range_end_below)
            floor = surfaces.select(surfaces.z >= lower_ground - CONFIGURED_GROUND_TOLERANCE)
            floors_below_grounds.append(
                FloorBelowGround(
                    level_setting.ground, lower_ground, describe_surfaces(regions.lattice, floor)
                )
            )
        range_end_below = height_range.high if level_setting.top is None else level_setting.top
    return floors_below_grounds


def _list_surfaces_in_range(
    regions: Regions, is_included: Bool, height_range: HeightRange
) -> RegionSurfaces:
    """Return the surfaces of some regions in a range of heights, region by region.

    Args:
        regions: all regions.
        is_included: the regions whose surfaces are listed, shape (regions,), bool.
        height_range: the range [low, high) [m]; where low is above high, it is empty.
    """
    reaches_into_range = (
        is_included
        & (regions.lowest_z < height_range.high)
        & (regions.highest_z >= height_range.low)
    )
    surfaces_by_region = [
        surfaces.select((surfaces.z >= height_range.low) & (surfaces.z < height_range.high))
        for surfaces in regions.list_surfaces(np.flatnonzero(reaches_into_range))
    ]
    if not surfaces_by_region:
        return NO_SURFACES
    return RegionSurfaces._make(map(np.concatenate, zip(*surfaces_by_region, strict=True)))


def _find_lowest_large_floor(
    lattice: Lattice, settings: FloorSettings, height_range: HeightRange, surfaces: RegionSurfaces
) -> float | None:
    """Return the height above which the lowest large floor among some surfaces lies [m].

    It is the height of a surface in the lowest slice that is large enough for a floor: what lies
    lower in the slice, such as a tread, has less than `floors.min_area`.

    Args:
        lattice: the lattice of the surfaces' cells.
        settings: the settings of `floors`; `min_area` and `shrink` are used.
        height_range: the range of heights of the surfaces [m].
        surfaces: the surfaces.

    Returns:
        The height; None if no slice is large enough.
    """
    min_cells = max(make_area_test(lattice, settings).min_cells, 1)
    slice_bottoms = np.arange(height_range.low, height_range.high, SLICE_HEIGHT / 2)
    for slice_bottom in slice_bottoms.tolist():
        is_in_slice = (surfaces.z >= slice_bottom) & (surfaces.z < slice_bottom + SLICE_HEIGHT)
        if np.count_nonzero(is_in_slice) < min_cells:
            continue
        is_marked = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
        is_marked[surfaces.cell[is_in_slice]] = True
        if is_large_enough(lattice, settings, is_marked):
            return float(np.partition(surfaces.z[is_in_slice], min_cells - 1)[min_cells - 1])
    return None
