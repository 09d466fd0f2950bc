"""The table of all rows: whether each is as fast as it is asked to be, and what that means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from benchmarks.measure import Result, Row

HEADER = f"{'row':<18}{'job':<42}{'min':>10}{'median':>10}{'ratio':>11}{'peak':>10}  asked for"
FIGURES_BEGIN = "<!-- written by scripts/bench.py --write -->\n"
FIGURES_END = "<!-- end of what scripts/bench.py writes -->\n"


class Limit(NamedTuple):
    """One limit of a row.

    Attributes:
        text: what is asked for, such as ``1.5 ×``.
        is_met: None where there is nothing to compare with.
    """

    text: str
    is_met: bool | None


@dataclass(frozen=True)
class Outcome:
    """What became of a row.

    Attributes:
        name: of the row.
        row: None if it could not be made.
        results: of its jobs, ours first; empty if it was not measured.
        skipped: why it was not measured, with the command that installs what it needs.
        error: why it failed.
    """

    name: str
    row: Row | None = None
    results: Sequence[Result] = ()
    skipped: str = ""
    error: str = ""

    @property
    def verdict(self) -> str:
        """``met``, ``missed``, ``skipped``, ``failed``; ``no limit`` where nothing is asked for."""
        if self.error:
            return "failed"
        if self.row is None or not self.results:
            return "skipped"
        limits = judge_limits(self.row, self.results)
        if any(limit.is_met is False for limit in limits):
            return "missed"
        if any(limit.is_met is None for limit in limits):
            return "skipped"
        return "met" if limits else "no limit"

    @property
    def reason(self) -> str:
        """Why it has its verdict, in one line."""
        if self.error or self.row is None:
            return self.error or self.skipped
        if self.verdict == "missed":
            return format_limits(self.row, self.results)
        return self.row.missing or self.skipped


def judge_limits(row: Row, results: Sequence[Result]) -> list[Limit]:
    """Hold a row's results against what is asked for.

    Args:
        row: the row.
        results: of its jobs, ours first.
    """
    job, *peers = results
    ratio = job.median / peers[0].median if peers else None
    excess = job.median - peers[0].median if peers else None
    limits = (
        (row.ratio, ratio, f"{row.ratio or 0:g} ×"),
        (row.excess, excess, f"{format_seconds(row.excess or 0)} more"),
        (row.peak, job.peak, f"{row.peak or 0:,.0f} MiB"),
    )
    return [
        Limit(text, None if value is None else value <= limit)
        for limit, value, text in limits
        if limit is not None
    ]


def format_limits(row: Row, results: Sequence[Result]) -> str:
    """Say in one line what is asked for, and whether it is met."""
    words = {None: "not compared", True: "met", False: "NOT MET"}
    return ", ".join(f"{limit.text}: {words[limit.is_met]}" for limit in judge_limits(row, results))


def format_row(name: str, row: Row, results: Sequence[Result]) -> str:
    """Format a row as lines: our job, then the peers with our median over theirs."""
    job, *peers = results
    lines = [_format_job(name, job, "", format_limits(row, results))]
    for peer in peers:
        lines.append(_format_job("", peer, f"{job.median / peer.median:.3g} ×", ""))
    if row.missing:
        lines.append(f"{'':<18}{row.missing}")
    return "\n".join(lines)


def _format_job(name: str, result: Result, ratio: str, limits: str) -> str:
    peak = "" if result.peak is None else f"{result.peak:,.0f} MiB"
    times = f"{format_seconds(result.least):>10}{format_seconds(result.median):>10}"
    return f"{name:<18}{result.name:<42}{times}{ratio:>11}{peak:>10}  {limits}".rstrip()


def format_seconds(seconds: float) -> str:
    """Format a duration as milliseconds or seconds."""
    return f"{seconds * 1e3:.1f} ms" if seconds < 1 else f"{seconds:.2f} s"


def format_outcome(outcome: Outcome) -> str:
    """Format a row as lines of the table, also one that was skipped or failed."""
    if outcome.row is None or not outcome.results:
        return f"{outcome.name:<18}{outcome.verdict}: {outcome.reason}"
    return format_row(outcome.name, outcome.row, outcome.results)


def summarize(outcomes: Sequence[Outcome]) -> str:
    """Count the rows by verdict, and name those that were missed, failed or skipped, with why."""
    verdicts = [outcome.verdict for outcome in outcomes]
    counts = ", ".join(
        f"{verdicts.count(verdict)} {verdict}"
        for verdict in ("met", "missed", "failed", "skipped", "no limit")
        if verdict in verdicts
    )
    lines = [f"{len(outcomes)} rows: {counts}"]
    for verdict in ("missed", "failed", "skipped"):
        lines += [
            f"{verdict}: {outcome.name} ({outcome.reason})"
            for outcome in outcomes
            if outcome.verdict == verdict
        ]
    return "\n".join(lines)


def exit_status(outcomes: Sequence[Outcome]) -> int:
    """Return 1 if a row was missed or failed, else 0; skipped rows don't count."""
    return int(any(outcome.verdict in ("missed", "failed") for outcome in outcomes))


