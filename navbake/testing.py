"""Assertions for tests of grids and maps: `assert_true` and `assert_sound`."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

from navbake.auditor.audit import audit
from navbake.auditor.report import AuditReport
from navbake.verifier.verify import verify

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.verifier.report import VerifyReport
    from navbake.verifier.source import SceneSource

SHOWN = 10  # disagreements that a message lists


def assert_true(
    grid: NavGrid | str | PathLike[str], scene: SceneSource | None = None, **options: Any
) -> VerifyReport:
    """Assert that a grid says of its scene what MuJoCo and FCL say.

    Args:
        grid, scene, options: as of `navbake.verify`.

    Returns:
        The report.

    Raises:
        AssertionError: they disagree; the message lists the first places.
    """
    report = verify(grid, scene, **options)
    lines = [f"{f.kind}, level {f.level}, {f.position}: {f.text}" for f in report.findings[:SHOWN]]
    more = len(report.findings) - len(lines)
    lines += [f"and {more} more"] if more else []
    assert report.ok, "\n".join([f"{report.scene_id}: grid and scene disagree", *lines])
    return report


def assert_sound(grid: NavGrid | str | PathLike[str], *, remarks: bool = True) -> AuditReport:
    """Assert that an audit finds no error in a grid, and nothing to remark.

    Args:
        grid: as of `navbake.audit`.
        remarks: whether remarks count, too.

    Returns:
        The report.

    Raises:
        AssertionError: it finds something; the message lists it.
    """
    report = audit(grid)
    found = report.remarks if remarks else report.errors
    assert not found, "\n".join([f"{report.scene_id}:", *map(str, found[:SHOWN])])
    return report
