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

MAX_LISTED = 10  # findings that a message lists


def assert_true(
    grid: NavGrid | str | PathLike[str], scene: SceneSource | None = None, **options: Any
) -> VerifyReport:
    """Assert that a grid agrees with its scene, see `navbake.verify`.

    Args:
        grid: The grid or its file, see `navbake.verify`.
        scene: The scene, see `navbake.verify`.
        **options: Further arguments of `navbake.verify`.

    Returns:
        The report of the verification.

    Raises:
        AssertionError: Grid and scene disagree; the message lists the first ten disagreements.

    Example:
        >>> def test_the_kitchen_is_as_in_the_scene():
        ...     navbake.testing.assert_true("kitchen.grid.json")
    """
    report = verify(grid, scene, **options)
    if not report.ok:
        lines = [
            f"{finding.kind}, level {finding.level}, {finding.position}: {finding.text}"
            for finding in report.findings
        ]
        raise AssertionError(_list_findings(f"{report.scene_id}: grid and scene disagree", lines))
    return report


def assert_sound(grid: NavGrid | str | PathLike[str], *, remarks: bool = True) -> AuditReport:
    """Assert that an audit finds no error and no other remark in a grid, see `navbake.audit`.

    Args:
        grid: The grid or its file, see `navbake.audit`.
        remarks: Whether remarks that are no errors count, too.

    Returns:
        The report of the audit.

    Raises:
        AssertionError: The audit finds something; the message lists the first ten findings.
    """
    report = audit(grid)
    findings = report.remarks if remarks else report.errors
    if findings:
        lines = [str(finding) for finding in findings]
        raise AssertionError(_list_findings(f"{report.scene_id}: an audit finds", lines))
    return report


def _list_findings(heading: str, lines: list[str]) -> str:
    """Write a message: a heading, the first lines, and the number of lines that were left out."""
    message_lines = [heading, *lines[:MAX_LISTED]]
    num_more = len(lines) - MAX_LISTED
    if num_more > 0:
        message_lines.append(f"and {num_more} more")
    return "\n".join(message_lines)
