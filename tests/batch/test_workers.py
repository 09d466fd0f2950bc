"""Workers: a job that hangs, crashes or takes too much costs itself alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

import crew_jobs
from navbake.batch import workers
from navbake.batch.workers import (
    CRASHED,
    DONE,
    RETRIED,
    SCENE_BEGUN,
    TOO_LARGE,
    TOO_LONG,
    JobLimits,
    Workers,
)
from navbake.errors import NavbakeError
from project_paths import ROOT

linux = pytest.mark.skipif(sys.platform != "linux", reason="how Linux ends and limits processes")


def run(jobs, count=1, **options):
    """How each job ended, in the jobs' order."""
    on_event = options.pop("on_event", lambda event, end: None)
    with Workers(crew_jobs.work, min(count, len(jobs)), **options) as workers:
        ended = sorted(workers.run(jobs, on_event))
    assert [end.number for end in ended] == list(range(len(jobs)))
    return [(end.how, end.result if end.how == DONE else end.reason) for end in ended]


def is_there(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until(is_so):
    end = time.monotonic() + crew_jobs.PATIENCE
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_all_jobs_are_done_by_as_many_workers_as_asked_for(tmp_path):
    meet = [("meet", (tmp_path, 2))] * 2
    ended = run([*meet, *(("double", k) for k in range(20))], 2)
    assert [how for how, _ in ended] == [DONE] * 22
    assert [value for _, value in ended[2:]] == [2 * k for k in range(20)]
    pids = {value for _, value in ended[:2]}
    assert len(pids) == 2 and os.getpid() not in pids
    assert run([]) == []


@linux
def test_what_ends_a_worker_costs_its_job_alone(capfd):
    jobs = [
        ("sleep", 60),
        ("double", 1),
        ("kill", signal.SIGSEGV),
        ("double", 2),
        ("exit", 7),
        ("raise", "bad value"),
        ("take", 1 << 30),
        ("take", 1 << 20),
        ("print", None),  # there is nothing to read
        ("if alone", None),  # another job may have been the cause
    ]
    events = []
    limits = JobLimits(seconds=2.0, memory=0.25)
    ended = run(jobs, 2, limits=limits, on_event=lambda event, end: events.append((event, end)))
    assert ended[0] == (TOO_LONG, "it took more than 2 s")
    assert [ended[k] for k in (1, 3, 7)] == [(DONE, 2), (DONE, 4), (DONE, 1 << 20)]
    assert ended[2] == (CRASHED, "its process ended by SIGSEGV")
    assert ended[4] == (CRASHED, "its process ended with exit status 7: no such thing: qh6154")
    assert ended[5] == (CRASHED, "ValueError: bad value")
    assert ended[6] == (TOO_LARGE, "it took more memory than 0.25 GiB")
    assert [how for how, _ in ended[8:]] == [DONE, DONE]
    out, err = capfd.readouterr()
    assert out == "" and "qh6154" not in err  # a worker that is ended while it starts may say so
    assert {end.number for event, end in events if event == SCENE_BEGUN} == {*range(len(jobs))}
    again = {end.number: (end.how, end.reason) for event, end in events if event == RETRIED}
    assert {2, 4, 5, 6} <= again.keys() <= {2, 4, 5, 6, 9} and again[4] == ended[4]


def test_a_job_is_tried_again_as_often_as_asked(tmp_path):
    job = ("once", str(tmp_path / "tried"))
    assert run([job])[0][0] == DONE  # it was not alone in its process
    events = []
    limits = JobLimits(seconds=0.3, retries=2)
    note = lambda event, end: events.append(event)  # noqa: E731
    assert run([("sleep", 60)], limits=limits, on_event=note)[0][0] == TOO_LONG
    assert events == [SCENE_BEGUN, RETRIED, SCENE_BEGUN, RETRIED, SCENE_BEGUN]


def test_time_in_which_all_is_stopped_does_not_count(monkeypatch):
    events = []

    def note(event, end):
        """Take each wait for one in which this process was stopped, until the second try."""
        events.append(event)
        monkeypatch.setattr(workers, "MAX_OVERSLEEP", -1.0 if len(events) < 2 else 60.0)

    limits = JobLimits(seconds=1.5)
    ended = run([("sleep", 60)], limits=limits, on_event=note)
    assert (
        ended[0][0] == TOO_LONG
        and events[:2] == [SCENE_BEGUN, SCENE_BEGUN]
        and RETRIED not in events
    )


@pytest.mark.parametrize("seconds", [1e7, float("inf")])
def test_a_limit_may_be_longer_than_the_system_waits(seconds):
    assert run([("double", 1)], limits=JobLimits(seconds, memory=seconds)) == [(DONE, 2)]


@pytest.mark.parametrize(
    ("prepare", "why"), [(crew_jobs.refuse, ": RuntimeError: no library"), (crew_jobs.end, "")]
)
def test_workers_that_do_not_start_are_one_error(prepare, why, capfd):
    with (
        Workers(crew_jobs.work, 1, prepare=prepare) as workers,
        pytest.raises(NavbakeError, match=f"^cannot start a worker process{why}$"),
    ):
        list(workers.run([("double", 1)]))
    assert capfd.readouterr() == ("", "")


def test_workers_are_gone_when_the_jobs_are_left():
    with Workers(crew_jobs.work, 1) as workers:
        pid = next(workers.run([("sleep", 0), ("sleep", 60)])).result
        assert is_there(pid)
    assert not is_there(pid)


class WatchedPool(workers.ProcessPool):
    """A pool that, before it is joined, waits until one child of this process is left."""

    def join(self, timeout=None):
        wait_until(lambda: len(multiprocessing.active_children()) == 1)
        super().join(timeout)


def test_workers_end_before_the_pool_closes_their_channels(monkeypatch):
    """Else a worker that is still starting finds them closed, which prints a traceback."""
    monkeypatch.setattr(workers, "ProcessPool", WatchedPool)
    bystander = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    bystander.start()
    try:
        with Workers(crew_jobs.work, 2) as crew:
            next(crew.run([("sleep", 0), ("sleep", 60)]))
        assert multiprocessing.active_children() == [bystander]
    finally:
        bystander.terminate()
        bystander.join()


class TerminatedPool(workers.ProcessPool):
    """A pool during whose start SIGTERM arrives."""

    has_started = False

    def schedule(self, *args, **kwargs):
        signal.raise_signal(signal.SIGTERM)
        future = super().schedule(*args, **kwargs)
        TerminatedPool.has_started = True
        return future


@linux
def test_sigterm_waits_until_the_workers_are_started(monkeypatch, capfd):
    """Else the pool doesn't know a worker that is being started, which prints a traceback."""

    def leave(signal_number, stack_frame):
        raise SystemExit(128 + signal_number)

    monkeypatch.setattr(workers, "ProcessPool", TerminatedPool)
    previous_handler = signal.signal(signal.SIGTERM, leave)
    try:
        with pytest.raises(SystemExit, match="143"), Workers(crew_jobs.work, 2) as crew:
            list(crew.run([("double", 1)]))
        assert TerminatedPool.has_started
        assert signal.getsignal(signal.SIGTERM) is leave
    finally:
        signal.signal(signal.SIGTERM, previous_handler)
    assert capfd.readouterr() == ("", "")


@linux
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_workers_are_gone_when_the_parent_is(number, tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys\n"
        f"sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / 'tests')!r}]\n"
        "import crew_jobs\n"
        "from navbake.batch.workers import Workers\n"
        "if __name__ == '__main__':\n"
        "    with Workers(crew_jobs.work, 1) as workers:\n"
        "        for end in workers.run([('sleep', 0), ('sleep', 60)]):\n"
        "            print(end.result, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, script], stdout=-1, stderr=-1, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.send_signal(number)
        parent.wait(crew_jobs.PATIENCE)
    wait_until(lambda: not is_there(pid))
