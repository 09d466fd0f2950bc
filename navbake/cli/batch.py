"""The commands `navbake batch` and `warm-up`."""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from typer import BadParameter, Exit

from navbake.cli import options, printing
from navbake.cli.options import (
    OUTPUT_FLAGS,
    STDOUT,
    AgentRadius,
    CellSize,
    SceneFiles,
    argument,
    flag,
    option,
)
from navbake.cli.printing import (
    VERBOSITY,
    add_facts,
    print_error,
    print_warnings,
    say,
    say_unless_quiet,
)
from navbake.errors import NavbakeError, count_of
from navbake.lazy import lazy

if TYPE_CHECKING:
    from rich import filesize

    from navbake.batch import index, job, page, products, run, scenes, store, workers
    from navbake.types import Json
else:  # --help loads neither MuJoCo nor numpy
    filesize = lazy("rich.filesize")
    index = lazy("navbake.batch.index")
    job = lazy("navbake.batch.job")
    page = lazy("navbake.batch.page")
    products = lazy("navbake.batch.products")
    run = lazy("navbake.batch.run")
    scenes = lazy("navbake.batch.scenes")
    store = lazy("navbake.batch.store")
    workers = lazy("navbake.batch.workers")

MAX_LISTED_SCENES = 5  # most scenes that a line of --plan names


@dataclass(frozen=True)
class SceneOptions:
    """The options for the scenes that a batch bakes, and for their settings."""

    sources: list[str] = argument(
        "SOURCE",
        "Scenes or settings (YAML), patterns in quotes, or lists: .txt, .csv, .jsonl, also with "
        ".gz, or .parquet; paths or URLs such as s3://.",
    )
    config: str | None = option("YAML", "Settings that all scenes share.")
    column: list[str] | None = option(
        "NAME=COLUMN",
        "A list's column for scene, config, id or a setting; all others are then ignored. May be "
        "repeated.",
    )
    allow_hosts: list[str] | None = option(
        "HOST", "Another host of the web to which lists and settings may lead. May be repeated."
    )
    radius: AgentRadius = None
    cell_size: CellSize = None
    slice_text: str | None = option(
        "K/N", "Every N-th scene from the K-th; then --merge.", "--slice"
    )


@dataclass(frozen=True)
class ProductOptions:
    """The options that say what a batch writes."""

    output: str = option(
        "FOLDER",
        "Folder to write into; each scene gets a folder of its own in it.",
        *OUTPUT_FLAGS,
        default=...,
    )
    make: list[str] | None = option(
        "WHAT",
        "What to make of each scene, too: inflated:RADIUS[:CLEARANCE], nav2[:RADIUS], report, "
        "voxels:EDGE[:ENDING], picture[:LAYER...], episodes:TASK[:SAMPLER[:COUNT[:SEED]]], "
        "stand:RADIUS[:LEAST[:GREATEST]]. May be repeated.",
    )
    has_page: bool = flag(
        "--page", "Write FOLDER/index.html: all scenes, their failures and times."
    )
    parquet: bool = flag("--parquet", "Write the index as index.parquet as well.")
    shards: int | None = option("N", "Pack the scenes into N tar files (WebDataset).", min=1)


@dataclass(frozen=True)
class WorkerOptions:
    """The options of a batch's worker processes, and the limits of a scene."""

    count: int | None = option(
        "N", "Worker processes: 1 unless given, on a cluster one a CPU.", "-j", "--jobs", min=1
    )
    max_failures: int | None = option("N", "Stop when more than N scenes failed.", min=0)
    time_limit: float | None = option("SECONDS", "How long a scene may take [s].", min=0.001)
    memory_limit: float | None = option(
        "GIB",
        "Memory that a scene may take beyond what its process starts with, on Linux [GiB].",
        min=0.01,
    )
    retries: int = option("N", "How often a crash or a limit is tried again.", default=0, min=0)
    executor: Literal["embedded", "ray"] = option(
        "embedded|ray", "Run workers on this machine, or on a Ray cluster.", default="embedded"
    )
    ray_address: str | None = option(
        "ADDRESS", "Ray cluster to use; local starts one here.  [default: RAY_ADDRESS, else local]"
    )