def to_json(outcome: Outcome) -> dict[str, Any]:
    """A row for a program: seconds, MiB, and what each job tells of itself."""
    jobs = [
        {
            "name": result.name,
            "min": result.least,
            "median": result.median,
            "peak": result.peak,
            "facts": result.samples[-1].facts or {},
        }
        for result in outcome.results
    ]
    content: dict[str, Any] = {"row": outcome.name, "verdict": outcome.verdict}
    if outcome.row is None or not jobs:
        return {**content, "reason": outcome.reason}
    limits = {
        "ratio": outcome.row.ratio,
        "excess": outcome.row.excess,
        "peak": outcome.row.peak,
    }
    return {**content, "job": jobs[0], "peers": jobs[1:], "limits": limits}


# --- docs/compare.md -----------------------------------------------------------------------


class Comparison(NamedTuple):
    """A line of the table in the docs.

    Attributes:
        row: the row that has the figures.
        job: what is done.
        peer: the other's name.
        peer_index: which of the row's peers that is.
    """

    row: str
    job: str
    peer: str
    peer_index: int = 0


COMPARISONS = (
    Comparison(
        "house",
        "a furnished house of 100 rooms, 1.0 million cells",
        "Recast, rasterize to regions",
    ),
    Comparison("many", "the same with round furniture, 3.7 million triangles", "Recast"),
    Comparison("soup", "a soup of 395,000 triangles", "Recast"),
    Comparison("soup-large", "a soup of 3.7 million triangles", "Recast"),
    Comparison(
        "house",
        "the house by a plain loop of `mj_ray` and FCL",
        "Python, extrapolated",
        peer_index=1,
    ),
    Comparison("inflate", "inflation of a million cells", "OpenCV `distanceTransform`"),
    Comparison("path", "8 paths on a million cells", "pyastar2d"),
    Comparison("field", "a distance field of a million cells", "dijkstra3d"),
    Comparison("voxels", "17.2 million voxels of a mesh", "pyvista", peer_index=1),
    Comparison("octree-scattered", "a million voxels as an octree", "octomap-python"),
    Comparison("flights-house", "8 flights in a house, voxels of 0.1 m", "scipy's Dijkstra"),
    Comparison("flights-house", "the same", "dijkstra3d", peer_index=1),
    Comparison("flights-warehouse", "8 flights in a warehouse", "dijkstra3d", peer_index=1),
    Comparison("flights-tower", "8 flights in a tower", "dijkstra3d", peer_index=1),
    Comparison("flight-octree", "a flight in the house", "a loop over octomap-python"),
)


def write_figures(text: str, outcomes: Sequence[Outcome], conditions: str) -> str:
    """Replace the figures in the text of ``docs/compare.md``.

    Rows whose peer was not there are left out.

    Args:
        text: of the page, with lines that mark where the figures begin and end.
        outcomes: of all rows.
        conditions: how often and on what the rows were measured.

    Returns:
        The new text.
    """
    lines = [
        f"{conditions} The machine's",
        "speed differs by a third from day to day, so only ratios mean something:",
        "",
        "| job | navbake | other | other's time | ratio |",
        "|---|---|---|---|---|",
    ]
    outcome_of_row = {outcome.name: outcome for outcome in outcomes}
    for comparison in COMPARISONS:
        outcome = outcome_of_row.get(comparison.row)
        if outcome is None or len(outcome.results) < comparison.peer_index + 2:
            continue
        job = outcome.results[0]
        peer = outcome.results[comparison.peer_index + 1]
        lines.append(
            f"| {comparison.job} | {format_seconds(job.median)} | {comparison.peer} "
            f"| {format_seconds(peer.median)} | {job.median / peer.median:.3g} × |"
        )
    before, _, rest = text.partition(FIGURES_BEGIN)
    _, _, after = rest.partition(FIGURES_END)
    figures = "\n".join(lines)
    return f"{before}{FIGURES_BEGIN}\n{figures}\n\n{FIGURES_END}{after}"
