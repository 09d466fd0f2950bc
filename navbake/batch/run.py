"""Bakes a batch of scenes, each once, and writes the index, sets of episodes and shards.

Shards are tar files that WebDataset reads. Each scene is a sample. The sample's key is the scene's
id, with ``%2E`` for a dot and ``%25`` for a percent sign, because a key ends at the first dot of a
file's name. The sample's members are the scene's files (``0001.grid.json.gz`` for the key ``0001``)
and the scene's row of the index, without times (``0001.json``). The scenes are divided evenly among
the shards, in the batch's order. Equal scenes give equal bytes: members have no time, no owner and
the same mode.
"""

from __future__ import annotations

import os
import re
import tarfile
from collections import defaultdict
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np

from navbake._version import __version__
from navbake.batch import index, store
from navbake.batch.job import (
    FAILED,
    LEFT,
    NOT_RECORDED,
    OK,
    Inspection,
    Plan,
    bake_scene,
    begin_row,
    check_record,
    current_time,
    find_record,
    inspect_scenes,
    make_broken_inspection,
    prepare_worker,
    read_record,
    record_failure,
    write_record,
)
from navbake.batch.products import RECORD_NAME, describe_sizes, merge_episode_sets
from navbake.batch.scene_row import FileState, SceneRow
from navbake.batch.scenes import Job, check_settings, merge_settings
from navbake.batch.workers import DONE, RETRIED, JobEnd, JobLimits, Workers
from navbake.errors import NavbakeError
from navbake.files import remove_leftovers
from navbake.formats.source import import_extra
from navbake.types import Json

MAX_RECORD_READS = 16  # scenes whose records are read at once, or that one worker inspects at once
# The inspection of a scene may take as long as its bake, but at least MIN_INSPECTION_SECONDS; and
# DEFAULT_INSPECTION_SECONDS if bakes have no limit. A scene that takes longer is baked again.
DEFAULT_INSPECTION_SECONDS = 600.0
MIN_INSPECTION_SECONDS = 60.0
UNLOGGED_KEYS = ("key", "inputs", "files", "ended")  # keys of a row that the log leaves out
SHARD_PATTERN = re.compile(r"shard-\d{6,}\.tar")
TIME_KEYS = ("seconds", "stages", "ended")  # keys of a row that differ in each run
# reasons of `preview_batch` for scenes that would not be baked
ALREADY_DONE = "done"
BROKEN = "broken"
PERCENTILES = (50, 90, 100)  # of the cost of scenes: the median, the 90th, and the maximum


Executor: TypeAlias = Callable[..., Generator[JobEnd, None, None]]
"""Runs jobs elsewhere than in this machine's `Workers`, as `workers.run_on_ray` does.

It is called with the jobs, the function that does a job, the largest number of jobs at once (None:
it decides), and by keyword with `limits`, `prepare` and `on_event`; it yields the end of each job.
"""


OnBatchEvent: TypeAlias = Callable[[str, Json], None]
"""A function that is called with the name of an event of the batch and its values:

- ``begin``: `scenes`, the number of scenes, and `skipped`, how many of them are done already. It
  is left out if there is no scene to bake.
- ``scene-begin``: the scene's `id`.
- ``retry``: the scene's `id`, `worker` and `seconds`, and in `how` and `error` why it is retried.
- ``scene``: the scene's row of the index, and its `worker`.
"""


@dataclass
class BatchResult:
    """The outcome of a batch."""

    #: The rows of the index, one for each scene, in the batch's order.
    rows: list[SceneRow] = field(default_factory=list)
    num_skipped: int = 0  #: Number of scenes that were done already.
    stop_reason: str | None = None  #: Why the batch ended early; None if it didn't.

    def count(self, status: str) -> int:
        """Return the number of scenes with a status.

        Args:
            status: ``ok``, ``failed``, or ``left`` for scenes that the batch didn't reach.
        """
        return sum(row["status"] == status for row in self.rows)


def run_batch(
    plan: Plan,
    jobs: Sequence[Job],
    on_event: OnBatchEvent,
    *,
    workers: int | None = 1,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
    max_failures: int | None = None,
    executor: Executor | None = None,
    batch_slice: index.Slice | None = None,
    only_merge: bool = False,
    shards: int | None = None,
) -> BatchResult:
    """Bake scenes in worker processes, each into a folder of its own.

    Scenes that are done already are skipped, see `job.check_record`. A scene that fails, hangs or
    crashes its worker doesn't affect others. If the output folder has no room, the batch stops.
    Unless the process is killed, the index has a row for each scene at the end, in order; the row's
    status is ``left`` if the batch ended before the scene. If the output folder is on this machine,
    each row is also written as soon as its scene ends.

    Args:
        plan: the batch's options.
        jobs: the scenes.
        on_event: is called with each event.
        workers: number of worker processes, >= 1; None for as many as a cluster has CPUs, or one on
            this machine.
        limits: the limits of time and memory of each scene.
        max_failures: the batch ends when more scenes than this failed; None for no such limit.
        executor: runs the worker processes; None for processes on this machine.
        batch_slice: bake only the scenes of this slice, and write the slice's index.
        only_merge: bake nothing, and merge the indexes that slices wrote. Scenes without a row
            there are ``left`` unless they are done.
        shards: number of tar files to pack the scenes into at the end; None for no tar files.

    Returns:
        The rows of the scenes, and why the batch ended early, if it did.

    Raises:
        ConfigError: an override or a shared setting is wrong.
        NavbakeError: the folder can't be written, another batch writes into it, or no worker
            process starts.
    """
    check_settings([job.source for job in jobs], plan.settings, plan.overrides)
    if plan.writes_parquet:
        import_extra("pyarrow", "batch", "Parquet")
    if batch_slice is not None:
        jobs = jobs[batch_slice.number - 1 :: batch_slice.total]
    with ExitStack() as exit_stack:
        index_file: index.LineFile | None = None
        if isinstance(plan.folder, Path):
            exit_stack.enter_context(index.lock_batch(plan.folder, batch_slice))
            index_file = index.LineFile(
                plan.folder / (batch_slice.index_name if batch_slice else index.INDEX_NAME),
                f"into {plan.folder}",
            )
            exit_stack.callback(index_file.close)
        num_inspectors = None  # with an executor, this machine has nothing else to do
        if executor is None:
            num_inspectors = workers or 1
        inspector = Inspector(plan, num_inspectors, limits)
        row_of_scene = _list_earlier_rows(plan, jobs, inspector, only_merge=only_merge)
        remaining_jobs = [] if only_merge else [job for job in jobs if job.id not in row_of_scene]
        batch_result = BatchResult(num_skipped=len(row_of_scene))
        if only_merge:
            batch_result.num_skipped = sum(row["status"] == OK for row in row_of_scene.values())

        try:
            if remaining_jobs:
                on_event("begin", {"scenes": len(jobs), "skipped": len(row_of_scene)})
            batch_result.stop_reason = _bake_scenes(
                plan,
                _list_passes(inspector, jobs, remaining_jobs, row_of_scene),
                row_of_scene,
                index_file,
                on_event,
                workers=workers,
                limits=limits,
                max_failures=max_failures,
                executor=executor,
            )
        except store.DiskFullError as error:
            batch_result.stop_reason = str(error)
        finally:
            _clean_up_scenes(plan, [job for job in remaining_jobs if job.id not in row_of_scene])
            batch_result.rows = [
                row_of_scene.get(job.id) or begin_row(plan, job, LEFT) for job in jobs
            ]
            try:
                index.write_index(plan.folder, batch_result.rows, plan.writes_parquet, batch_slice)
            except store.DiskFullError as error:
                batch_result.stop_reason = batch_result.stop_reason or str(error)
        if batch_result.stop_reason is None and batch_slice is None:
            try:
                write_episode_sets(plan, batch_result.rows)
                write_shards(plan.folder, batch_result.rows, shards)
            except NavbakeError as error:
                batch_result.stop_reason = str(error)
        return batch_result


