"""Checks of levels: their order, lattices, boxes and links; and of the agent that they are for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from navbake.auditor.facts import Facts
from navbake.auditor.report import ERROR, REMARK, Remark, count_of
from navbake.errors import FormatError
from navbake.navgrid.lattice import FARTHEST
from navbake.types import Bool

ALIGNED = 1e-3  # share of a cell that lattices may be off
BOX_SLACK = 1e-4  # metres that a cell may lie beside its level's box
MOST_TAKEN = 0.5  # share of a level's free cells that may lie in lower levels' boxes
MAX_SLOPE = 45.0  # of ramps, where the bake states no other [degrees]
NEXT = 1.5  # cells that the ends of a link may be apart, seen from above


def check_lattices(facts: Facts) -> Iterator[Remark]:
    """A level lies nowhere, or its cells have no size."""
    for number, level in enumerate(facts.levels):
        lattice = level.lattice
        if not 0 < lattice.cell_size < math.inf:
            text = f"its cells have a size of {lattice.cell_size:g} m"
            yield Remark("levels", ERROR, number, None, text)
        if not all(map(math.isfinite, (lattice.x_min, lattice.y_max, level.ground))):
            yield Remark("levels", ERROR, number, None, "its corner is at no place")


def check_order(facts: Facts) -> Iterator[Remark]:
    """Levels aren't in order, lie on different lattices, or are there twice."""
    first = facts.levels[0].lattice
    for number, level in enumerate(facts.levels[1:], start=1):
        below, lattice = facts.levels[number - 1], level.lattice
        if level.ground < below.ground:
            text = f"its ground, {level.ground:.2f} m, is below that of the level before"
            yield Remark("levels", ERROR, number, None, text)
        cells = (lattice.x_min - first.x_min) / first.cell_size
        rows = (first.y_max - lattice.y_max) / first.cell_size
        off = max(abs(cells - round(cells)), abs(rows - round(rows)))
        if off > ALIGNED or abs(lattice.cell_size / first.cell_size - 1) > 1e-6:
            text = f"its cells lie {off:.3f} of a cell beside those of the lowest level"
            yield Remark("levels", ERROR, number, None, text)
        same = np.array_equal(facts.floors[number], facts.floors[number - 1], equal_nan=True)
        if same and lattice == below.lattice:
            text = "its floors are those of the level before, cell by cell"
            yield Remark("levels", ERROR, number, None, text)


def check_boxes(facts: Facts) -> Iterator[Remark]:
    """A level's box leaves out free cells of its own, or another level's takes them."""
    boxes = [level.bbox_yup for level in facts.levels]
    for number, box in enumerate(boxes):
        free = facts.free[number]
        if box is None:
            continue
        out = free & ~_in_box(facts, number, box)
        if out.any():
            out &= ~_interleaves(facts, number)
        if out.any():
            text = f"{int(out.sum())} free cells lie outside of its box (`bbox`)"
            yield Remark("boxes", ERROR, number, facts.first(number, out), text)
        taken = np.zeros_like(free)
        for lower in boxes[:number]:
            if lower is not None:
                taken |= free & _in_box(facts, number, lower)
        # where levels interleave, some cells lie in two boxes, and no boxes are right for all
        if number and taken.sum() > MOST_TAKEN * free.sum():
            text = f"{int(taken.sum())} free cells lie in the box of a lower level, too"
            yield Remark("boxes", REMARK, number, facts.first(number, taken), text)


def _interleaves(facts: Facts, number: int) -> Bool:
    """The cells of a level that lie between the floors of another, where no boxes are right."""
    found = np.zeros(facts.levels[number].shape, dtype=np.bool_)
    for other, floor in enumerate(facts.floors):
        known = floor[facts.free[other] & ~np.isnan(floor)]
        if other != number and len(known):
            own = facts.floors[number]
            found |= (own >= known.min()) & (own <= known.max())
    return found


def _in_box(facts: Facts, number: int, box: tuple[tuple[float, ...], ...]) -> Bool:
    """Which cells of a level have their centres in a box of the file (y up)."""
    level, floor = facts.levels[number], facts.floors[number]
    (x0, y0, z0), (x1, y1, z1) = (np.array(corner) * level.unit for corner in box)
    x, y = level.lattice.center_x(), level.lattice.center_y()
    height = np.where(np.isnan(floor), level.ground, floor)
    inside = (height >= y0 - 1e-6) & (height <= y1 + 1e-6)
    inside &= (x >= x0 - BOX_SLACK) & (x <= x1 + BOX_SLACK)
    inside &= ((-y >= z0 - BOX_SLACK) & (-y <= z1 + BOX_SLACK))[:, None]
    return np.asarray(inside)


