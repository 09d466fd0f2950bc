"""Assertions for tests of grids and maps: `assert_true` and `assert_sound`."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

from navbake.auditor.audit import audit
from navbake.auditor.facts import AuditReport
from navbake.verifier.verify import verify

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.verifier.report import VerifyReport
    from navbake.verifier.source import SceneSource

SHOWN = 10  # disagreements in a message


def assert_true(
    grid: NavGrid | str | PathLike[str], scene: SceneSource | None = None, **options: Any
) -> VerifyReport:
    """Assert that a grid agrees with its scene; arguments and result are those of `navbake.verify`.

    The message of its AssertionError lists the first disagreements.
    """
    report = verify(grid, scene, **options)
    if not report.ok:
        places = [f"{f.kind}, level {f.level}, {f.position}: {f.text}" for f in report.findings]
        raise AssertionError(_list(f"{report.scene_id}: grid and scene disagree", places))
    return report


def assert_sound(grid: NavGrid | str | PathLike[str], *, remarks: bool = True) -> AuditReport:
    """Assert that an audit finds no error in a grid and, if `remarks` count, no remark.

    Arguments and result are those of `navbake.audit`; the AssertionError lists the findings.
    """
    report = audit(grid)
    found = report.remarks if remarks else report.errors
    if found:
        raise AssertionError(_list(f"{report.scene_id}: an audit finds", list(map(str, found))))
    return report


def _list(head: str, places: list[str]) -> str:
    rest = len(places) - SHOWN
    return "\n".join([head, *places[:SHOWN], *([f"and {rest} more"] if rest > 0 else [])])