def _list_passes(
    inspector: Inspector,
    jobs: Sequence[Job],
    remaining_jobs: Sequence[Job],
    row_of_scene: Mapping[str, SceneRow],
) -> list[list[Job]]:
    """List the jobs of both passes of a batch: the scenes to bake, then the scenes to copy.

    Of equal scenes, one is baked, and its files are copied for the others afterwards.

    Args:
        inspector: tells which scenes are equal.
        jobs: all scenes.
        remaining_jobs: the scenes that no earlier run has done.
        row_of_scene: the rows of those that are done; scene's id -> row.
    """
    twin_of_scene = find_twins(inspector, jobs, row_of_scene) if remaining_jobs else {}
    jobs_to_bake = [job for job in remaining_jobs if job.id not in twin_of_scene]
    jobs_to_copy = [
        job._replace(twin=twin_of_scene[job.id])
        for job in remaining_jobs
        if job.id in twin_of_scene
    ]
    return [jobs_to_bake, jobs_to_copy]


def _bake_scenes(
    plan: Plan,
    passes: Sequence[Sequence[Job]],
    row_of_scene: dict[str, SceneRow],
    index_file: index.LineFile | None,
    on_event: OnBatchEvent,
    *,
    workers: int | None,
    limits: JobLimits,
    max_failures: int | None,
    executor: Executor | None,
) -> str | None:
    """Bake scenes, and record the row of each as soon as it ends.

    Args:
        plan: the batch's options.
        passes: the scenes of each pass, which begins when the pass before it has ended.
        row_of_scene: receives the rows; scene's id -> row.
        index_file: receives the rows, too; None for no such file.
        on_event: is called with the row of each scene.
        workers: see `run_batch`.
        limits: see `run_batch`.
        max_failures: see `run_batch`.
        executor: see `run_batch`.

    Returns:
        Why the batch ended before the last scene; None if it didn't.
    """
    num_failed_scenes = 0
    for pass_jobs in passes:
        scene_rows = _run_jobs(
            plan, pass_jobs, on_event, workers=workers, limits=limits, executor=executor
        )
        with closing(scene_rows):
            for row, worker in scene_rows:
                if row["status"] == LEFT:  # there is no room for other scenes, either
                    stop_reason: str = row["error"]
                    return stop_reason
                row_of_scene[row["id"]] = row
                if index_file is not None:
                    index_file.add(row)
                on_event("scene", {**row, "worker": worker})
                num_failed_scenes += row["status"] == FAILED
                if max_failures is not None and num_failed_scenes > max_failures:
                    return f"{num_failed_scenes} scenes failed, more than {max_failures}"
    return None


def _clean_up_scenes(plan: Plan, jobs: Sequence[Job]) -> None:
    """Remove the files that killed workers may have left of scenes.

    On a store, the next run removes them.

    Args:
        plan: the batch's options.
        jobs: the scenes.
    """
    if not isinstance(plan.folder, Path):
        return
    for job in jobs:
        with suppress(NavbakeError):
            remove_leftovers(Path(plan.scene_folder(job)), min_age=0)


def _list_earlier_rows(
    plan: Plan, jobs: Sequence[Job], inspector: Inspector, *, only_merge: bool
) -> dict[str, SceneRow]:
    """List the rows of scenes that earlier runs, or slices of the batch, have baked.

    Args:
        plan: the batch's options.
        jobs: the scenes.
        inspector: tells whether the files of a scene have changed since.
        only_merge: whether to take the rows of slices' indexes, also of scenes that failed there.

    Returns:
        Scene's id -> row.
    """
    row_of_scene: dict[str, SceneRow] = {}
    if only_merge:
        batch_ids = {job.id for job in jobs}
        slice_rows = index.merge_rows(plan.folder, index.find_slice_indexes(plan.folder))
        row_of_scene = {
            id: row
            for id, row in slice_rows.items()
            if id in batch_ids and row.get("status") in (OK, FAILED)
        }
    other_jobs = [job for job in jobs if job.id not in row_of_scene]
    record_checks = check_records(plan, other_jobs, inspector)
    return row_of_scene | {row["id"]: row for row, _ in record_checks if row is not None}


