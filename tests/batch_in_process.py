"""Runs batches from tests, and lets them do their jobs in the tests' own process."""

from __future__ import annotations

import pickle
import time

from navbake.batch import run as module
from navbake.batch.job import Plan, inspect_scenes
from navbake.batch.products import parse_products
from navbake.batch.run import run_batch
from navbake.batch.scenes import Job, list_jobs
from navbake.batch.store import as_folder
from navbake.batch.workers import DONE, JobEnd


class Told:
    """Notes the rows of the scenes that a batch bakes."""

    def __init__(self):
        self.rows = []

    def __call__(self, event, values):
        if event == "scene":
            self.rows.append(values)


def run_sources(*sources, settings, out="out", products=(), **options):
    """Run a batch; the ids of what it baked, and its result.

    Args:
        sources: what names its scenes.
        products: what to make of each scene, as text.
        options: more of the `Plan` and of `run_batch`.
    """
    told = Told()
    of_plan = {key: options.pop(key) for key in Plan._fields if key in options}
    plan = Plan(as_folder(out), settings, products=parse_products(products), **of_plan)
    result = run_batch(plan, list_jobs(sources), told, **options)
    return [row["id"] for row in told.rows], result


def stay_in_process(monkeypatch, after=lambda: None):
    """Let batches do their jobs here, one after another, and as packed as for a worker.

    Args:
        after: is called when the batch has taken what became of a scene's job.
    """

    class WorkersHere:
        def __init__(self, work, count, **options):
            self.work = work

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def run(self, jobs, on_event=None):
            for number, job in enumerate(jobs):
                yield JobEnd(number, DONE, result=self.work(pickle.loads(pickle.dumps(job))))
                if isinstance(job, Job):  # groups of scenes are only inspected
                    after()

    monkeypatch.setattr(module, "Workers", WorkersHere)


def inspect_for_ever(plan, jobs):
    """Take for ever at scenes named ``endless``; else do as `job.inspect_scenes`."""
    if any(job.id == "endless" for job in jobs):
        time.sleep(3600)
    return inspect_scenes(plan, jobs)