@dataclass(frozen=True)
class RunOptions:
    """The options that say whether a batch bakes at all, and what it prints."""

    preview: bool = flag("--plan", "Bake nothing: say what would be baked, why, and its size.")
    merge: bool = flag("--merge", "Bake nothing: merge the indexes of slices into one.")
    as_json: bool = flag("--json", "Print what happens as lines of JSON, as --log writes them.")
    log: Path | None = option("FILE", "Add what happens to a file, a line of JSON each.")


def batch(
    scene_options: SceneOptions,
    scene_files: SceneFiles,
    product_options: ProductOptions,
    worker_options: WorkerOptions,
    run_options: RunOptions,
) -> None:
    """Bake many scenes in several processes.

    Scenes that are done already are skipped, and failures don't affect other scenes. The outcome of
    each scene is in FOLDER/index.jsonl. The exit status is 1 if any failed.

    Example: navbake batch "scenes/*.xml" -o grids --jobs 8 --time-limit 300
    """
    batch_slice = _read_slice(scene_options.slice_text)
    _check_options(batch_slice, product_options, worker_options, run_options)
    hosts = tuple(scene_options.allow_hosts or ())
    store.allow_hosts(hosts)
    columns = options.read_pairs(scene_options.column, "--column", "NAME=COLUMN")
    jobs = scenes.list_jobs(scene_options.sources, columns)
    if run_options.log is not None:
        _check_log(run_options.log, jobs, scene_options, product_options.output)
    config = scene_options.config
    size_overrides = options.override_sizes(scene_options.radius, scene_options.cell_size)
    plan = job.Plan(
        folder=store.as_folder(product_options.output),
        settings={} if config is None else scenes.read_shared_settings(config),
        overrides=(*scene_files.list_overrides(), *size_overrides),
        products=products.parse_products(product_options.make or []),
        thumbnail=product_options.has_page,
        writes_parquet=product_options.parquet,
        hosts=hosts,
    )
    set_problem = run.find_differing_agents(plan, jobs)
    if set_problem is not None:  # the bakes may take hours
        print_warnings([set_problem])
    limits = workers.JobLimits(
        worker_options.time_limit, worker_options.memory_limit, worker_options.retries
    )
    if run_options.preview:
        if batch_slice is not None:
            jobs = jobs[batch_slice.number - 1 :: batch_slice.total]
        previews = run.preview_batch(plan, jobs, workers=worker_options.count, limits=limits)
        _print_preview(plan, previews, run_options.as_json)
        return
    with ExitStack() as stack:
        watch = _BatchWatch(
            stack,
            plan.folder,
            as_json=run_options.as_json,
            log=run_options.log,
            has_page=product_options.has_page,
            only_merge=run_options.merge,
        )
        try:
            result = run.run_batch(
                plan,
                jobs,
                watch,
                workers=worker_options.count,
                limits=limits,
                max_failures=worker_options.max_failures,
                executor=_ray_executor(worker_options, plan.folder),
                batch_slice=batch_slice,
                only_merge=run_options.merge,
                shards=product_options.shards,
            )
        except BaseException as error:
            watch.interrupt(error)
            raise
        watch.end(result, _list_written_names(batch_slice, product_options))
    if result.count("failed") or result.stop_reason:
        raise Exit(1)


def _check_options(
    batch_slice: index.Slice | None,
    product_options: ProductOptions,
    worker_options: WorkerOptions,
    run_options: RunOptions,
) -> None:
    """Raise a BadParameter for options that contradict each other or have no effect."""
    has_address = worker_options.ray_address is not None
    is_ray = worker_options.executor == "ray"
    is_complete = batch_slice is None
    complete_batch = "the whole batch, as with --merge"
    options.refuse_unused("--ray-address", has_address, has_effect=is_ray, purpose="--executor ray")
    options.refuse_unused(
        "--merge", run_options.merge, has_effect=is_complete, purpose="all slices"
    )
    options.refuse_unused(
        "--page", product_options.has_page, has_effect=is_complete, purpose=complete_batch
    )
    options.refuse_unused(
        "--parquet", product_options.parquet, has_effect=is_complete, purpose=complete_batch
    )
    options.refuse_unused(
        "--shards",
        product_options.shards is not None,
        has_effect=is_complete,
        purpose=complete_batch,
    )
    if not product_options.output:
        raise BadParameter("expected a folder, got nothing: . is the current one", param_hint="-o")
    if run_options.log == STDOUT:
        raise BadParameter("expected a file, got -: --json prints the same", param_hint="--log")


