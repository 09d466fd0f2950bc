"""Pictures of a grid: occupancy and floor height of each level, in world metres."""

from __future__ import annotations

import io
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import MissingDependencyError, NavbakeError, QueryError
from navbake.files import write_whole
from navbake.info import level_name

if TYPE_CHECKING:
    from navbake.grid import MultiLevelGrid, SceneGrid2D

FREE, OCCUPIED, NO_FLOOR = "#f7f3e8", "#3b4252", "#b9c0cc"
COLOR_MAP = "viridis"
MIN_RANGE = 0.1  # metres of height that the colours span at least, so that flat floors look flat
DPI = 150
PANEL_INCHES = 6.0  # longer side of a panel
MIN_PANEL_INCHES = 3.0  # shorter side of one
MAX_FIGURE_INCHES = 300.0  # Agg draws at most 65,536 pixels a side


def plot_grid(
    grid: SceneGrid2D | MultiLevelGrid, path: str | PathLike[str], *, level: int | None = None
) -> Path:
    """Draw a grid's levels, one a row, the lowest on top, and write the picture as PNG.

    Args:
        grid: a grid of one or several levels.
        path: the file to write; it is replaced whole or not at all.
        level: draw only this one, 0 is the lowest.

    Returns:
        The path that was written.

    Raises:
        QueryError: there is no such level.
        MissingDependencyError: matplotlib is not installed.
        NavbakeError: the file cannot be written.
    """
    path = Path(path)
    content = render_png(grid, level=level)
    try:
        write_whole(content, path)
    except OSError as error:
        raise NavbakeError(f"cannot write {path}: {error.strerror}") from error
    return path


def render_png(grid: SceneGrid2D | MultiLevelGrid, *, level: int | None = None) -> bytes:
    """Draw a grid's levels as `plot_grid` does; the same grid gives the same bytes.

    Returns:
        The content of a PNG file.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependencyError(
            'plots need matplotlib: pip install "navbake[plot]"'
        ) from error

    chosen = _choose_levels(grid, level)
    x_min, y_min, x_max, y_max = _union_bounds([grid.levels[i] for i in chosen])
    figure = Figure(
        figsize=_figure_size(x_max - x_min, y_max - y_min, len(chosen)),
        dpi=DPI,
        layout="constrained",
    )
    axes = figure.subplots(len(chosen), 2, squeeze=False)
    for row, index in zip(axes, chosen, strict=True):
        _draw_level(figure, row, grid.levels[index], level_name(grid, index))
        for ax in row:
            ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), xlabel="x [m]", ylabel="y [m]")
    cell_size = grid.levels[0].lattice.cell_size
    figure.suptitle(f"{grid.scene_id or 'grid'}, cells of {cell_size:g} m", parse_math=False)
    _draw_legend(figure)

    content = io.BytesIO()
    figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()


def _choose_levels(grid: SceneGrid2D | MultiLevelGrid, level: int | None) -> list[int]:
    num_levels = len(grid.levels)
    if level is None:
        return list(range(num_levels))
    if not 0 <= level < num_levels:
        raise QueryError(f"expected a level from 0 to {num_levels - 1}, got {level}")
    return [level]


def _union_bounds(levels: Sequence[SceneGrid2D]) -> tuple[float, float, float, float]:
    """Bounds of all levels, so that one lies over the other in the picture."""
    bounds = np.array([level.lattice.bounds for level in levels])
    x_min, y_min = bounds[:, :2].min(axis=0).tolist()
    x_max, y_max = bounds[:, 2:].max(axis=0).tolist()
    return x_min, y_min, x_max, y_max


def _figure_size(width: float, height: float, num_levels: int) -> tuple[float, float]:
    scale = PANEL_INCHES / max(width, height)
    panel_width = max(width * scale, MIN_PANEL_INCHES) + 0.9  # inches for labels
    panel_height = max(height * scale, MIN_PANEL_INCHES) + 0.8
    total = panel_height * num_levels + 0.8
    return 2 * panel_width + 0.8, min(total, MAX_FIGURE_INCHES)


def _draw_level(figure: Any, axes: Sequence[Any], level: SceneGrid2D, name: str) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    x_min, y_min, x_max, y_max = level.lattice.bounds
    extent = (x_min, x_max, y_min, y_max)  # row 0, the top one, has the largest y
    free_area = np.count_nonzero(level.free) * level.lattice.cell_size**2
    floor = level.floor_height * np.float32(level.unit)
    colors = ScalarMappable(Normalize(*_height_range(floor)), COLOR_MAP)

    axes[0].imshow(_color_occupancy(level), extent=extent)
    axes[0].set_title(
        f"{name}: ground {level.ground:.2f} m, free {free_area:.1f} m\N{SUPERSCRIPT TWO}",
        fontsize="medium",
        parse_math=False,
    )
    axes[1].imshow(_color_floor(floor, colors), extent=extent)
    axes[1].set_title("floor height", fontsize="medium")
    figure.colorbar(colors, ax=axes[1], label="z [m]")


def _color_occupancy(level: SceneGrid2D) -> NDArray[np.uint8]:
    """Colours of the cells by whether an agent can stand in them, shape (height, width, 3)."""
    palette = np.array([_rgb(OCCUPIED), _rgb(FREE), _rgb(NO_FLOOR)], dtype=np.uint8)
    kind = np.where(level.free, 1, np.where(np.isnan(level.floor_height), 2, 0))
    return palette[kind]


def _color_floor(floor: NDArray[np.float32], colors: Any) -> NDArray[np.uint8]:
    rgb: NDArray[np.uint8] = colors.to_rgba(np.nan_to_num(floor), bytes=True)[..., :3]
    rgb[np.isnan(floor)] = _rgb(NO_FLOOR)
    return rgb


def _height_range(floor: NDArray[np.float32]) -> tuple[float, float]:
    heights = floor[np.isfinite(floor)]
    if not heights.size:
        return 0.0, MIN_RANGE
    low, high = float(heights.min()), float(heights.max())
    widen = max(0.0, MIN_RANGE - (high - low)) / 2
    return low - widen, high + widen


def _draw_legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    kinds = (("free", FREE), ("occupied", OCCUPIED), ("no floor", NO_FLOOR))
    patches = [Patch(facecolor=color, edgecolor="black", label=kind) for kind, color in kinds]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches))


def _rgb(color: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue
