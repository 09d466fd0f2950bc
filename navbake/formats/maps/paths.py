"""Names of maps that hold one level each."""

from __future__ import annotations

from pathlib import Path

from navbake.errors import FormatError
from navbake.navgrid.grid import NavGrid


def level_paths(
    grid: NavGrid, path: Path, level: int | None, endings: tuple[str, ...]
) -> dict[int, Path]:
    """The path of the map of each level, by the level's number.

    A grid of one level has the path itself, and so has the level that is asked for. Of several
    levels, the number follows the stem: ``map_0.yaml``, ``map_1.yaml``.

    Raises:
        FormatError: the name has none of the endings, or there is no such level.
    """
    if path.suffix.lower() not in endings:
        raise FormatError(f"expected a name that ends in {' or '.join(endings)}, got {path}")
    count = len(grid.levels)
    if level is not None:
        if not 0 <= level < count:
            raise FormatError(f"no level {level}: the grid has {count}, counted from 0")
        return {level: path}
    if count == 1:
        return {0: path}
    return {k: path.with_name(f"{path.stem}_{k}{path.suffix}") for k in range(count)}