def _check_log(log: Path, jobs: list[scenes.Job], scene_options: SceneOptions, output: str) -> None:
    """Raise an error if the log is an input, or a file that the batch writes."""
    written_paths = [
        os.path.join(output, name) for name in (index.INDEX_NAME, page.PAGE_NAME, index.TABLE_NAME)
    ]
    config_paths = [] if scene_options.config is None else [scene_options.config]
    sources = [listed_job.source for listed_job in jobs]
    inputs = map(Path, [*scene_options.sources, *config_paths, *sources, *written_paths])
    options.check_output(log, inputs=inputs, may_make_folder=True, option="--log")


def _ray_executor(worker_options: WorkerOptions, folder: store.Folder) -> run.Executor | None:
    """Return a function that runs jobs on a Ray cluster; None to run them on this machine."""
    if worker_options.executor != "ray":
        return None
    # nodes of the cluster check that they see the lock file, and so the output folder
    probe_file = folder / index.LOCK_NAME if isinstance(folder, Path) else None
    return partial(workers.run_on_ray, address=worker_options.ray_address, probe_file=probe_file)


def _list_written_names(
    batch_slice: index.Slice | None, product_options: ProductOptions
) -> list[str]:
    """Return the names of the files that a batch writes beside its scenes' folders."""
    file_names = [index.INDEX_NAME if batch_slice is None else batch_slice.index_name]
    if product_options.parquet:
        file_names.append(index.TABLE_NAME)
    if product_options.shards:
        file_names.append("shard-*.tar")
    return file_names


def _read_slice(text: str | None) -> index.Slice | None:
    """Read the value of --slice, ``K/N``; None for None."""
    if text is None:
        return None
    number_text, _, total_text = text.partition("/")
    if not (
        number_text.isdecimal()
        and total_text.isdecimal()
        and 1 <= int(number_text) <= int(total_text)
    ):
        message = f"expected K/N with K from 1 to N, as 3/64, got {text!r}"
        raise BadParameter(message, param_hint="--slice")
    return index.Slice(int(number_text), int(total_text))


def _print_preview(plan: job.Plan, previews: list[Json], as_json: bool) -> None:
    """Print what a batch would bake: a line for each reason, or a line of JSON for each scene.

    Args:
        plan: the batch's options.
        previews: see `run.preview_batch`.
        as_json: whether to print JSON.
    """
    if as_json:
        for scene_preview in previews:
            printing.print_json_line(scene_preview)
        return
    scenes_by_reason: dict[str, list[Json]] = {}
    for scene_preview in previews:
        reason = scene_preview["why"].partition(":")[0]
        if reason.startswith("equal to "):
            reason = "equal"
        scenes_by_reason.setdefault(reason, []).append(scene_preview)
    for reason, scenes_of_reason in scenes_by_reason.items():
        size_text = filesize.decimal(
            sum(scene_preview["bytes"] for scene_preview in scenes_of_reason)
        )
        names_text = _name_scenes(reason, scenes_of_reason)
        say(f"{reason}: {count_of(len(scenes_of_reason), 'scene')}, {size_text}{names_text}")
    unbaked_reasons = (run.ALREADY_DONE, run.BROKEN)
    num_baked = sum(
        len(scenes_of_reason)
        for reason, scenes_of_reason in scenes_by_reason.items()
        if reason not in unbaked_reasons
    )
    num_copied = len(scenes_by_reason.get("equal", ()))
    num_baked -= num_copied
    summary = f"{num_baked} of {count_of(len(previews), 'scene')} would be baked"
    if num_copied:
        summary += f", and {num_copied} copied"
    cost = run.measure_cost(index.read_index(plan.folder).values())
    if cost is not None and num_baked > 0:
        scale_factor = num_baked / cost["scenes"]
        seconds = cost["seconds"]["sum"] * scale_factor
        size_text = filesize.decimal(int(cost["bytes"]["sum"] * scale_factor))
        summary += f", by those done here in about {seconds:.3g} s of a worker, into {size_text}"
    say(summary)


