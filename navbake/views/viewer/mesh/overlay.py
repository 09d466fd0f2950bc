"""A level's layer as it lies in the scene: a picture, a pixel a cell, on patches of its floor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.grid import SceneGrid2D
from navbake.types import Float
from navbake.views.viewer.mesh.glb import Primitive, make_glb
from navbake.views.viewer.mesh.patches import Patches, lay_patches
from navbake.views.viewer.mesh.render import write_png

LIFT = 0.012  # by which the grid lies over the floor, so that it is seen [m]
OVERLAP = 0.002  # of a cell, by which patches overlap: none shows through between them
TILE = 4096  # pixels a side that any browser's textures may have


class Carpet(NamedTuple):
    """The floor of a level, on which its layers are laid.

    Attributes:
        level: the level.
        patches: its floor.
        shown: the cells that are drawn, shape (height, width).
    """

    level: SceneGrid2D
    patches: Patches
    shown: NDArray[np.bool_]

    @property
    def lift(self) -> float:
        """How far it lies over the floor [m]."""
        return LIFT + self.patches.flatness


def lay_carpet(level: SceneGrid2D, *, with_holes: bool = True) -> Carpet:
    """The floor of a level.

    Args:
        with_holes: draw nothing where there is no floor; else these cells lie at its ground.
    """
    floor = level.floor.astype(np.float32)
    shown = ~np.isnan(floor)
    if not with_holes:
        floor = np.where(shown, floor, np.float32(level.ground))
        shown = np.ones_like(shown)
    return Carpet(level, lay_patches(floor), shown)


def draw_overlay(carpet: Carpet, rgb: NDArray[np.uint8], opacity: float = 1.0) -> bytes:
    """A layer of a level as GLB.

    Args:
        rgb: a colour for each cell, shape (height, width, 3).
        opacity: above 0, up to 1.
    """
    rgba = np.dstack([rgb, np.where(carpet.shown, 255, 0).astype(np.uint8)])
    primitives: list[Primitive] = []
    pictures: list[bytes] = []
    for rows, cols in _tiles(carpet.level.shape):
        rectangles = _rectangles_in(carpet, rows, cols)
        if not len(rectangles.faces):
            continue
        primitives.append(rectangles._replace(picture=len(pictures), opacity=opacity))
        pictures.append(write_png(rgba[rows, cols]))
    return make_glb(primitives, pictures)


def _tiles(shape: tuple[int, int]) -> Iterator[tuple[slice, slice]]:
    for row in range(0, shape[0], TILE):
        for col in range(0, shape[1], TILE):
            yield slice(row, min(row + TILE, shape[0])), slice(col, min(col + TILE, shape[1]))


def _rectangles_in(carpet: Carpet, rows: slice, cols: slice) -> Primitive:
    """The patches in a tile as rectangles, with their places on the tile's picture."""
    patches, lattice = carpet.patches, carpet.level.lattice
    inside = (patches.rows[:, 0] >= rows.start) & (patches.rows[:, 0] < rows.stop)
    inside &= (patches.cols[:, 0] >= cols.start) & (patches.cols[:, 0] < cols.stop)
    row, col = (ends[inside] + [-OVERLAP, OVERLAP] for ends in (patches.rows, patches.cols))
    row, col = row[:, [1, 1, 0, 0]], col[:, [0, 1, 1, 0]]  # counter-clockwise from above
    x: Float = lattice.x_min + col * lattice.cell_size
    y: Float = lattice.y_max - row * lattice.cell_size
    z = np.broadcast_to(patches.z[inside][:, None] + carpet.lift, x.shape)
    u = (col - cols.start) / (cols.stop - cols.start)
    v = (row - rows.start) / (rows.stop - rows.start)
    first = (np.arange(len(row), dtype=np.uint32) * np.uint32(4))[:, None, None]
    faces = (np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32) + first).reshape(-1, 3)
    return Primitive(
        np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32),
        faces,
        uv=np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32),
        is_cut_out=True,
    )
