"""Small pictures of a grid, for notebooks and for pages of many grids; Pillow draws them."""

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
MAX_LEVELS = 16  # that are shown; the summary counts them all
MAX_NAME = 60  # letters of a scene's or a level's name
THUMBNAIL_SIDE = 240  # longest side of a thumbnail [pixels]
THUMBNAIL_COLORS = 64  # of which each pixel has one: a byte a pixel, a third of true colours


def show_html(grid: NavGrid) -> str:
    """Make the HTML that notebooks show for a grid: a line of facts, then a picture of each level.

    Colours are those of `paint_rooms`. The HTML holds the pictures, at most `LEVEL_SIDE` pixels
    long, lowest level first; names are escaped. The same grid gives the same text.
    """
    scale = _scale_for(grid, LEVEL_SIDE)
    num_rooms = [
        int(np.count_nonzero(np.bincount(level.room_index.ravel())[1:])) for level in grid.levels
    ]
    areas = [np.count_nonzero(level.free) * level.lattice.cell_size**2 for level in grid.levels]
    figures = []
    for number, level in enumerate(grid.levels[:MAX_LEVELS]):
        picture = b64encode(encode_png(_draw_level(grid, number, scale))).decode("ascii")
        name = _short(grid.level_names[number])
        figures.append(
            f'<figure style="margin:0"><img style="image-rendering:pixelated" alt="{name}" '
            f'src="data:image/png;base64,{picture}"><figcaption><b>{name}</b>: '
            f"{level.width} × {level.height} cells, ground {level.ground:.2f} m, "
            f"{count_of(num_rooms[number], 'room')}, {areas[number]:.1f} m² free"
            "</figcaption></figure>"
        )
    count = len(grid.levels)
    if count > MAX_LEVELS:
        figures.append(f"and {count - MAX_LEVELS} more")
    summary = (
        f"{count_of(count, 'level')}, cells of {grid.levels[0].lattice.cell_size:g} m, "
        f"{count_of(sum(num_rooms), 'room')}, {sum(areas):.1f} m² free, "
        f"agent of {grid.agent_radius:g} m radius, {grid.agent_height:g} m high"
    )
    return (
        f"<div><b>{_short(grid.scene_id or type(grid).__name__)}</b>: {summary}"
        '<div style="display:flex;flex-wrap:wrap;gap:8px;margin-top:4px">'
        f"{''.join(figures)}</div></div>"
    )


def draw_png(grid: NavGrid) -> bytes:
    """Draw all levels as one PNG, lowest first, at most `PICTURE_SIDE` pixels wide and high."""
    return encode_png(draw_levels(grid, PICTURE_SIDE))


def draw_voxels(grid: VoxelGrid) -> bytes:
    """Draw voxels from above as PNG: a column is the lighter the higher its top, white if empty."""
    filled = grid.occupied
    num_z = grid.shape[2]
    top = num_z - np.argmax(filled[:, :, ::-1], axis=2)
    shade = np.where(filled.any(axis=2), 40 + 170 * top // num_z, 255).astype(np.uint8)
    longest = max(shade.shape)
    image = Image.fromarray(shade.T[::-1]).reduce(-(-longest // PICTURE_SIDE))
    pixels = max(PICTURE_SIDE // longest, 1)
    size = (image.width * pixels, image.height * pixels)
    return encode_png(image.resize(size, Image.Resampling.NEAREST))


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


def draw_levels(grid: NavGrid, side: int, path: Path | None = None) -> Image.Image:
    """Draw all levels as one picture, row by row from the lowest.

    Args:
        grid: a grid of one or several levels.
        side: the longest side of the picture [pixels].
        path: a path to draw, with a dot at its start; None for none.
    """
    count = min(len(grid.levels), MAX_LEVELS)
    columns = math.ceil(math.sqrt(count))
    # a gap of one hundredth between levels
    gap = max(side // 100, 1) if count > 1 else 0
    scale = _scale_for(grid, (side - (columns - 1) * gap) // columns)
    levels = [_draw_level(grid, number, scale, path) for number in range(count)]
    width = max(level.width for level in levels) + gap
    height = max(level.height for level in levels) + gap
    size = (columns * width - gap, math.ceil(count / columns) * height - gap)
    sheet = Image.new("RGB", size, "white")  # no colour of a cell
    for number, level in enumerate(levels):
        sheet.paste(level, (number % columns * width, number // columns * height))
    return sheet


def encode_png(image: Image.Image) -> bytes:
    """Encode a picture as PNG; one of at most 256 colours takes one byte per pixel."""
    if image.mode == "RGB" and image.getcolors(256) is not None:
        image = image.convert("P", palette=Image.Palette.ADAPTIVE, colors=256)
    content = io.BytesIO()
    image.save(content, format="PNG", optimize=True)
    return content.getvalue()


def _scale_for(grid: NavGrid, side: int) -> tuple[int, int]:
    """How many pixels a cell takes, and how many cells a pixel; one of them is 1.

    Whole numbers keep cells square and alike. One scale for all levels keeps them comparable.
    """
    longest = max(max(level.shape) for level in grid.levels)
    return max(side // longest, 1), -(-longest // side)


def _draw_level(
    grid: NavGrid, number: int, scale: tuple[int, int], path: Path | None = None
) -> Image.Image:
    """Draw a level and its part of a path; a pixel of several cells has their mean colour."""
    size = scale[0]
    lattice = grid.levels[number].lattice
    image = Image.fromarray(paint_rooms(grid, number)).reduce(scale[1])
    image = image.resize((image.width * size, image.height * size), Image.Resampling.NEAREST)
    if path is None:
        return image
    corner = np.array([lattice.x_min, lattice.y_max])
    pencil = ImageDraw.Draw(image)
    shares = (path.positions[:, :2] - corner) / (lattice.cell_size * np.array(lattice.shape[::-1]))
    pixels = (shares * (image.width, -image.height)).tolist()
    for color, width in (("white", 5), (ROUTE, 3)):
        for k in range(len(pixels) - 1):
            if path.levels[k] == path.levels[k + 1] == number:
                pencil.line([*pixels[k], *pixels[k + 1]], fill=color, width=width)
    if path.levels[0] == number:
        pencil.circle(pixels[0], 5, fill=ROUTE, outline="white")
    return image


def _short(name: str) -> str:
    """A name as HTML, cut where it is long."""
    cut = name if len(name) <= MAX_NAME else f"{name[: MAX_NAME - 1]}…"
    return html.escape(printable(cut))