def _name_scenes(reason: str, scenes_of_reason: list[Json]) -> str:
    """Return the end of a line of --plan: the first scenes with a reason, and their details.

    Args:
        reason: the reason.
        scenes_of_reason: the scenes with this reason, see `run.preview_batch`.
    """
    if reason == run.ALREADY_DONE:
        return ""
    name_texts = []
    for scene in scenes_of_reason[:MAX_LISTED_SCENES]:
        detail = scene["why"].removeprefix(f"{reason}: ")
        name_texts.append(scene["id"] if detail == reason else f"{scene['id']} ({detail})")
    num_more = len(scenes_of_reason) - len(name_texts)
    if num_more:
        name_texts.append(f"{num_more} more")
    return f": {', '.join(name_texts)}"


class _BatchWatch:
    """Shows the progress of a batch, and writes its page and its log.

    On the terminal, progress is a bar, and a line for each failure; or it is lines of JSON.
    """

    def __init__(
        self,
        stack: ExitStack,
        folder: store.Folder,
        *,
        as_json: bool,
        log: Path | None,
        has_page: bool,
        only_merge: bool,
    ) -> None:
        self._stack = stack
        self._folder = folder
        self._as_json = as_json
        self._has_page = has_page
        self._only_merge = only_merge
        self._line_writers: list[Callable[[Json], None]] = []
        if as_json:
            self._line_writers.append(printing.print_json_line)
        if log is not None:
            log_file = index.LineFile(log, f"the log {log}")
            stack.callback(log_file.close)
            self._line_writers.append(log_file.add)
        self._begin = time.perf_counter()
        self._counts = {"baked": 0, "skipped": 0, "failed": 0, "left": 0}
        self._total = 0
        self._removed_names = Counter[str]()  # file -> number of scenes that it was removed from
        self._show_progress: Callable[..., None] = lambda *progress: None
        self._page: page.LivePage | None = None

    def __call__(self, event: str, values: Json) -> None:
        """Handle an event of the batch, see `run.OnBatchEvent`."""
        if event == "begin":
            self._begin_batch(values)
        self._log(event, values)
        if event == "begin":
            self._open_views()
        if event == "scene":
            is_failure = values["status"] == "failed"
            self._counts["failed" if is_failure else "baked"] += 1
            self._counts["left"] -= 1
            self._removed_names.update(values.get("removed", ()))
            if is_failure and not self._as_json:
                print_error(f"{values['id']}: {values['how']}: {values['error']}")
        if event in ("begin", "scene"):
            self._refresh()

    def _begin_batch(self, values: Json) -> None:
        """Compile the kernels, and note how many scenes are to be baked.

        Args:
            values: the values of the event ``begin``.
        """
        from navbake import compiled  # loads numba

        if compiled.cache_folder() is None:
            problem = "no folder for compiled code can be written: each worker compiles its own"
            print_warnings([f"{problem}: {compiled.CACHE_REMEDY}"])
        compiled.ensure_compiled()  # once for all workers
        self._total = values["scenes"] - values["skipped"]
        self._counts["skipped"] = values["skipped"]
        self._counts["left"] = self._total

    def _open_views(self) -> None:
        """Open the page and the progress bar."""
        if self._has_page:
            self._page = page.LivePage(self._folder, self._total)
        # on a terminal, lines and a bar would mix
        is_mixed = self._as_json and printing.is_terminal(sys.stdout)
        bars = printing.show_progress_bars("batch", VERBOSITY.quiet or is_mixed)
        self._show_progress = self._stack.enter_context(bars)

    def _refresh(self) -> None:
        """Show on the progress bar and the page how many scenes are done."""
        num_done = self._total - self._counts["left"]
        scenes_per_second = num_done / max(time.perf_counter() - self._begin, 1e-3)
        note = (
            f"{num_done}/{self._total}, {scenes_per_second:.3g}/s, {self._counts['failed']} failed"
        )
        self._show_progress("", num_done / self._total, note)
        if self._page is not None and num_done:
            self._page.refresh(num_done)

    def _log(self, event: str, values: Json) -> None:
        if event == "end":
            values = {**values, "seconds": round(time.perf_counter() - self._begin, 3)}
        line = run.describe_event(event, values)
        for write_line in self._line_writers:
            write_line(line)

    def interrupt(self, error: BaseException) -> None:
        """Log that the batch ended early, by a signal or an error."""
        reason = str(error) if isinstance(error, Exception) else "interrupted"
        if self._total and reason == "interrupted" and not self._as_json:
            counts = _describe_counts(self._counts)
            say_unless_quiet(f"interrupted: {counts}; the same command goes on")
        with suppress(OSError, NavbakeError):  # the first error counts
            self._log("end", {**self._counts, "stopped": reason})
            if self._page is not None:
                page.write_page(self._folder)

    def end(self, result: run.BatchResult, file_names: list[str]) -> None:
        """Print the result, and the names of the files that were written."""
        self._counts = {
            "baked": result.count("ok") - result.num_skipped,
            "skipped": result.num_skipped,
            "failed": result.count("failed"),
            "left": result.count("left"),
        }
        try:
            self._log("end", {**self._counts, "stopped": result.stop_reason})
        except NavbakeError as error:  # of the log; the result is printed anyway
            if self._as_json:
                print_error(str(error))
            result.stop_reason = result.stop_reason or str(error)
        seconds = time.perf_counter() - self._begin
        if self._has_page:
            draw_missing_thumbnails(self._folder)
            try:
                page.write_page(self._folder)
                file_names = [*file_names, page.PAGE_NAME]
            except NavbakeError as error:
                print_warnings([str(error)])
        if self._as_json:
            return
        if result.stop_reason:
            print_error(f"stopped: {result.stop_reason}")
        num_warned = sum(bool(row.get("warnings")) for row in result.rows)
        warnings_text = f", {num_warned} with warnings" if num_warned else ""
        files_text = ", ".join(
            store.without_secrets(os.path.join(self._folder, name)) for name in file_names
        )
        shown_counts = dict(self._counts)
        if self._only_merge:  # slices baked them
            shown_counts = {"merged": shown_counts.pop("skipped")} | shown_counts
        counts_text = _describe_counts(shown_counts)
        say_unless_quiet(f"{counts_text}{warnings_text} in {seconds:.1f} s: {files_text}")
        if self._removed_names:
            names_text = ", ".join(sorted(self._removed_names))
            scenes_text = count_of(max(self._removed_names.values()), "scene")
            say_unless_quiet(f"removed, as no --make asks for them: {names_text} of {scenes_text}")
        cost = run.measure_cost(result.rows)
        if cost:
            times = cost["seconds"]
            size_texts = {key: filesize.decimal(count) for key, count in cost["bytes"].items()}
            say_unless_quiet(
                f"a scene: {times['median']:.2g} s (90%: {times['p90']:.2g}, longest "
                f"{times['max']:.2g}), {size_texts['median']} (90%: {size_texts['p90']}, largest "
                f"{size_texts['max']}); all: {times['sum']:.3g} s, {size_texts['sum']}"
            )


