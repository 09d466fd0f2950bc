"""Reads voxel files (OctoMap, binvox) as a grid of one level: the floor plan between two heights.

As in ``octomap_server``, which projects a tree onto a map, a column of voxels is occupied if a
voxel between the heights is, else free if one is known to be free, else unknown.
"""

from __future__ import annotations

import logging
import math
from os import PathLike

import numpy as np

from navbake.errors import FormatError
from navbake.files import readable_stem
from navbake.formats.occupancy import FREE, OCCUPIED, UNKNOWN, level_from_values
from navbake.formats.source import format_convert_command
from navbake.formats.voxels import read_voxels
from navbake.known_names import check_choice
from navbake.navgrid.grid import SceneGrid2D
from navbake.voxels.floor_plan import cut_band, lattice_of
from navbake.voxels.grid import VoxelGrid

LOG = logging.getLogger("navbake")
UNKNOWN_VALUES = {"free": FREE, "occupied": OCCUPIED, "unknown": UNKNOWN}


def read_voxel_plan(
    path: str | PathLike[str],
    *,
    height: tuple[float, float] | None = None,
    unknown: str = "unknown",
) -> SceneGrid2D:
    """Read a voxel file as a grid of one level: its floor plan between two heights.

    Args:
        path: the file, which ends in ``.bt``, ``.ot`` or ``.binvox``.
        height: the lower and the upper end of the heights that an agent needs free, world z [m];
            the lower one is the height of the grid's floor. It has no default.
        unknown: the state of columns about which nothing is known between the heights: ``free``,
            ``occupied`` or ``unknown`` (without a floor).

    Returns:
        The level, whose cells are the columns of the voxels.

    Raises:
        FormatError: the file is broken or needs too much memory, no heights are given, no voxel
            lies between them, or `unknown` is another word.
        QueryError: the range of heights is empty.
    """
    if height is None:
        expected = "the heights that an agent needs free, LOW:HIGH [m], world z"
        hint = f"`{format_convert_command(path)} --height 0.1:1.2` makes one"
        raise FormatError(
            f"expected {expected} to make a grid of the voxels of {path}: {hint}",
            path=str(path),
            key="height",
            expected=expected,
            hint=hint,
        )
    check_choice(unknown, UNKNOWN_VALUES, "unknown", FormatError)
    low_z, high_z = height
    voxels = read_voxels(path)
    bottom_z = float(voxels.origin[2])
    top_z = bottom_z + voxels.shape[2] * voxels.res
    if math.isinf(low_z) or low_z >= top_z or high_z <= bottom_z:
        expected = f"heights in those of the voxels, {bottom_z:.6g} to {top_z:.6g} m"
        raise FormatError(
            f"expected {expected}, got {low_z:g} to {high_z:g} (--height LOW:HIGH)",
            path=str(path),
            key="height",
            value=height,
            expected=expected,
        )
    is_occupied = cut_band(voxels, low_z, high_z) != 0
    is_known_voxel = np.ones(voxels.shape, dtype=bool) if voxels.known is None else voxels.known
    known_voxels = VoxelGrid(values=is_known_voxel, origin=voxels.origin, res=voxels.res)
    is_known = cut_band(known_voxels, low_z, high_z) != 0
    values = np.where(is_known, FREE, UNKNOWN_VALUES[unknown])
    values = np.where(is_occupied, OCCUPIED, values).astype(np.int8)
    if not (values == FREE).any():
        unknown_share = float(np.mean(~is_known & ~is_occupied))
        LOG.warning(
            "no cell of %s is free from %g to %g m: %.0f %% of the columns are unknown%s",
            path,
            low_z,
            high_z,
            100.0 * unknown_share,
            "; `--unknown free` takes them for free, or write the voxels with `voxelize --free`"
            if unknown_share
            else "",
        )
    metadata = {"sceneId": readable_stem(path)}
    return level_from_values(values, lattice_of(voxels), low_z, metadata)