def _run_jobs(
    plan: Plan,
    jobs: Sequence[Job],
    on_event: OnBatchEvent,
    *,
    workers: int | None,
    limits: JobLimits,
    executor: Executor | None,
) -> Generator[tuple[SceneRow, int], None, None]:
    """Bake scenes in worker processes, which end with this generator.

    Args:
        plan: the batch's options.
        jobs: the scenes.
        on_event: is called when a scene begins, and when it is retried.
        workers: see `run_batch`.
        limits: see `run_batch`.
        executor: see `run_batch`.

    Yields:
        The row of a scene that has ended, and the process id of its worker, 0 if unknown.
    """
    if not jobs:
        return
    bake_job = partial(bake_scene, plan)
    prepare = partial(prepare_worker, plan.products, plan.thumbnail)

    def report_job_event(event: str, job_end: JobEnd) -> None:
        event_values: Json = {"id": jobs[job_end.number].id}
        if event == RETRIED:
            event_values["worker"] = job_end.worker
            event_values["seconds"] = round(job_end.seconds, 3)
            event_values["how"] = job_end.how
            event_values["error"] = job_end.reason
        on_event(event, event_values)

    with ExitStack() as exit_stack:
        if executor is None:
            num_workers = min(workers or 1, len(jobs))
            worker_crew = Workers(bake_job, num_workers, limits=limits, prepare=prepare)
            job_ends = exit_stack.enter_context(worker_crew).run(jobs, report_job_event)
        else:
            job_ends = executor(
                jobs,
                bake_job,
                workers,
                limits=limits,
                prepare=prepare,
                on_event=report_job_event,
            )
        exit_stack.enter_context(closing(job_ends))
        for job_end in job_ends:
            row = job_end.result
            if job_end.how != DONE:
                job = jobs[job_end.number]
                row = record_failure(plan, job, job_end.how, job_end.reason, job_end.seconds)
            yield row, job_end.worker


def find_differing_agents(plan: Plan, jobs: Sequence[Job]) -> str | None:
    """Say before the bakes that the scenes' episodes will make no common set.

    Scenes on stores aren't looked at; a scene whose settings are wrong fails later, by itself.

    Args:
        plan: the batch's options.
        jobs: the scenes.

    Returns:
        The sentence; None if no episodes are made, or the scenes' agents have one size.
    """
    if not any(product.startswith("episodes:") for product in plan.products):
        return None
    id_of_size: dict[tuple[float, float], str] = {}
    for job in jobs:
        if store.is_url(job.source):
            continue
        with suppress(NavbakeError, OSError):
            agent = merge_settings(job, plan.settings, plan.overrides).agent
            id_of_size.setdefault((agent.radius, agent.height), job.id)
    if len(id_of_size) < 2:
        return None
    reason = describe_sizes(id_of_size)
    return f"no common set of episodes will be written, as {reason} use those of each scene"


def write_episode_sets(plan: Plan, rows: Sequence[SceneRow]) -> None:
    """Merge the scenes' sets of episodes, and write a file for each product ``episodes:…``.

    Args:
        plan: the batch's options; the files get into its folder.
        rows: the rows of the batch's scenes.

    Raises:
        NavbakeError: the sets can't be merged, see `products.merge_episode_sets`, or written.
    """
    for product in plan.products:
        kind, *values = product.split(":")
        name = f"episodes-{'-'.join(values)}.jsonl"
        ids = [row["id"] for row in rows if name in row.get("files", ())]
        if kind == "episodes" and ids:
            episode_sets = [
                (id, store.read_file(store.join(plan.folder, f"{id}/{name}"))) for id in ids
            ]
            store.write_file(plan.folder, name, merge_episode_sets(episode_sets))


