"""Draws small pictures of a grid with Pillow, for notebooks and for pages of many grids."""

from __future__ import annotations

import html
import io
import math
from base64 import b64encode

import numpy as np
from PIL import Image, ImageDraw

from navbake.errors import count_of, printable
from navbake.navgrid.colors import ROUTE
from navbake.navgrid.grid import NavGrid
from navbake.runtime.paths import Path
from navbake.views.layers import paint_rooms
from navbake.voxels.grid import VoxelGrid

PICTURE_SIDE = 800  # longest side of the picture of all levels [pixels]
LEVEL_SIDE = 400  # longest side of a level's picture in HTML [pixels]
MAX_LEVELS = 16  # most levels that are drawn; the summary counts all levels
MAX_NAME_LENGTH = 60  # letters of a scene's or a level's name that are shown
THUMBNAIL_SIDE = 240  # longest side of a thumbnail [pixels]
# largest number of colours in a thumbnail; with a palette, a pixel takes one byte, not three
THUMBNAIL_COLORS = 64


def render_html(grid: NavGrid) -> str:
    """Make the HTML that notebooks show for a grid: a line of facts, then a picture of each level.

    The lowest level comes first. Colours are those of `paint_rooms`. The HTML contains the
    pictures; their longer side has at most `LEVEL_SIDE` pixels. Names are escaped. The same grid
    gives the same text.
    """
    pixel_scale = _scale_for(grid, LEVEL_SIDE)
    room_counts = [
        int(np.count_nonzero(np.bincount(level.room_index.ravel())[1:])) for level in grid.levels
    ]
    free_areas = [
        np.count_nonzero(level.free) * level.lattice.cell_size**2 for level in grid.levels
    ]
    figures = []
    for level_number, level in enumerate(grid.levels[:MAX_LEVELS]):
        picture_base64 = b64encode(encode_png(_draw_level(grid, level_number, pixel_scale))).decode(
            "ascii"
        )
        name = _shorten_name(grid.level_names[level_number])
        figures.append(
            f'<figure style="margin:0"><img style="image-rendering:pixelated" alt="{name}" '
            f'src="data:image/png;base64,{picture_base64}"><figcaption><b>{name}</b>: '
            f"{level.width} × {level.height} cells, ground {level.ground:.2f} m, "
            f"{count_of(room_counts[level_number], 'room')}, {free_areas[level_number]:.1f} m² free"
            "</figcaption></figure>"
        )
    num_levels = len(grid.levels)
    if num_levels > MAX_LEVELS:
        figures.append(f"and {num_levels - MAX_LEVELS} more")
    summary = (
        f"{count_of(num_levels, 'level')}, cells of {grid.levels[0].lattice.cell_size:g} m, "
        f"{count_of(sum(room_counts), 'room')}, {sum(free_areas):.1f} m² free, "
        f"agent {grid.agent_height:g} m high, {grid.describe_radius()}"
    )
    return (
        f"<div><b>{_shorten_name(grid.scene_id or type(grid).__name__)}</b>: {summary}"
        '<div style="display:flex;flex-wrap:wrap;gap:8px;margin-top:4px">'
        f"{''.join(figures)}</div></div>"
    )


def draw_png(grid: NavGrid) -> bytes:
    """Draw all levels as one PNG, lowest first, at most `PICTURE_SIDE` pixels wide and high."""
    return encode_png(draw_levels(grid, PICTURE_SIDE))


