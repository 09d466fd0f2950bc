"""Batches whose jobs are done in the tests' own process, and what notes what they tell."""

from __future__ import annotations

import pickle

from navbake.batch import batch as module
from navbake.batch.crew import DONE, Ended


class Told:
    """Notes the rows of the scenes that a batch bakes."""

    def __init__(self):
        self.rows = []

    def begin(self, total, skipped):
        pass

    def hear(self, event, scene):
        pass

    def end_scene(self, row):
        self.rows.append(row)


def stay_in_process(monkeypatch, after=lambda: None):
    """Let batches do their jobs here, one after another, and as packed as for a worker.

    Args:
        after: is called when the batch has taken what became of a job.
    """

    def do_jobs(jobs, work, count, **options):
        for number, job in enumerate(jobs):
            yield Ended(number, DONE, work(pickle.loads(pickle.dumps(job))), 0.0)
            after()

    monkeypatch.setattr(module, "do_jobs", do_jobs)