def write_shards(folder: store.Folder, rows: Sequence[SceneRow], count: int | None) -> None:
    """Pack the scenes that are ``ok`` into tar files: ``shard-000000.tar`` and so on.

    The names of the shards are recorded in the folder. Recorded shards of earlier runs that aren't
    written again are removed; other files with such names are the user's and stay.

    Args:
        folder: the batch's output folder.
        rows: the rows of the index.
        count: number of shards; with fewer scenes than this, each scene gets a shard. None for no
            shards.
    """
    packed_rows = [row for row in rows if row["status"] == OK] if count else []
    num_scenes = len(packed_rows)
    num_shards = min(count or 0, num_scenes)
    shard_names = [f"shard-{shard_number:06}.tar" for shard_number in range(num_shards)]
    previous_shard_names = {*filter(SHARD_PATTERN.fullmatch, read_record(folder).get("files", ()))}
    if shard_names:
        write_record(
            folder, {"files": dict.fromkeys(sorted({*previous_shard_names, *shard_names}))}
        )
    for shard_number, shard_name in enumerate(shard_names):
        first_index = num_scenes * shard_number // num_shards
        end_index = num_scenes * (shard_number + 1) // num_shards
        store.write_file(
            folder, shard_name, _encode_shard(folder, packed_rows[first_index:end_index])
        )
    store.remove_files(folder, sorted(previous_shard_names - {*shard_names}))
    if shard_names:
        write_record(folder, {"files": dict.fromkeys(shard_names)})
    elif previous_shard_names:
        store.remove_files(folder, [RECORD_NAME])


def _encode_shard(folder: store.Folder, rows: Sequence[SceneRow]) -> Iterator[bytes]:
    """Yield the content of a tar file with these scenes, in several pieces."""
    for row in rows:
        key = row["id"].replace("%", "%25").replace(".", "%2E")
        for name in sorted(row["files"]):
            yield from _encode_member(
                f"{key}.{name}", store.read_file(store.join(folder, f"{row['id']}/{name}"))
            )
        timeless_row = {name: value for name, value in row.items() if name not in TIME_KEYS}
        yield from _encode_member(f"{key}.json", index.encode_json_line(timeless_row))
    yield bytes(2 * tarfile.BLOCKSIZE)


def _encode_member(member_name: str, content: bytes) -> Iterator[bytes]:
    """Yield a member of a tar file in pieces: its header, its content, and the padding."""
    tar_header = tarfile.TarInfo(member_name)
    tar_header.size = len(content)
    yield tar_header.tobuf(tarfile.PAX_FORMAT)
    yield content
    yield bytes(-len(content) % tarfile.BLOCKSIZE)


class Inspector:
    """Finds the input files and digests of scenes, without baking them; each is read only once.

    The scenes may be files of strangers. So they are read in worker processes, which have limits of
    time and memory.

    Args:
        plan: the batch's options.
        workers: number of worker processes, >= 1; None for as many as this machine has CPUs.
        limits: the limits of time and memory of a scene's bake; its inspection gets
            `MIN_INSPECTION_SECONDS` at least.
    """

    def __init__(self, plan: Plan, workers: int | None, limits: JobLimits) -> None:
        self._plan = plan
        self._workers = workers or os.cpu_count() or 1
        seconds = max(limits.seconds or DEFAULT_INSPECTION_SECONDS, MIN_INSPECTION_SECONDS)
        self._limits = JobLimits(seconds, limits.memory)
        self._inspections: dict[str, Inspection] = {}  # by the scene's id

    def inspect(self, jobs: Iterable[Job]) -> list[Inspection]:
        """Return the input files and digests of each scene, in order."""
        jobs = list(jobs)
        new_jobs = [job for job in jobs if job.id not in self._inspections]
        job_groups: list[tuple[Job, ...]] = []
        job_groups += [(job,) for job in new_jobs if not store.is_url(job.source)]
        jobs_on_stores = [job for job in new_jobs if store.is_url(job.source)]
        for begin_index in range(0, len(jobs_on_stores), MAX_RECORD_READS):
            job_groups.append(tuple(jobs_on_stores[begin_index : begin_index + MAX_RECORD_READS]))
        failed_groups = self._inspect_groups(job_groups)
        # one scene of such a group is the reason; the others have no fault
        failed_jobs = [job for group in failed_groups for job in group]
        self._inspect_groups([(job,) for job in failed_jobs])
        return [self._inspections[job.id] for job in jobs]

    def _inspect_groups(self, job_groups: Sequence[tuple[Job, ...]]) -> list[tuple[Job, ...]]:
        """Inspect each group in one go, and return the groups of several scenes that failed."""
        failed_job_groups = []
        if not job_groups:
            return []
        inspect_group = partial(inspect_scenes, self._plan)
        worker_crew = Workers(
            inspect_group, min(self._workers, len(job_groups)), limits=self._limits
        )
        with worker_crew, closing(worker_crew.run(job_groups)) as group_ends:
            for group_end in group_ends:
                job_group = job_groups[group_end.number]
                if group_end.how == DONE:
                    for job, inspection in zip(job_group, group_end.result, strict=True):
                        self._inspections[job.id] = inspection
                elif len(job_group) == 1:
                    self._inspections[job_group[0].id] = make_broken_inspection(group_end.reason)
                else:
                    failed_job_groups.append(job_group)
        return failed_job_groups


