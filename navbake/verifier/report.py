"""The report of a verification: counts of each level, and each disagreement with its position."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field

from navbake.types import Json, Vector3

# Kinds of findings
FREE_TOUCHES = "free cell touches"
BLOCKED_APART = "blocked cell touches nothing"
NO_FLOOR = "free cell without floor"
FLOOR_OFF = "floor off"
PLACE_LOST = "place lost"
PATH_TOUCHES = "path touches"
LINK_TOUCHES = "link touches"
NO_LANDING = "link without landing"
MAX_LISTED_FINDINGS = 10_000  # findings in the JSON of a report; all are counted


@dataclass(frozen=True)
class Finding:
    """One disagreement between a grid and its scene.

    Attributes:
        kind: A constant of this module, such as `FREE_TOUCHES`.
        level: The level's index, 0 for the lowest; for a lost place, the level that was being
            checked when the place was found.
        cell: Row and column on the level; None where the level has no such cell.
        position: World x, y, z [m].
        text: What is wrong.
        geom: The name of the geom that the finding is about; None for no geom.
        size: The depth of a touch, the gap beside a blocked cell or the offset of a floor [m], or
            the area of a lost place [m²]; None where it was not measured.
    """

    kind: str
    level: int
    cell: tuple[int, int] | None
    position: Vector3
    text: str
    geom: str | None = None
    size: float | None = None

    def to_json(self) -> Json:
        """Return the finding as a JSON object, with numbers rounded to a micrometre."""
        size = None if self.size is None else round(self.size, 6)
        position = [round(coordinate, 6) for coordinate in self.position]
        cell = None if self.cell is None else list(self.cell)
        return {**vars(self), "cell": cell, "position": position, "size": size}


@dataclass
class LevelCounts:
    """How many cells and floors of a level agree with the scene, and how many do not.

    In names such as `free_touches`, the first word is the grid's state of the cells, the second the
    scene's.

    Attributes:
        name: The level's name.
        cells: The cells that were checked.
        free_free: Free cells where nothing is touched.
        blocked_blocked: Blocked cells where something is touched, or which have no floor.
        free_touches: Free cells where something is touched.
        blocked_apart: Blocked cells where nothing is touched.
        disputed: Cells where MuJoCo and FCL contradict each other and nothing proves either right;
            they are no faults.
        floors: The floors that were checked.
        floors_off: Floors where no geom has a surface.
        in_cracks: Floors with a surface only beside the cell's centre, which lies in a crack.
        lost: Places to stand that no level has.
    """

    name: str
    cells: int = 0
    free_free: int = 0
    blocked_blocked: int = 0
    free_touches: int = 0
    blocked_apart: int = 0
    disputed: int = 0
    floors: int = 0
    floors_off: int = 0
    in_cracks: int = 0
    lost: int = 0


@dataclass
class SweepCounts:
    """How many paths a cylinder was swept along, and how many of them touch something.

    Attributes:
        radius: The cylinder's radius [m].
        paths: How many paths were swept.
        length: Their length in all [m].
        touching: How many of them touch something.
        beside: How many of them touch something only within a step of the cylinder's lower or
            upper end. These are no faults: a free cell says nothing of these heights where
            neighboring cells have floors at different heights.
    """

    radius: float
    paths: int = 0
    length: float = 0.0
    touching: int = 0
    beside: int = 0


@dataclass
class VerifyReport:
    """The result of a verification.

    Attributes:
        scene_id: The grid's scene.
        num_cells: The number of cells of all levels.
        seed: The seed of the sample and of the paths.
        tolerance: The depth [m] up to which touches are attributed to rounding.
        radius: The radius of the cylinder on free cells [m]; None for the baked footprint.
        levels: The counts of each level, lowest first.
        sweeps: The counts of the paths; None where no paths were swept.
        findings: All disagreements, sorted by level and cell.
        notes: What was left out, or was checked by one of the two libraries alone.

    Example:
        >>> report = navbake.verify("house.grid.json", "house.yaml")
        >>> for finding in report.findings:
        ...     print(finding.position, finding.text)
    """

    scene_id: str | None
    num_cells: int
    seed: int
    tolerance: float
    radius: float | None = None
    levels: list[LevelCounts] = field(default_factory=list)
    sweeps: SweepCounts | None = None
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether the grid and the scene agree in everything that was checked."""
        return not self.findings

    @property
    def checked(self) -> int:
        """The number of cells that were checked."""
        return sum(level.cells for level in self.levels)

    def of_kind(self, kind: str) -> Iterator[Finding]:
        """Iterate over the findings of one kind, such as `FREE_TOUCHES`."""
        return (finding for finding in self.findings if finding.kind == kind)

    @property
    def total(self) -> LevelCounts:
        """The counts of all levels added up."""
        total = LevelCounts("all")
        for level in self.levels:
            for name, count in vars(level).items():
                if name != "name":
                    setattr(total, name, getattr(total, name) + count)
        return total

    def to_json(self) -> Json:
        """Return the report as a JSON object, with up to `MAX_LISTED_FINDINGS` findings."""
        return {
            "ok": self.ok,
            "scene_id": self.scene_id,
            "cells": self.num_cells,
            "checked": self.checked,
            "seed": self.seed,
            "tolerance": self.tolerance,
            "radius": self.radius,
            "levels": [dict(vars(level)) for level in self.levels],
            "sweeps": None if self.sweeps is None else dict(vars(self.sweeps)),
            "num_findings": len(self.findings),
            "findings": [finding.to_json() for finding in self.findings[:MAX_LISTED_FINDINGS]],
            "notes": list(self.notes),
        }

    @property
    def digest(self) -> str:
        """The SHA-256 of the report's canonical JSON, 64 hex digits."""
        text = json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