def draw_voxels(grid: VoxelGrid) -> bytes:
    """Draw voxels from above as PNG.

    At each x, y, the colour shows the topmost occupied voxel: the higher, the lighter. Where all
    voxels are empty, it is white.
    """
    is_filled = grid.occupied
    num_z = grid.shape[2]
    top_heights = num_z - np.argmax(is_filled[:, :, ::-1], axis=2)
    gray_values = np.where(is_filled.any(axis=2), 40 + 170 * top_heights // num_z, 255).astype(
        np.uint8
    )
    longest_side = max(gray_values.shape)
    image = Image.fromarray(gray_values.T[::-1]).reduce(-(-longest_side // PICTURE_SIDE))
    pixels_per_voxel = max(PICTURE_SIDE // longest_side, 1)
    picture_size = (image.width * pixels_per_voxel, image.height * pixels_per_voxel)
    return encode_png(image.resize(picture_size, Image.Resampling.NEAREST))


def draw_path(path: Path) -> bytes | None:
    """Draw a path on its grid as PNG; None for a path without a grid."""
    if path.grid is None:
        return None
    return encode_png(draw_levels(path.grid, PICTURE_SIDE, path))


def draw_thumbnail(grid: NavGrid) -> bytes:
    """Draw a small picture of the levels as PNG, in at most `THUMBNAIL_COLORS` colours.

    Equal grids give equal bytes.
    """
    image = draw_levels(grid, THUMBNAIL_SIDE)
    if image.getcolors(THUMBNAIL_COLORS) is None:
        image = image.quantize(
            THUMBNAIL_COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
        )
    return encode_png(image)


def draw_levels(grid: NavGrid, max_side: int, path: Path | None = None) -> Image.Image:
    """Draw all levels as one picture: in rows from the upper left, the lowest level first.

    Args:
        grid: a grid of one or several levels.
        max_side: the longest side of the picture [pixels].
        path: a path to draw, with a dot at its start; None for none.
    """
    num_drawn_levels = min(len(grid.levels), MAX_LEVELS)
    num_columns = math.ceil(math.sqrt(num_drawn_levels))
    # a gap of one hundredth between levels
    gap = max(max_side // 100, 1) if num_drawn_levels > 1 else 0
    pixel_scale = _scale_for(grid, (max_side - (num_columns - 1) * gap) // num_columns)
    level_images = [
        _draw_level(grid, level_number, pixel_scale, path)
        for level_number in range(num_drawn_levels)
    ]
    tile_width = max(level_image.width for level_image in level_images) + gap
    tile_height = max(level_image.height for level_image in level_images) + gap
    sheet_size = (
        num_columns * tile_width - gap,
        math.ceil(num_drawn_levels / num_columns) * tile_height - gap,
    )
    sheet_image = Image.new("RGB", sheet_size, "white")  # no colour of a cell
    for level_number, level_image in enumerate(level_images):
        sheet_image.paste(
            level_image,
            (level_number % num_columns * tile_width, level_number // num_columns * tile_height),
        )
    return sheet_image


def encode_png(image: Image.Image) -> bytes:
    """Encode a picture as PNG; with at most 256 colours, it is stored as indices into a palette."""
    if image.mode == "RGB" and image.getcolors(256) is not None:
        image = image.convert("P", palette=Image.Palette.ADAPTIVE, colors=256)
    png_file = io.BytesIO()
    image.save(png_file, format="PNG", optimize=True)
    return png_file.getvalue()


def _scale_for(grid: NavGrid, max_side: int) -> tuple[int, int]:
    """Choose one scale for the pictures of all levels, so that these can be compared.

    Args:
        grid: a grid of one or several levels.
        max_side: the longest side of a level's picture [pixels].

    Returns:
        How many pixels one cell takes along x and y, and how many cells one pixel shows. One of the
        numbers is 1; whole numbers keep all cells square and of the same size.
    """
    longest_side = max(max(level.shape) for level in grid.levels)
    return max(max_side // longest_side, 1), -(-longest_side // max_side)


def _draw_level(
    grid: NavGrid, level_number: int, pixel_scale: tuple[int, int], path: Path | None = None
) -> Image.Image:
    """Draw a level, and the part of a path that is on it.

    Args:
        grid: a grid of one or several levels.
        level_number: the number of the level.
        pixel_scale: how many pixels one cell takes, and how many cells one pixel shows; one of
            them is 1. A pixel that shows several cells has their mean colour.
        path: the path; None for none.
    """
    pixels_per_cell, cells_per_pixel = pixel_scale
    lattice = grid.levels[level_number].lattice
    image = Image.fromarray(paint_rooms(grid, level_number)).reduce(cells_per_pixel)
    picture_size = (image.width * pixels_per_cell, image.height * pixels_per_cell)
    image = image.resize(picture_size, Image.Resampling.NEAREST)
    if path is None:
        return image
    upper_left = np.array([lattice.x_min, lattice.y_max])
    drawing = ImageDraw.Draw(image)
    picture_shares = (path.positions[:, :2] - upper_left) / (
        lattice.cell_size * np.array(lattice.shape[::-1])
    )
    path_pixels = (picture_shares * (image.width, -image.height)).tolist()
    for color, width in (("white", 5), (ROUTE, 3)):
        for k in range(len(path_pixels) - 1):
            if path.levels[k] == path.levels[k + 1] == level_number:
                drawing.line([*path_pixels[k], *path_pixels[k + 1]], fill=color, width=width)
    if path.levels[0] == level_number:
        drawing.circle(path_pixels[0], 5, fill=ROUTE, outline="white")
    return image


def _shorten_name(name: str) -> str:
    """Escape a name for HTML, and cut it to at most `MAX_NAME_LENGTH` letters."""
    if len(name) > MAX_NAME_LENGTH:
        name = f"{name[: MAX_NAME_LENGTH - 1]}…"
    return html.escape(printable(name))