def check_records(
    plan: Plan, jobs: Sequence[Job], inspector: Inspector
) -> list[tuple[SceneRow | None, str]]:
    """Find out which scenes are done, and why the others aren't.

    Args:
        plan: the batch's options.
        jobs: the scenes.
        inspector: inspects the scenes that have a record.

    Returns:
        For each scene, in order: the row of a scene that is done, and ``""``; for another, None,
        and the reason to bake it, see `job.find_record` and `job.check_record`.
    """
    size_of_file = store.list_file_sizes(plan.folder) if isinstance(plan.folder, str) else None
    with ThreadPoolExecutor(MAX_RECORD_READS) as pool:  # stores respond slowly
        records_and_reasons = [
            *pool.map(partial(find_record, plan, size_of_file=size_of_file), jobs)
        ]
    recorded_jobs = [
        job
        for job, (record, _) in zip(jobs, records_and_reasons, strict=True)
        if record is not None
    ]
    inspections = iter(inspector.inspect(recorded_jobs))
    record_checks: list[tuple[SceneRow | None, str]] = []
    for job, (record, reason) in zip(jobs, records_and_reasons, strict=True):
        if record is None:
            record_checks.append((None, reason))
        else:
            record_checks.append(check_record(plan, job, record, next(inspections)))
    return record_checks


def find_twins(
    inspector: Inspector, jobs: Sequence[Job], done_ids: Container[str]
) -> dict[str, str]:
    """Find the scenes that needn't be baked because another scene of the batch is equal.

    Scenes on stores are compared only with scenes of the same URL, because their content isn't on
    this machine.

    Args:
        inspector: inspects the scenes of equal size.
        jobs: the scenes.
        done_ids: ids of the scenes that are done; none of them is a key of the result.

    Returns:
        For each scene that can be copied, by its id: the id of its twin. The twin is an equal scene
        that is done, or else the first of the equal scenes.
    """
    # Only files of the same size can be equal. Scenes that are done come first.
    jobs_by_size = defaultdict[str | int, list[Job]](list)
    for job in sorted(jobs, key=lambda job: job.id not in done_ids):
        with suppress(OSError):
            is_local = not store.is_url(job.source)
            size_or_url = os.path.getsize(job.source) if is_local else job.source
            jobs_by_size[size_or_url].append(job)
    candidate_groups = [
        group for group in jobs_by_size.values() if len(group) > 1 and group[-1].id not in done_ids
    ]
    candidate_jobs = [job for group in candidate_groups for job in group]
    # a scene without a digest can't be read: its own bake will fail, and say why
    digests = [inspection.content_digest for inspection in inspector.inspect(candidate_jobs)]
    id_of_digest: dict[str, str] = {}
    twin_of_scene: dict[str, str] = {}
    for job, digest in zip(candidate_jobs, digests, strict=True):
        twin_id = id_of_digest.setdefault(digest or job.id, job.id)
        if twin_id != job.id and job.id not in done_ids:
            twin_of_scene[job.id] = twin_id
    return twin_of_scene


def describe_event(event: str, values: Json) -> Json:
    """Describe an event of a batch as a JSON object, which is one line of the log.

    Args:
        event: the event's name, see `OnBatchEvent`; or ``end``.
        values: its values.

    Returns:
        An object with ``time`` (ISO 8601), ``level`` (``info``, ``warning`` or ``error``),
        ``event``, and most of the values.
    """
    is_error = values.get("status") == FAILED or values.get("stopped") or values.get("failed")
    log_level = "error" if is_error else "info"
    if event == RETRIED or (values.get("warnings") and not is_error):
        log_level = "warning"
    values = {key: value for key, value in values.items() if key not in UNLOGGED_KEYS}
    if event == "begin":
        values["version"] = __version__
    return {"time": current_time(), "level": log_level, "event": event, **values}


