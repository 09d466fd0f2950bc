"""Pictures of flights: the voxels from above, cut open, and a section along the path."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.errors import MissingDependencyError
from navbake.navgrid.colors import ROUTE
from navbake.types import Float
from navbake.views.plot import (
    DPI,
    HEADING_POINTS,
    MAX_WIDTH,
    MIN_WIDTH,
    TEXT_COLOR,
    TICK_POINTS,
    TITLE_POINTS,
    choose_fonts,
    style_axes,
    wrap_text,
)
from navbake.voxels.finder import FlightPath
from navbake.voxels.grid import VoxelGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

# lengths [inches]
MARGIN = 0.55  # at the left of both maps, for their heights
GAP = 0.75  # between the maps, for an axis and a title
BOTTOM = 0.5  # below the lower map, for its axis
HEADING_HEIGHT = 0.6
MAX_MAP_HEIGHT = 5.6
POINTS_PER_INCH = 72.0
TUBE_ALPHA = 0.35
SECTION_GRAY = 90  # of occupied voxels in the section


def draw_flight(voxels: VoxelGrid, flight: FlightPath, title: str = "") -> bytes:
    """Draw a flight as PNG: from above, and below that as a section along the path.

    From above, the voxels are cut open over the path's highest point: the colour shows the topmost
    voxel below the cut, the higher, the lighter. In the section, the path is rolled out: to the
    right runs the distance from the start, up runs z. Both have the same scale. The tube is what
    the ball sweeps; it leads from the dot to the cross.

    Args:
        voxels: the voxels.
        flight: the path through them.
        title: what the heading begins with, such as the scene's id.

    Returns:
        The picture, as PNG.

    Raises:
        MissingDependencyError: matplotlib is not installed.

    Example:
        >>> with open("flight.png", "wb") as file:
        ...     file.write(draw_flight(voxels, path, "house"))
    """
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        message = 'plots need matplotlib: pip install "navbake[plot]"'
        raise MissingDependencyError(message) from error
    (x_min, y_min, z_min), (x_max, y_max, z_max) = voxels.bounds.tolist()
    section_length = max(flight.length, voxels.res)
    widest = max(x_max - x_min, section_length)
    tallest = max(y_max - y_min, z_max - z_min)
    # inches for a metre, in both maps
    scale = min((MAX_WIDTH - 2.0 * MARGIN) / widest, MAX_MAP_HEIGHT / tallest)
    plan_height = (y_max - y_min) * scale
    section_height = (z_max - z_min) * scale
    width = max(2.0 * MARGIN + widest * scale, MIN_WIDTH)
    height = HEADING_HEIGHT + plan_height + GAP + section_height + BOTTOM
    heading = f"{flight.length:.2f} m, radius {flight.radius:g} m"
    heading = wrap_text(f"{title}: {heading}" if title else heading, width)
    font_families, _ = choose_fonts(heading)
    with rc_context({"font.family": font_families, "text.parse_math": False}):
        figure = Figure(figsize=(width, height), facecolor="white", dpi=DPI)
        FigureCanvasAgg(figure)
        figure.text(
            0.01, 1.0 - 0.1 / height, heading, va="top", fontsize=HEADING_POINTS,
            fontweight="bold", color=TEXT_COLOR,
        )  # fmt: skip

        def add_map(bottom: float, map_width: float, map_height: float) -> Axes:
            """Add a map; `map_width` is in metres, the others in inches."""
            place = (
                MARGIN / width,
                bottom / height,
                map_width * scale / width,
                map_height / height,
            )
            return figure.add_axes(place)

        plan = add_map(BOTTOM + section_height + GAP, x_max - x_min, plan_height)
        plan.set_title("from above, cut over the path", fontsize=TITLE_POINTS, loc="left")
        _draw_map(plan, _shade_plan(voxels, flight), (x_min, x_max, y_min, y_max), ("x", "y"))
        _draw_tube(plan, flight.positions[:, :2], flight.radius * scale)
        section = add_map(BOTTOM, section_length, section_height)
        section.set_title("along the path", fontsize=TITLE_POINTS, loc="left")
        extent = (0.0, section_length, z_min, z_max)
        _draw_map(section, _shade_section(voxels, flight), extent, ("distance", "z"))
        lengths = np.linalg.norm(np.diff(flight.positions, axis=0), axis=1)
        distances = np.append(0.0, np.cumsum(lengths))
        rolled_out = np.stack([distances, flight.positions[:, 2]], axis=1)
        _draw_tube(section, rolled_out, flight.radius * scale)
        picture_file = io.BytesIO()
        figure.savefig(picture_file, format="png", metadata={"Software": None})
    return picture_file.getvalue()


def _shade_plan(voxels: VoxelGrid, flight: FlightPath) -> NDArray[np.uint8]:
    """Shade the voxels below the path's highest point from above: grey values, shape (nx, ny)."""
    cut_height = float(flight.positions[:, 2].max()) + flight.radius
    num_layers = math.ceil((cut_height - voxels.bounds[0, 2]) / voxels.res)
    occupied = voxels.occupied[:, :, : max(num_layers, 1)]
    top_layers = occupied.shape[2] - np.argmax(occupied[:, :, ::-1], axis=2)
    shades = 60 + 150 * top_layers // occupied.shape[2]
    return np.where(occupied.any(axis=2), shades, 255).astype(np.uint8)


def _shade_section(voxels: VoxelGrid, flight: FlightPath) -> NDArray[np.uint8]:
    """Shade the voxels under and over the path along its length: grey values, shape (n, nz)."""
    count = max(math.ceil(flight.length / voxels.res), 1)
    distances = (np.arange(count) + 0.5) * max(flight.length, voxels.res) / count
    columns = voxels.indices(flight.at(distances))
    is_occupied = voxels.occupied[columns[:, 0], columns[:, 1]]
    return np.where(is_occupied, SECTION_GRAY, 255).astype(np.uint8)


def _draw_map(
    ax: Axes,
    shades: NDArray[np.uint8],
    extent: tuple[float, float, float, float],
    axis_names: tuple[str, str],
) -> None:
    """Draw grey values with axes in metres.

    Args:
        ax: the axes.
        shades: grey values, to the right and upwards.
        extent: where they are: left, right, bottom and top [m].
        axis_names: the names of both axes.
    """
    ax.imshow(
        shades.T, cmap="gray", vmin=0, vmax=255, origin="lower", extent=extent, aspect="auto",
        interpolation="nearest",
    )  # fmt: skip
    ax.set_xlabel(f"{axis_names[0]} [m]", fontsize=TICK_POINTS, color=TEXT_COLOR, labelpad=1)
    ax.set_ylabel(f"{axis_names[1]} [m]", fontsize=TICK_POINTS, color=TEXT_COLOR, labelpad=1)
    style_axes(ax)


def _draw_tube(ax: Axes, points: Float, radius: float) -> None:
    """Draw a path with what the ball sweeps, from a dot to a cross.

    Args:
        ax: the axes.
        points: the path on the map [m], shape (n, 2).
        radius: radius of the ball on the picture [inches].
    """
    x, y = points.T
    ax.plot(
        x, y, color=ROUTE, alpha=TUBE_ALPHA, linewidth=2.0 * radius * POINTS_PER_INCH,
        solid_capstyle="round", solid_joinstyle="round",
    )  # fmt: skip
    ax.plot(x, y, color=ROUTE, linewidth=1.5)
    for end_index, marker in ((0, "o"), (-1, "X")):
        ax.plot(
            x[end_index], y[end_index], marker, clip_on=False, color=ROUTE,
            markeredgecolor="white", markersize=8,
        )  # fmt: skip
