"""What a verification found: counts by level, and each disagreement with its place."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field

from navbake.types import Json, Vector3

FREE_TOUCHES = "free cell touches"
BLOCKED_APART = "blocked cell touches nothing"
NO_FLOOR = "free cell without floor"
FLOOR_OFF = "floor off"
PLACE_LOST = "place lost"
PATH_TOUCHES = "path touches"
LINK_TOUCHES = "link touches"
NO_LANDING = "link without landing"
MOST_FINDINGS = 10_000  # that are listed; all are counted


@dataclass(frozen=True)
class Finding:
    """One place where a grid and its scene disagree."""

    kind: str  # one of this module's names in capitals, such as `FREE_TOUCHES`
    level: int  # 0 is the lowest; of a lost place, the one where it was looked for
    cell: tuple[int, int] | None  # row and column on it, None where it has no such cell
    position: Vector3  # world x, y, z [m]
    text: str  # what is wrong, in words
    geom: str | None = None  # the geom that it is about, None for none
    # depth of a touch, gap, offset of a floor [m], or area of a lost place [m²]; None: not measured
    size: float | None = None

    def to_json(self) -> Json:
        """The finding as JSON."""
        size = None if self.size is None else round(self.size, 6)
        position = [round(v, 6) for v in self.position]
        cell = self.cell and list(self.cell)
        return {**vars(self), "cell": cell, "position": position, "size": size}


@dataclass
class LevelCounts:
    """How often cells agree with the scene: a name has what the grid says, then the scene."""

    name: str  # the level's
    cells: int = 0  # that were looked at
    free_free: int = 0
    blocked_blocked: int = 0  # something touches there, or there is no floor
    free_touches: int = 0
    blocked_apart: int = 0
    disputed: int = 0  # MuJoCo and FCL contradict each other, and no proof settles it: no fault
    floors: int = 0  # that were looked at
    floors_off: int = 0  # where no geom has a surface
    in_cracks: int = 0  # whose surface lies beside the cell's centre
    lost: int = 0  # places to stand that no level has


@dataclass
class SweepCounts:
    """What came of sweeping a cylinder along paths."""

    radius: float  # of the cylinder [m]
    paths: int = 0
    length: float = 0.0  # of all [m]
    touching: int = 0  # paths that touch something
    # paths that meet, within a step of the lower or the upper end of the cylinder, what cells with
    # other floors leave open; that is known, and no fault
    beside: int = 0


@dataclass
class VerifyReport:
    """What a verification found."""

    scene_id: str | None
    num_cells: int  # of all levels
    seed: int  # of the sample
    tolerance: float  # what touches by less than this touches by rounding [m]
    radius: float | None = None  # of the cylinder on free cells [m]; None for the baked footprint
    levels: list[LevelCounts] = field(default_factory=list)  # lowest level first
    sweeps: SweepCounts | None = None  # None where no paths were swept
    findings: list[Finding] = field(default_factory=list)  # by level and cell
    # what was left out, or is judged by one of the two libraries alone
    notes: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether the grid and the scene agree everywhere that was looked at."""
        return not self.findings

    @property
    def checked(self) -> int:
        """How many cells were looked at."""
        return sum(level.cells for level in self.levels)

    def of_kind(self, kind: str) -> Iterator[Finding]:
        """The findings of one kind, such as `FREE_TOUCHES`."""
        return (finding for finding in self.findings if finding.kind == kind)

    @property
    def total(self) -> LevelCounts:
        """The sums over all levels."""
        columns = zip(*(list(vars(level).values())[1:] for level in self.levels), strict=True)
        return LevelCounts("all", *map(sum, columns))

    def to_json(self) -> Json:
        """The report as JSON, findings up to `MOST_FINDINGS` of them."""
        return {
            "ok": self.ok,
            "sceneId": self.scene_id,
            "cells": self.num_cells,
            "checked": self.checked,
            "seed": self.seed,
            "tolerance": self.tolerance,
            "radius": self.radius,
            "levels": [dict(vars(level)) for level in self.levels],
            "sweeps": None if self.sweeps is None else dict(vars(self.sweeps)),
            "numFindings": len(self.findings),
            "findings": [finding.to_json() for finding in self.findings[:MOST_FINDINGS]],
            "notes": list(self.notes),
        }

    @property
    def digest(self) -> str:
        """Sha256 of the report's canonical JSON, 64 hex digits."""
        text = json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