def check_links(facts: Facts) -> Iterator[Remark]:
    """Links lead to cells that there aren't, that have no floor, that are far away, or too high."""
    try:
        links = facts.grid.link_array
    except FormatError as error:
        yield Remark("links", ERROR, None, None, str(error))
        return
    ends = []
    for level, cell in ((0, 1), (2, 3)):
        places = np.full((len(links), 3), np.nan)
        for number, grid in enumerate(facts.levels):
            here = links[:, level] == number
            rows, cols = np.divmod(links[here, cell], grid.width)
            places[here, :2] = grid.lattice.positions(rows, cols).reshape(-1, 2)
            places[here, 2] = facts.floors[number][rows, cols]
        ends.append(places)
    one, other = ends
    rise, limit = np.abs(one - other)[:, 2], _highest_rise(facts)
    far = np.hypot(*(one - other)[:, :2].T) > NEXT * facts.levels[0].lattice.cell_size
    for wrong, what in (
        (np.isnan(rise), "to cells without a floor"),
        (far, "to cells that aren't neighbours"),
        (rise > limit, f"up by more than {limit:.2f} m"),
    ):
        if wrong.any():
            k = int(np.nanargmax(np.where(wrong, np.nan_to_num(rise), -1.0)))
            x, y, z = one[k].tolist()
            number, count = int(links[k, 0]), int(wrong.sum())
            place = (x, y, facts.levels[number].ground if np.isnan(z) else z)
            text = f"{count_of(count, 'link')} lead{'s' if count == 1 else ''} {what}"
            text += f": {rise[k]:.2f} m" if what.startswith("up") else ""
            yield Remark("links", ERROR, number, place, text)


def _highest_rise(facts: Facts) -> float:
    """The most that a link may rise: a step, or what a slope rises more than that over a cell [m].

    A bake links neighbours more than a step apart where a ramp leads on, which its own slope tells
    within a step.
    """
    stated: Any = facts.grid.navbake.get("maxSlope")
    is_angle = type(stated) in (int, float) and 0 <= stated < 90
    slope = stated if is_angle else MAX_SLOPE
    ramp = facts.levels[0].lattice.cell_size * math.tan(math.radians(slope))
    return facts.step_limit + (ramp if ramp > facts.step_limit else 0.0)


def check_agent(facts: Facts) -> Iterator[Remark]:
    """The agent can't be: its sizes are none, it takes steps as high as itself, or it is another.

    That is another than that of the settings, which a bake states beside it.
    """
    grid, settings = facts.grid, facts.settings.get("agent", {})
    for key, taken, what, name, default in (
        ("agentHeight", grid.agent_height, "> 0", "height", 1.14),
        ("agentRadius", grid.agent_radius, ">= 0", "radius", 0.05),
        ("traversableFloorHeight", grid.max_step, ">= 0", "traversable_floor_height", 0.25),
    ):
        baked: Any = settings.get(name, default) if isinstance(settings, dict) else None
        stated = grid.metadata.get(key)
        if stated is not None and not _is_length(stated, grid.unit, or_zero=what != "> 0"):
            text = f"`{key}` is {stated!r}, which is no length {what}: it counts as {taken:g} m"
            yield Remark("agent", ERROR, None, None, text)
        elif facts.settings and type(baked) in (int, float) and not math.isclose(taken, baked):
            text = f"`{key}` is {taken:g} m, but its settings say that it was baked for {baked:g} m"
            yield Remark("agent", ERROR, None, None, text)
    if grid.max_step >= grid.agent_height:
        text = f"the agent of {grid.agent_height:g} m takes steps of {grid.max_step:g} m"
        yield Remark("agent", ERROR, None, None, text)
    if grid.agent_radius > 5:
        text = f"the agent has a radius of {grid.agent_radius:g} m: is the unit right?"
        yield Remark("agent", REMARK, None, None, text)


def _is_length(stated: object, unit: float, *, or_zero: bool) -> bool:
    """Whether a value of the metadata is a length that a grid may have."""
    if not isinstance(stated, int | float) or isinstance(stated, bool):
        return False
    return (stated > 0 or (or_zero and stated == 0)) and stated * unit <= FARTHEST
