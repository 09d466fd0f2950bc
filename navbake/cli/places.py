"""Places on the command line, spelled one way in all commands: ``x,y``, ``x,y,z`` or ``x,y,L1``."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, NamedTuple

from typer import BadParameter

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid

PLACE = "X,Y[,Z|,LEVEL]"
"""How help texts show a place."""
PLACE_HELP = "in metres; a third number is z, L0 is the lowest level"
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
SPELLED = re.compile(rf"({NUMBER}),({NUMBER})(?:,(?:({NUMBER})|L(\d+)))?")


class GivenPlace(NamedTuple):
    """A place as it was given: world x, y [m], and either z [m], or a level, or neither."""

    x: float
    y: float
    z: float | None = None
    level: int | None = None


def parse_place(text: str, option: str) -> GivenPlace:
    """Read a place; the error of any other spelling names the right one.

    Raises:
        BadParameter: the text is none.
    """
    found = SPELLED.fullmatch(text)
    if not found:
        meant = _correct(text)
        hint = f": did you mean {meant}?" if meant else ""
        raise BadParameter(
            f"expected {PLACE} as in 1.5,-2 or 1.5,-2,0.3 or 1.5,-2,L1, got {text!r}{hint}",
            param_hint=option,
        )
    x, y, z, level = found.groups()
    place = GivenPlace(
        float(x), float(y), None if z is None else float(z), None if level is None else int(level)
    )
    if not all(math.isfinite(value) for value in (place.x, place.y, place.z or 0.0)):
        raise BadParameter(f"expected finite numbers, got {text!r}", param_hint=option)
    return place


def position_of_place(grid: NavGrid, place: GivenPlace, option: str) -> list[float]:
    """World x, y, z [m] of a place: where it has no z, the floor of its level there.

    A place without a level is on the only one that has a floor there. On a grid of one level it
    stays x, y.

    Raises:
        BadParameter: the place has no level, and none or several have a floor there; or its level
            is open to the one below there.
        QueryError: there is no such level.
    """
    x, y, z, level = place
    if z is not None:
        return [x, y, z]
    if level is None:
        if len(grid.levels) == 1:
            return [x, y]
        level = _only_level(grid, x, y, option)
    cell = grid.cell_at((x, y), level)
    z = grid.levels[level].ground if cell is None else float(grid.position_of(cell)[2])
    found = grid.cell_at((x, y, z))
    if found is not None and found.level != level:
        raise BadParameter(f"level {level} has no floor at {x:g}, {y:g}", param_hint=option)
    return [x, y, z]


def _only_level(grid: NavGrid, x: float, y: float, option: str) -> int:
    """The level that alone has a floor at x, y.

    Raises:
        BadParameter: none or several have one.
    """
    found = [number for number in range(len(grid.levels)) if _has_floor(grid, x, y, number)]
    if len(found) == 1:
        return found[0]
    if not found:
        raise BadParameter(f"no level has a floor at {x:g}, {y:g}", param_hint=option)
    spelled = [f"{x:g},{y:g},L{number}" for number in found]
    raise BadParameter(
        f"expected a place with a level or z, got {x:g},{y:g}, where {len(found)} levels have a "
        f"floor: write {' or '.join(spelled)}",
        param_hint=option,
    )


def _has_floor(grid: NavGrid, x: float, y: float, level: int) -> bool:
    cell = grid.cell_at((x, y), level)
    return cell is not None and not math.isnan(grid.levels[level].floor[cell.row, cell.col])


def _correct(text: str) -> str:
    """The right spelling of what was probably meant; empty if that can't be told."""
    found = re.fullmatch(
        rf"[^\w.+-]*({NUMBER})[\s,;:]+({NUMBER})(?:[\s,;:]+(?:({NUMBER})|(?:l|level)\s*(\d+)))?[^\w.]*",
        text,
        flags=re.IGNORECASE,
    )
    if not found:
        return ""
    x, y, z, level = found.groups()
    return ",".join([x, y, *([z] if z else []), *([f"L{level}"] if level else [])])