# ---------------------------------------------------------------- before and after a run


def preview_batch(
    plan: Plan,
    jobs: Sequence[Job],
    *,
    workers: int | None = 1,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
) -> list[Json]:
    """Find out what a batch would do, and write nothing.

    Args:
        plan: the batch's options.
        jobs: the scenes.
        workers: number of processes that look at scenes; None for as many as there are CPUs.
        limits: the limits of time and memory of each scene.

    Returns:
        An object for each scene, in order, with its `id`, its `source`, the size of its input files
        (`bytes`), and `why`. For a scene that would be baked, `why` is ``new``, ``failed before``,
        or another reason of `job.check_record`. It is ``equal to ID`` if the grid of that scene
        would be copied; ``done`` if the scene is done; and ``broken: REASON`` if the scene can't be
        read.

    Raises:
        ConfigError: an override or a shared setting is wrong.
    """
    check_settings([job.source for job in jobs], plan.settings, plan.overrides)
    inspector = Inspector(plan, workers, limits)
    record_checks = check_records(plan, jobs, inspector)
    done_rows = {row["id"]: row for row, _ in record_checks if row is not None}
    inspections = dict(zip([job.id for job in jobs], inspector.inspect(jobs), strict=True))
    twin_of_scene = find_twins(inspector, jobs, done_rows)
    failed_ids = {
        id for id, row in index.read_index(plan.folder).items() if row.get("status") == FAILED
    }

    def measure_inputs(job: Job) -> tuple[int, str]:
        """Return the size of a scene's files [bytes], and why it can't be read, or ``""``."""
        if job.id in done_rows:
            return _sum_sizes(done_rows[job.id].get("inputs")), ""
        inspection = inspections[job.id]
        if inspection.error:
            return 0, f"{BROKEN}: {inspection.error}"
        if not inspection.inputs:
            source = store.without_secrets(job.source)
            return 0, f"{BROKEN}: no scene file {source}"
        return _sum_sizes(inspection.inputs), ""

    previews = []
    for job, (row, reason) in zip(jobs, record_checks, strict=True):
        num_input_bytes, broken_text = measure_inputs(job)
        if row is not None:
            reason = ALREADY_DONE
        elif broken_text:
            reason = broken_text
        elif job.id in twin_of_scene:
            reason = f"equal to {twin_of_scene[job.id]}"
        elif reason == NOT_RECORDED and job.id in failed_ids:
            reason = "failed before"
        source = begin_row(plan, job, "")["source"]
        previews.append({"id": job.id, "source": source, "why": reason, "bytes": num_input_bytes})
    return previews


def measure_cost(rows: Iterable[SceneRow]) -> Json | None:
    """Return statistics of the cost of scenes that are ``ok``; None without such a scene.

    The object has the number of these scenes (`scenes`). It has `sum`, `median`, `p90` (the 90th
    percentile) and `max` of two quantities: the time that a scene took (`seconds`), and the size of
    the files that were made of it (`bytes`).
    """
    done_rows = [row for row in rows if row.get("status") == OK]
    if not done_rows:
        return None
    values_of_quantity: dict[str, list[float]] = {
        "seconds": [row.get("seconds", 0.0) for row in done_rows],
        "bytes": [_sum_sizes(row.get("files")) for row in done_rows],
    }
    cost: Json = {"scenes": len(done_rows)}
    for name, values in values_of_quantity.items():
        median, percentile_90, maximum = np.percentile(
            values, PERCENTILES, method="inverted_cdf"
        ).tolist()
        cost[name] = {"sum": sum(values), "median": median, "p90": percentile_90, "max": maximum}
    return cost


def _sum_sizes(files: Mapping[str, FileState] | None) -> int:
    """Return the total size of files [bytes], 0 for None."""
    return sum(state["size"] for state in (files or {}).values())
