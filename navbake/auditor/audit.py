"""Looks at a grid, without its scene, for what a person would notice."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from os import PathLike
from typing import Any

from navbake.auditor.cells import (
    check_all_free,
    check_empty_levels,
    check_free_share,
    check_inflation,
    check_layers,
    check_weights,
)
from navbake.auditor.facts import Facts
from navbake.auditor.floors import check_cut_off, check_floors, check_jumps, check_unreached_levels
from navbake.auditor.levels import (
    check_agent,
    check_boxes,
    check_lattices,
    check_links,
    check_order,
)
from navbake.auditor.report import ERROR, AuditReport, Remark
from navbake.auditor.rooms import check_doors, check_room_table, check_rooms_without_way_out
from navbake.errors import FormatError
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import shown_type
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.grid_base import GridBase

CHECKS: dict[str, Callable[[Facts], Iterator[Remark]]] = {
    "all cells are free": check_all_free,
    "a level is empty or all blocked": check_empty_levels,
    "hardly any cell is free": check_free_share,
    "weights contradict occupancy": check_weights,
    "an inflation can't be read": check_inflation,
    "a free cell has no floor": check_floors,
    "the floor jumps": check_jumps,
    "stored layers are wrong": check_layers,
    "one cell cuts off an island": check_cut_off,
    "no link reaches a level": check_unreached_levels,
    "the room table contradicts the cells": check_room_table,
    "nothing leads out of a room": check_rooms_without_way_out,
    "a door joins what it can't": check_doors,
    "cells have no size, or no place": check_lattices,
    "levels are out of order": check_order,
    "boxes exclude their own cells": check_boxes,
    "links lead nowhere": check_links,
    "the agent can't be": check_agent,
}
"""The checks, by what each looks for."""


def audit(grid: NavGrid | str | PathLike[str]) -> AuditReport:
    """Look at a grid of any program for what a person would notice, without its scene.

    Args:
        grid: a grid of one or several levels, or the path of its file.

    Raises:
        FormatError: it is neither a grid nor a path, or the file can't be read.
    """
    if not isinstance(grid, GridBase | str | PathLike):
        raise FormatError(f"expected a grid or the path of its file, got {shown_type(grid)}")
    content: Any = grid if isinstance(grid, GridBase) else read_navgrid(grid)
    facts = Facts(content)
    remarks = [_with_place(remark) for check in CHECKS.values() for remark in check(facts)]
    remarks.sort(key=lambda remark: remark.severity != ERROR)
    return AuditReport(content.scene_id, remarks, list(CHECKS))


def _with_place(remark: Remark) -> Remark:
    """The remark; without its place where the grid's own place is no number."""
    is_place = remark.place is None or all(map(math.isfinite, remark.place))
    return remark if is_place else replace(remark, place=None)
