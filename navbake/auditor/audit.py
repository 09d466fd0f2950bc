"""Looks at a grid, without its scene, for what a person would notice."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from os import PathLike
from typing import Any

from navbake.auditor import cells, levels
from navbake.auditor.facts import ERROR, AuditReport, Facts, Found, Remark
from navbake.errors import FormatError
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import shown_type
from navbake.navgrid.grid import GridBase, NavGrid

CHECKS: dict[str, tuple[str, Callable[[Facts], Iterator[Found]]]] = {
    "all cells are free": ("all free", cells.check_all_free),
    "a level is empty or all blocked": ("empty level", cells.check_empty_levels),
    "hardly any cell is free": ("hardly free", cells.check_free_share),
    "weights contradict occupancy": ("weights", cells.check_weights),
    "an inflation can't be read": ("inflation", cells.check_inflation),
    "a free cell has no floor": ("floors", cells.check_floors),
    "the floor jumps": ("jumps", cells.check_jumps),
    "stored layers are wrong": ("layers", cells.check_layers),
    "one cell cuts off an island": ("cut off", cells.check_cut_off),
    "no link reaches a level": ("unreached", cells.check_unreached_levels),
    "the room table contradicts the cells": ("room table", levels.check_room_table),
    "nothing leads out of a room": ("no way out", levels.check_rooms_without_way_out),
    "a door joins what it can't": ("doors", levels.check_doors),
    "cells have no size, or no place": ("levels", levels.check_lattices),
    "levels are out of order": ("levels", levels.check_order),
    "boxes exclude their own cells": ("boxes", levels.check_boxes),
    "links lead nowhere": ("links", levels.check_links),
    "links are missing": ("no link", levels.check_missing_links),
    "a link stops where it can't": ("named links", levels.check_named_links),
    "an area is nowhere": ("areas", levels.check_areas),
    "the agent can't be": ("agent", levels.check_agent),
}
"""The checks, by what each looks for: what its remarks are called, and its function."""


def run_check(check: Callable[[Facts], Iterator[Found]], facts: Facts) -> Iterator[Found]:
    """What a check finds; that the metadata which it is about are broken is an error."""
    try:
        yield from check(facts)
    except FormatError as error:
        yield ERROR, None, None, str(error)


def audit(grid: NavGrid | str | PathLike[str]) -> AuditReport:
    """Look at a grid of any program, or its file, for what a person would notice.

    Raises a FormatError if it is neither a grid nor a path, or the file can't be read.
    """
    if not isinstance(grid, GridBase | str | PathLike):
        raise FormatError(f"expected a grid or the path of its file, got {shown_type(grid)}")
    content: Any = grid if isinstance(grid, GridBase) else read_navgrid(grid)
    facts, remarks = Facts(content), []
    for name, check in CHECKS.values():
        for severity, level, place, text in run_check(check, facts):
            # the grid's own place may be no number
            is_place = place is not None and all(map(math.isfinite, place))
            remarks.append(Remark(name, severity, level, place if is_place else None, text))
    remarks.sort(key=lambda remark: remark.severity != ERROR)
    return AuditReport(content.scene_id, remarks, list(CHECKS))
