"""The commands `navbake batch` and `warm-up`."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from typer import BadParameter, Exit

from navbake.cli import options, printing
from navbake.cli.options import OUTPUT, STDOUT, Overrides, argument, flag, option
from navbake.cli.printing import VOLUME, print_error, print_warnings, say, say_unless_quiet
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

INDEX = "index.jsonl"
MOST_NAMED = 5  # scenes that a line of --plan names


def batch(
    sources: list[str] = argument(
        "SOURCE",
        "Scenes or settings (YAML), patterns in quotes, or lists: .txt, .csv, .jsonl, also with "
        ".gz, or .parquet; paths or URLs such as s3://.",
    ),
    output: str = option(
        "FOLDER", "Folder to write into, with a folder of each scene.", *OUTPUT, default=...
    ),
    config: str | None = option("YAML", "Settings that all scenes share."),
    make: list[str] | None = option(
        "WHAT",
        "What to make of each scene, too: inflated:RADIUS[:CLEARANCE], nav2[:RADIUS], report, "
        "voxels:EDGE[:ENDING], picture[:LAYER...], episodes:TASK[:SAMPLER[:COUNT[:SEED]]]. May be "
        "repeated.",
    ),
    column: list[str] | None = option(
        "NAME=COLUMN",
        "A list's column for scene, config, id or a setting; all others are then ignored. May be "
        "repeated.",
    ),
    allow_hosts: list[str] | None = option(
        "HOST", "Another host of the web to which lists and settings may lead. May be repeated."
    ),
    overrides: Overrides = None,
    count: int | None = option(
        "N", "Worker processes: 1 unless given, on a cluster one a CPU.", "-j", "--jobs", min=1
    ),
    max_failures: int | None = option("N", "Stop when more than N scenes failed.", min=0),
    as_json: bool = flag("--json", "Print what happens as lines of JSON, as --log writes them."),
    log: Path | None = option("FILE", "Add what happens to a file, a line of JSON each."),
    has_page: bool = flag(
        "--page", "Write FOLDER/index.html: all scenes, their failures and times."
    ),
    parquet: bool = flag("--parquet", "Write the index as index.parquet as well."),
    time_limit: float | None = option("SECONDS", "How long a scene may take [s].", min=0.001),
    memory_limit: float | None = option(
        "GIB",
        "Memory that a scene may take beyond what its process starts with, on Linux [GiB].",
        min=0.01,
    ),
    retries: int = option("N", "How often a crash or a limit is tried again.", default=0, min=0),
    preview: bool = flag("--plan", "Bake nothing: say what would be baked, why, and its size."),
    piece: str | None = option("K/N", "Every N-th scene from the K-th; then --merge.", "--slice"),
    merge: bool = flag("--merge", "Bake nothing: merge the indexes of slices into one."),
    shards: int | None = option("N", "Pack the scenes into N tar files (WebDataset).", min=1),
    executor: Literal["embedded", "ray"] = option(
        "embedded|ray", "Run workers on this machine, or on a Ray cluster.", default="embedded"
    ),
    ray_address: str | None = option(
        "ADDRESS", "Of the Ray cluster; local starts one here.  [default: RAY_ADDRESS, else local]"
    ),
) -> None:
    """Bake many scenes in several processes.

    Scenes that are done already are skipped, and failures don't affect other scenes. The outcome of
    each scene is in FOLDER/index.jsonl. The exit status is 1 if any failed.

    Example: navbake batch "scenes/*.xml" -o grids --jobs 8 --time-limit 300
    """
    is_ray = executor == "ray"
    part = _read_slice(piece)
    whole = "the whole batch, as with --merge"
    options.refuse_unused(
        ("--ray-address", ray_address is not None, is_ray, "--executor ray"),
        ("--merge", merge, part is None, "all slices"),
        ("--page", has_page, part is None, whole),
        ("--parquet", parquet, part is None, whole),
        ("--shards", shards is not None, part is None, whole),
    )
    if not output:
        raise BadParameter("expected a folder, got nothing: . is the current one", param_hint="-o")
    if log == STDOUT:
        raise BadParameter("expected a file, got -: --json prints the same", param_hint="--log")
    hosts = tuple(allow_hosts or ())
    store.allow_hosts(hosts)
    jobs = scenes.list_jobs(sources, options.read_pairs(column, "--column", "NAME=COLUMN"))
    if log is not None:
        own = (os.path.join(output, name) for name in (index.NAME, page.NAME, index.TABLE))
        given = (*sources, *filter(None, [config]), *(each.source for each in jobs), *own)
        inputs = map(Path, given)
        options.check_output(log, inputs=inputs, may_make_folder=True, option="--log")
    settings = {} if config is None else scenes.read_shared(config)
    folder = store.as_folder(output)
    made = products.parse_products(make or [])
    witness = folder / index.LOCK if isinstance(folder, Path) else None
    on_ray = partial(workers.do_on_ray, address=ray_address, witness=witness)
    given = tuple(overrides or [])
    plan = job.Plan(folder, settings, given, made, has_page, parquet, hosts)
    if preview:
        _print_preview(plan, jobs[part.number - 1 :: part.total] if part else jobs, as_json)
        return
    names = [part.file if part else index.NAME, *[index.TABLE] * parquet]
    names += ["shard-*.tar"] if shards else []
    with ExitStack() as stack:
        watch = _Watch(stack, folder, as_json=as_json, log=log, has_page=has_page)
        try:
            result = run.run_batch(
                plan,
                jobs,
                watch,
                workers=count,
                limits=workers.JobLimits(time_limit, memory_limit, retries),
                max_failures=max_failures,
                executor=on_ray if is_ray else None,
                part=part,
                only_merge=merge,
                shards=shards,
            )
        except BaseException as error:
            watch.interrupt(error)
            raise
        watch.end(result, names)
    if result.count("failed") or result.stopped:
        raise Exit(1)


def _read_slice(text: str | None) -> index.Slice | None:
    if text is None:
        return None
    number, _, total = text.partition("/")
    if not (number.isdecimal() and total.isdecimal() and 1 <= int(number) <= int(total)):
        message = f"expected K/N with K from 1 to N, as 3/64, got {text!r}"
        raise BadParameter(message, param_hint="--slice")
    return index.Slice(int(number), int(total))


def _print_preview(plan: job.Plan, jobs: list[scenes.Job], as_json: bool) -> None:
    """Print what a batch would bake: a line for each reason, or of JSON for each scene."""
    found = run.preview(plan, jobs)
    if as_json:
        for scene in found:
            printing.print_json_line(scene)
        return
    by_why: dict[str, list[Json]] = {}
    for scene in found:
        kind = scene["why"].partition(":")[0]
        by_why.setdefault("equal" if kind.startswith("equal to ") else kind, []).append(scene)
    for kind, own in by_why.items():
        some = [
            scene["id"] + (f" ({scene['why'].removeprefix(f'{kind}: ')})" * (kind != scene["why"]))
            for scene in own[: 0 if kind == run.DONE_BEFORE else MOST_NAMED]
        ]
        more = [f"{len(own) - len(some)} more"] if some and own[len(some) :] else []
        names = f": {', '.join([*some, *more])}" if some else ""
        size = filesize.decimal(sum(scene["bytes"] for scene in own))
        say(f"{kind}: {count_of(len(own), 'scene')}, {size}{names}")
    unbaked = run.DONE_BEFORE, run.BROKEN
    baked = [scene for kind, some in by_why.items() for scene in some if kind not in unbaked]
    copied = len(by_why.get("equal", ()))
    line = f"{len(baked) - copied} of {count_of(len(found), 'scene')} would be baked"
    line += f", and {copied} copied" if copied else ""
    cost = run.measure_cost(index.read_index(plan.folder).values())
    if cost is not None and len(baked) > copied:
        share = (len(baked) - copied) / cost["scenes"]
        seconds = cost["seconds"]["sum"] * share
        size = filesize.decimal(int(cost["bytes"]["sum"] * share))
        line += f", by those done here in about {seconds:.3g} s of a worker, into {size}"
    say(line)


class _Watch:
    """Shows a batch's progress, as lines of JSON or a bar with failures, and writes its page."""

    def __init__(
        self,
        stack: ExitStack,
        folder: store.Folder,
        *,
        as_json: bool,
        log: Path | None,
        has_page: bool,
    ) -> None:
        self._stack = stack
        self._folder = folder
        self._as_json = as_json
        self._has_page = has_page
        printers: Any = [printing.print_json_line]
        self._takers: list[Callable[[Json], None]] = printers if as_json else []
        if log is not None:
            lines = index.LineFile(log, f"the log {log}")
            stack.callback(lines.close)
            self._takers.append(lines.add)
        self._begin = time.perf_counter()
        self._counts = {"baked": 0, "skipped": 0, "failed": 0, "left": 0}
        self._total = 0
        self._show: Callable[..., None] = lambda *given: None
        self._page: page.LivePage | None = None

    def __call__(self, event: str, values: Json) -> None:
        """Handle an event."""
        counts = self._counts
        if event == "begin":
            from navbake import compiled  # loads numba

            if compiled.cache_folder() is None:
                lost = "no folder for compiled code can be written: each worker compiles its own"
                print_warnings([f"{lost}: {compiled.REMEDY}"])
            compiled.ensure_compiled()  # once for all workers
            counts["skipped"] = values["skipped"]
            self._total = counts["left"] = values["scenes"] - values["skipped"]
        self._log(event, values)
        if event == "begin":
            self._page = page.LivePage(self._folder, self._total) if self._has_page else None
            # on a terminal, lines and a bar would mix
            is_mixed = self._as_json and printing.is_terminal(sys.stdout)
            bars = printing.progress_bars("batch", VOLUME.quiet or is_mixed)
            self._show = self._stack.enter_context(bars)
        if event == "scene":
            counts["failed" if values["status"] == "failed" else "baked"] += 1
            counts["left"] -= 1
            if values["status"] == "failed" and not self._as_json:
                print_error(f"{values['id']}: {values['how']}: {values['error']}")
        if event in ("begin", "scene"):
            done = self._total - counts["left"]
            rate = done / max(time.perf_counter() - self._begin, 1e-3)
            note = f"{done}/{self._total}, {rate:.3g}/s, {counts['failed']} failed"
            self._show("", done / self._total, note)
            if self._page is not None and done:
                self._page.refresh(done)

    def _log(self, event: str, values: Json) -> None:
        if event == "end":
            values = {**values, "seconds": round(time.perf_counter() - self._begin, 3)}
        line = run.line_of_event(event, values)
        for take in self._takers:
            take(line)

    def interrupt(self, error: BaseException) -> None:
        """Log that the batch ended early, by a signal or an error."""
        why = str(error) if isinstance(error, Exception) else "interrupted"
        if self._total and why == "interrupted" and not self._as_json:
            say_unless_quiet(f"interrupted: {_in_words(self._counts)}; the same command goes on")
        with suppress(OSError, NavbakeError):  # the first error counts
            self._log("end", {**self._counts, "stopped": why})
            if self._page is not None:
                page.write_page(self._folder)

    def end(self, result: run.BatchResult, names: list[str]) -> None:
        """Print the result, and the names of the files that were written."""
        baked, failed, left = map(result.count, ("ok", "failed", "left"))
        self._counts = {"baked": baked - result.skipped, "skipped": result.skipped}
        self._counts |= {"failed": failed, "left": left}
        try:
            self._log("end", {**self._counts, "stopped": result.stopped})
        except NavbakeError as error:  # of the log; the result is printed anyway
            if self._as_json:
                print_error(str(error))
            result.stopped = result.stopped or str(error)
        seconds = time.perf_counter() - self._begin
        if self._has_page:
            draw_missing_thumbnails(self._folder)
            try:
                page.write_page(self._folder)
                names = [*names, page.NAME]
            except NavbakeError as error:
                print_warnings([str(error)])
        if self._as_json:
            return
        if result.stopped:
            print_error(f"stopped: {result.stopped}")
        warned = sum(bool(row.get("warnings")) for row in result.rows)
        notes = f", {warned} with warnings" if warned else ""
        files = ", ".join(store.shown(os.path.join(self._folder, name)) for name in names)
        say_unless_quiet(f"{_in_words(self._counts)}{notes} in {seconds:.1f} s: {files}")
        if cost := run.measure_cost(result.rows):
            times = cost["seconds"]
            sizes = {key: filesize.decimal(count) for key, count in cost["bytes"].items()}
            say_unless_quiet(
                f"a scene: {times['median']:.2g} s (90%: {times['p90']:.2g}, longest "
                f"{times['max']:.2g}), {sizes['median']} (90%: {sizes['p90']}, largest "
                f"{sizes['max']}); all: {times['sum']:.3g} s, {sizes['sum']}"
            )


def _in_words(counts: Json) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "no scene"


def draw_missing_thumbnails(folder: store.Folder) -> None:
    """Draw the missing thumbnails of a batch's page."""
    try:
        with printing.progress_bars("page", VOLUME.quiet) as show:
            lacking = page.draw_thumbnails(folder, lambda share: show("thumbnails", share))
    except store.FullError as error:
        print_warnings([str(error)])
    else:
        if lacking:
            print_warnings([f"{lacking} thumbnails can't be made of their grids"])


def warm_up() -> None:
    """Compile all kernels for this machine, once.

    It takes a minute or two. Without it, the first bake and the first query compile what they use.
    In a container, set NUMBA_CACHE_DIR to a folder for the compiled code.

    Example: navbake warm-up
    """
    from navbake import compiled  # loads numba

    if compiled.cache_folder() is None:
        lost = "no folder for compiled code can be written, so nothing can be kept"
        print_warnings([f"{lost}: {compiled.REMEDY}"])
        return
    cold = compiled.warm_up()
    if cold:
        print_warnings([f"not compiled, or not kept: {', '.join(cold)}"])
    else:
        say_unless_quiet("compiled: bakes and queries start at once from now on")