def _describe_counts(counts: Json) -> str:
    """Return numbers of scenes as text: name of an outcome -> number of scenes."""
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "no scene"


def draw_missing_thumbnails(folder: store.Folder) -> None:
    """Draw the missing thumbnails of a batch's page; print a warning if some can't be drawn."""
    try:
        with printing.show_progress_bars("page", VERBOSITY.quiet) as show_progress:
            num_missing = page.draw_thumbnails(
                folder, lambda share: show_progress("thumbnails", share)
            )
    except store.DiskFullError as error:
        print_warnings([str(error)])
    else:
        if num_missing:
            print_warnings([f"{num_missing} thumbnails can't be made of their grids"])


def warm_up() -> None:
    """Compile all kernels for this machine, once.

    It takes a minute or two. Without it, the first bake and the first query compile what they use.
    In a container, set NUMBA_CACHE_DIR to a folder for the compiled code.

    Example: navbake warm-up
    """
    from navbake import compiled  # loads numba

    if compiled.cache_folder() is None:
        problem = "no folder for compiled code can be written, so nothing can be kept"
        print_warnings([f"{problem}: {compiled.CACHE_REMEDY}"])
        add_facts(compiled=False, folder=None)
        return
    uncompiled_names = compiled.warm_up()
    add_facts(compiled=not uncompiled_names, folder=str(compiled.cache_folder()))
    if uncompiled_names:
        print_warnings([f"not compiled, or not kept: {', '.join(uncompiled_names)}"])
    else:
        say_unless_quiet("compiled: bakes and queries start at once from now on")
