"""Pictures of flights: the voxels from above, cut open, and a section along the path."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from navbake.types import Float
from navbake.views.notebook import PICTURE_SIDE, encode_png
from navbake.voxels.finder import FlightPath
from navbake.voxels.grid import VoxelGrid

GAP = 12  # between the two pictures [pixels]
TUBE_COLOR = (230, 90, 30, 110)  # of what the ball sweeps, over the voxels
LINE_COLOR = (180, 40, 0, 255)
START_COLOR = (0, 120, 60, 255)
SECTION_GRAY = 90  # of occupied voxels in the section


def draw_flight(voxels: VoxelGrid, flight: FlightPath) -> bytes:
    """Draw a flight as PNG: from above, and below that as a section along the path.

    From above, the voxels are cut open over the path's highest point: the colour shows the topmost
    voxel below the cut, the higher, the lighter. In the section, the path is rolled out: to the
    right runs the distance from the start, up runs z. The tube is what the ball sweeps.

    Args:
        voxels: the voxels.
        flight: the path through them.
    """
    plan = _draw_plan(voxels, flight)
    section = _draw_section(voxels, flight)
    size = (max(plan.width, section.width), plan.height + GAP + section.height)
    sheet = Image.new("RGB", size, "white")
    sheet.paste(plan, (0, 0))
    sheet.paste(section, (0, plan.height + GAP))
    return encode_png(sheet)


def _draw_plan(voxels: VoxelGrid, flight: FlightPath) -> Image.Image:
    """Draw the voxels below the path's highest point from above, with the path."""
    lower = voxels.bounds[0]
    cut_height = float(flight.positions[:, 2].max()) + flight.radius
    num_layers = math.ceil((cut_height - lower[2]) / voxels.res)
    occupied = voxels.occupied[:, :, : max(num_layers, 1)]
    top_layers = occupied.shape[2] - np.argmax(occupied[:, :, ::-1], axis=2)
    shades = 60 + 150 * top_layers // occupied.shape[2]
    shades = np.where(occupied.any(axis=2), shades, 255).astype(np.uint8)
    in_voxels = (flight.positions - lower) / voxels.res
    return _draw_tube(shades, in_voxels[:, :2], flight.radius / voxels.res)


def _draw_section(voxels: VoxelGrid, flight: FlightPath) -> Image.Image:
    """Draw the voxels under, over and in front of the path, rolled out along its length."""
    count = max(math.ceil(flight.length / voxels.res), 1)
    distances = (np.arange(count) + 0.5) * voxels.res
    columns = voxels.indices(flight.at(distances))
    is_occupied = voxels.occupied[columns[:, 0], columns[:, 1]]
    shades = np.where(is_occupied, SECTION_GRAY, 255).astype(np.uint8)
    lengths = np.linalg.norm(np.diff(flight.positions, axis=0), axis=1)
    point_distances = np.append(0.0, np.cumsum(lengths))
    heights = flight.positions[:, 2] - voxels.bounds[0, 2]
    in_voxels = np.stack([point_distances, heights], axis=1) / voxels.res
    return _draw_tube(shades, in_voxels, flight.radius / voxels.res)


def _draw_tube(shades: NDArray[np.uint8], points: Float, radius: float) -> Image.Image:
    """Draw a tube over an array of grey values.

    Args:
        shades: grey values by voxel, to the right and upwards.
        points: the middle of the tube, shape (n, 2), in voxels.
        radius: its radius, in voxels.
    """
    scale = max(PICTURE_SIDE // max(shades.shape), 1)
    size = (shades.shape[0] * scale, shades.shape[1] * scale)
    background = Image.fromarray(shades.T[::-1]).resize(size, Image.Resampling.NEAREST)
    picture = background.convert("RGBA")
    pixels = [(x * scale, size[1] - y * scale) for x, y in points.tolist()]
    half_width = radius * scale
    overlay = Image.new("RGBA", size, (0, 0, 0, 0))
    pen = ImageDraw.Draw(overlay)
    pen.line(pixels, fill=TUBE_COLOR, width=max(round(2 * half_width), 1), joint="curve")
    for x, y in (pixels[0], pixels[-1]):
        pen.ellipse((x - half_width, y - half_width, x + half_width, y + half_width), TUBE_COLOR)
    pen.line(pixels, fill=LINE_COLOR, width=2)
    x, y = pixels[0]
    pen.ellipse((x - 4, y - 4, x + 4, y + 4), START_COLOR)
    picture.alpha_composite(overlay)
    return picture.convert("RGB")
