"""What an audit has to say of a grid."""

from __future__ import annotations

from dataclasses import dataclass, field

from navbake.types import Json, Vector3

ERROR, REMARK = "error", "remark"
Found = tuple[str, int | None, Vector3 | None, str]
"""What a check yields: severity, level, place and text of a `Remark`."""


@dataclass(frozen=True)
class Remark:
    """One thing that a person would notice."""

    check: str  # what it is about, in a word or two
    severity: str  # ERROR for what can't be right, REMARK for what may be meant
    level: int | None  # 0 is the lowest; None for the whole grid
    place: Vector3 | None  # world x, y, z [m]; None where no place is meant
    text: str  # what it is, in words

    def __str__(self) -> str:
        """One line: how bad, where, what."""
        where = "" if self.level is None else f"level {self.level}"
        if self.place is not None:
            where += " ({:.2f}, {:.2f}, {:.2f})".format(*self.place)
        return f"{self.severity}: {where.strip()}{': ' if where else ''}{self.text}"

    def to_json(self) -> Json:
        """The remark as JSON."""
        place = None if self.place is None else [round(v, 6) for v in self.place]
        return {**vars(self), "place": place}


@dataclass
class AuditReport:
    """All remarks on a grid."""

    scene_id: str | None
    remarks: list[Remark] = field(default_factory=list)  # errors first
    checks: list[str] = field(default_factory=list)  # that ran

    @property
    def errors(self) -> list[Remark]:
        """The remarks that can't be right."""
        return [remark for remark in self.remarks if remark.severity == ERROR]

    @property
    def ok(self) -> bool:
        """Whether there are no errors."""
        return not self.errors

    def to_json(self) -> Json:
        """The report as JSON."""
        return {
            "ok": self.ok,
            "sceneId": self.scene_id,
            "checks": list(self.checks),
            "remarks": [remark.to_json() for remark in self.remarks],
        }


def count_of(count: int, what: str) -> str:
    """How many of something, in words."""
    return f"{count} {what}{'' if count == 1 else 's'}"
