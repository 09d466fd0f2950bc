"""Selects the levels of a grid that are written to files, and names the file of each level."""

from __future__ import annotations

from typing import TYPE_CHECKING

from navbake.errors import FormatError

if TYPE_CHECKING:
    from pathlib import Path

    from navbake.navgrid.grid import NavGrid


def select_levels(
    grid: NavGrid, path: Path, level: int | None, endings: tuple[str, ...]
) -> list[int]:
    """Return the numbers of the levels to write: all of them, or a single one.

    Args:
        grid: the grid.
        path: the file that is to be written.
        level: the number of the only level to write, None for all.
        endings: the endings that the path may have, in lower case.

    Returns:
        The levels' numbers, ascending.

    Raises:
        FormatError: the path has none of these endings, or the grid has no such level.
    """
    if path.suffix.lower() not in endings:
        expected = f"a name that ends in {' or '.join(endings)}"
        raise FormatError(f"expected {expected}, got {path}", path=str(path), expected=expected)
    if level is None:
        return list(range(len(grid.levels)))
    check_written_level(grid, level)
    return [level]


def check_written_level(grid: NavGrid, level: int) -> None:
    """Check that a grid has a level.

    Args:
        grid: the grid.
        level: the level's number; 0 is the lowest.

    Raises:
        FormatError: the grid has no such level.
    """
    if not 0 <= level < len(grid.levels):
        raise FormatError(
            f"no level {level}: the grid has {len(grid.levels)}, counted from 0",
            key="level",
            value=level,
        )


def list_level_paths(
    grid: NavGrid, path: Path, level: int | None, endings: tuple[str, ...]
) -> dict[int, Path]:
    """Return the path of the file of each level to write.

    Args:
        grid: the grid.
        path: the file, if a single level is written. The files of several levels get the level's
            number after the stem, such as ``map_0.yaml``.
        level: the number of the only level to write, None for all.
        endings: the endings that the path may have, in lower case.

    Returns:
        Level number -> path, ascending.

    Raises:
        FormatError: the path has none of these endings, or the grid has no such level.
    """
    level_numbers = select_levels(grid, path, level, endings)
    if len(level_numbers) == 1:
        return {level_numbers[0]: path}
    return {
        level_number: path.with_name(f"{path.stem}_{level_number}{path.suffix}")
        for level_number in level_numbers
    }
