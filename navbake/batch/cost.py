"""What a batch would bake and why, and what its scenes cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from navbake.batch.index import read_index
from navbake.batch.job import FAILED, NEW, OK, Plan, begin_row, open_scene
from navbake.batch.run import AT_ONCE, check_records, find_twins
from navbake.batch.settings import Job, check_settings
from navbake.batch.store import shown
from navbake.errors import NavbakeError, printable
from navbake.types import Json

DONE, BROKEN = "done", "broken"  # reasons of scenes that aren't baked, or in vain
SHARES = (50, 90, 100)  # percentiles


def preview(plan: Plan, jobs: Sequence[Job]) -> list[Json]:
    """Find out what a batch would do, and write nothing.

    Returns an object for each scene, in order: `id`, `source`, `bytes` of its files, and `why` it
    would be baked: ``new``, ``failed before``, ``equal to ID`` (which is baked once for both), or a
    reason of `job.check_record`. Or ``done``, or ``broken: REASON`` for a scene that can't be read.

    Raises:
        ConfigError: an override or a shared setting is wrong.
    """
    check_settings([job.source for job in jobs], plan.settings, plan.overrides)
    checked = check_records(plan, jobs)
    done = {row["id"]: row for row, _ in checked if row is not None}
    twins = find_twins(plan, jobs, done)
    failed = {id for id, row in read_index(plan.folder).items() if row.get("status") == FAILED}

    def measure(job: Job) -> tuple[int, str]:
        if job.id in done:
            return _sum_sizes(done[job.id].get("inputs")), ""
        try:
            with open_scene(plan, job, whole=False) as scene:
                lack = "" if scene.inputs else f"{BROKEN}: no scene file {shown(job.source)}"
                return _sum_sizes(scene.inputs), lack
        except (NavbakeError, OSError) as error:
            return 0, f"{BROKEN}: {printable(str(error))}"

    with ThreadPoolExecutor(AT_ONCE) as pool:
        measured = [*pool.map(measure, jobs)]
    found = []
    for job, (row, why), (num_bytes, broken) in zip(jobs, checked, measured, strict=True):
        if row is not None:
            why = DONE
        elif broken or job.id in twins:
            why = broken or f"equal to {twins[job.id]}"
        elif why == NEW and job.id in failed:
            why = "failed before"
        source = begin_row(plan, job, "")["source"]
        found.append({"id": job.id, "source": source, "why": why, "bytes": num_bytes})
    return found


def measure_cost(rows: Iterable[Json]) -> Json | None:
    """What scenes that are ``ok`` cost, None without one.

    Returns how many `scenes` there are, and of their `seconds`, and of the `bytes` of the files
    that were made, the sum, the median, the 90th percentile and the largest.
    """
    done = [row for row in rows if row.get("status") == OK]
    if not done:
        return None
    values = {
        "seconds": [row.get("seconds", 0.0) for row in done],
        "bytes": [_sum_sizes(row.get("files")) for row in done],
    }
    found: Json = {"scenes": len(done)}
    for name, each in values.items():
        shares = np.percentile(each, SHARES, method="inverted_cdf").tolist()
        found[name] = dict(zip(("sum", "median", "p90", "max"), (sum(each), *shares), strict=True))
    return found


def _sum_sizes(files: Json | None) -> int:
    return sum(state["size"] for state in (files or {}).values())
