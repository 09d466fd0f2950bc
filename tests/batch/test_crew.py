"""Workers: a job that hangs, crashes or takes too much costs itself alone."""

from __future__ import annotations

import errno
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess

import pytest

import crew_jobs
from navbake import files
from navbake.batch import crew
from navbake.batch.crew import (
    AGAIN,
    BEGUN,
    CRASHED,
    DONE,
    LOST,
    READY,
    TOO_LARGE,
    TOO_LONG,
    JobLimits,
    do_jobs,
)
from navbake.errors import NavbakeError
from navbake.files import remove_abandoned
from project_paths import ROOT

linux = pytest.mark.skipif(sys.platform != "linux", reason="how Linux ends and limits processes")


def run(jobs, count=1, **options):
    """How each job ended, in the jobs' order."""
    ended = sorted(do_jobs(jobs, crew_jobs.work, count, **options))
    assert [end.number for end in ended] == list(range(len(jobs)))
    return [(end.how, end.value) for end in ended]


class Clock:
    """A crew's time, which stands but for what a test says: so no load of the machine matters."""

    def __init__(self):
        self.now = 0.0
        self.passes = 0.0  # while the crew waits the next times [s]
        self.stops = 0.0  # for which the next wait that is in vain takes longer than it was to [s]
        self.connections = []  # for which it waited last
        self.sleep = time.sleep

    def monotonic(self):
        return self.now

    def wait(self, connections, timeout):
        self.connections = connections
        if self.passes:
            step = min(self.passes, timeout or self.passes)
            self.now, self.passes = self.now + step, self.passes - step
            return []
        if self.stops:
            self.now, self.stops = self.now + timeout + self.stops, 0.0
            return []
        return wait(connections, 0.0 if timeout == 0.0 else None)

    def let_pass(self, times):
        """Returns what hears of events, and lets time pass after jobs begin; times by job."""

        def hear(event):
            if event.what == BEGUN:
                self.passes = times.get(event.number, 0.0)

        return hear


@pytest.fixture
def clock(monkeypatch):
    """The clock of all crews."""
    clock = Clock()
    monkeypatch.setattr(crew, "time", clock)
    monkeypatch.setattr(crew, "wait", clock.wait)
    return clock


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
    assert run([("double", k) for k in range(20)], 3) == [(DONE, 2 * k) for k in range(20)]
    for name in "ab":
        (tmp_path / name).mkdir()
    pids = {value for _, value in run([("meet", (tmp_path / name, 2)) for name in "aabb"], 2)}
    assert len(pids) == 2 and os.getpid() not in pids
    assert run([]) == []


@linux
def test_what_ends_a_worker_costs_its_job_alone(clock):
    jobs = [
        ("sleep", 60),  # all that time the other worker does the rest
        ("double", 1),
        ("kill", signal.SIGSEGV),
        ("double", 2),
        ("exit", 7),
        ("raise", "bad value"),
        ("double", 3),
        ("print", None),
    ]
    ended = {}
    for end in do_jobs(jobs, crew_jobs.work, 2, limits=JobLimits(seconds=1.5)):
        assert end.number not in ended
        ended[end.number] = end.how, end.value
        clock.now += 1.6 * (len(ended) == len(jobs) - 1)
    assert [ended[k] for k in (1, 3, 6)] == [(DONE, 2), (DONE, 4), (DONE, 6)]
    assert ended[2] == (CRASHED, "its process ended by SIGSEGV")
    assert ended[4] == (
        CRASHED,
        "its process ended with exit status 7: no such thing: qh6154",
    )
    assert ended[5] == (CRASHED, "ValueError: bad value")
    assert ended[0] == (TOO_LONG, "it took more than 1.5 s")
    assert ended[7][0] == DONE  # there is nothing to read


@linux
def test_memory_is_limited_beyond_what_a_worker_starts_with(capfd):
    jobs = [("take", 1 << 20), ("take", 1 << 30), ("take", 1 << 21), ("print", None)]
    ended = run(jobs, limits=JobLimits(memory=0.25))
    assert ended[0] == (DONE, 1 << 20) and ended[2] == (DONE, 1 << 21)
    assert ended[1] == (TOO_LARGE, "it took more memory than 0.25 GiB")
    assert capfd.readouterr() == ("", "")


def test_a_job_is_blamed_only_where_its_worker_had_done_no_other():
    ended = run([("double", 1), ("if alone", None), ("double", 2)])
    assert [how for how, _ in ended] == [DONE, DONE, DONE]


def test_a_job_is_tried_again_as_often_as_asked(tmp_path):
    job = ("once", str(tmp_path / "tried"))
    assert run([job])[0][0] == CRASHED
    (tmp_path / "tried").unlink()
    assert run([job], retries=1)[0][0] == DONE
    begin = time.monotonic()
    assert run([("sleep", 60)], limits=JobLimits(seconds=0.3), retries=2)[0][0] == TOO_LONG
    assert time.monotonic() - begin > 0.9


def test_events_tell_of_workers_that_start_and_are_lost_and_of_jobs_that_begin_again():
    events = []
    jobs = [("double", 1), ("raise", "no")]
    run(jobs, retries=1, on_event=events.append)
    why = "ValueError: no"
    assert [(e.what, e.worker, e.number, e.how, e.why) for e in events] == [
        (READY, 1, None, "", ""),
        (BEGUN, 1, 0, "", ""),
        (BEGUN, 1, 1, "", ""),
        (LOST, 1, 1, CRASHED, why),  # its worker had done another job
        (AGAIN, 1, 1, CRASHED, why),
        (READY, 2, None, "", ""),
        (BEGUN, 2, 1, "", ""),
        (LOST, 2, 1, CRASHED, why),
        (AGAIN, 2, 1, CRASHED, why),
        (READY, 3, None, "", ""),
        (BEGUN, 3, 1, "", ""),
        (LOST, 3, 1, CRASHED, why),
    ]
    assert all(e.seconds > 0 for e in events if e.what != BEGUN)


def test_a_limit_shorter_than_the_start_of_a_worker_is_one_of_the_job(clock):
    events = []
    clock.passes = 30.0  # while it starts
    limits = JobLimits(seconds=0.2)
    assert run([("double", 1)], limits=limits, on_event=events.append)[0] == (DONE, 2)
    assert [(event.what, event.seconds) for event in events] == [(READY, 30.0), (BEGUN, 0.0)]


def test_after_a_short_job_the_next_but_one_does_not_wait_for_the_parent(tmp_path, clock):
    jobs = [("touch", str(tmp_path / f"{number}")) for number in range(6)]
    ended = do_jobs(jobs, crew_jobs.work, 1)
    assert [next(ended).number, next(ended).number] == [0, 1]
    wait_until(lambda: len(list(tmp_path.iterdir())) >= 3)
    assert {path.name for path in tmp_path.iterdir()} == {"0", "1", "2"}
    assert [end.number for end in ended] == [2, 3, 4, 5]


@linux
@pytest.mark.parametrize(
    ("fault", "how", "times"),
    [(("sleep", 60), TOO_LONG, {3: 2.1}), (("kill", signal.SIGSEGV), CRASHED, {})],
)
def test_a_job_given_ahead_pays_for_none_before_it(clock, fault, how, times):
    before = [("double", number) for number in range(3)]
    jobs = [*before, fault, ("double", 0), *before, ("size", b"0" * 10_000_000), *before]
    times = {**times, 4: 1.2, 6: 1.2, 7: 1.2}
    ended = run(jobs, limits=JobLimits(seconds=2.0), on_event=clock.let_pass(times))
    assert clock.now == pytest.approx(sum(times.values()))
    assert [number for number, end in enumerate(ended) if end[0] != DONE] == [3]
    assert ended[3][0] == how and ended[8] == (DONE, 10_000_000)


@linux
def test_a_large_job_waits_where_its_worker_might_not_read_it(clock):
    jobs = [("double", 1), ("double", 2), ("sleep", 60), ("size", b"0" * 10_000_000)]
    begin = time.monotonic()
    options = {"limits": JobLimits(seconds=1.0), "on_event": clock.let_pass({2: 1.1})}
    ended = run([*jobs, *jobs[:2]], **options)
    assert [how for how, _ in ended] == [DONE, DONE, TOO_LONG, DONE, DONE, DONE]
    assert time.monotonic() - begin < 60  # as nobody waited until it was read


def test_a_job_that_was_done_while_nobody_looked_is_done(clock, tmp_path):
    jobs = [("meet", (tmp_path, 2))] * 2
    ended = do_jobs(jobs, crew_jobs.work, 2, limits=JobLimits(seconds=1.5))
    first = next(ended)
    assert wait(clock.connections, crew_jobs.PATIENCE)  # the other one has answered
    clock.now += 1.6
    (second,) = ended
    assert (first.how, second.how, clock.now) == (DONE, DONE, 1.6)


def test_time_in_which_all_is_stopped_does_not_count(clock):
    def hear(event):
        if event.what == BEGUN:
            clock.stops = 100.0

    (ended,) = do_jobs([("double", 1)], crew_jobs.work, 1, limits=JobLimits(10.0), on_event=hear)
    assert (ended.how, ended.value) == (DONE, 2)
    assert clock.now > 100.0 and ended.seconds < 10.0


def test_a_wait_that_takes_a_little_longer_than_it_was_to_counts(clock):
    def hear(event):
        clock.stops = crew.LATE / 2 if event.what == BEGUN else 0.0

    (ended,) = do_jobs([("double", 1)], crew_jobs.work, 1, on_event=hear)
    assert ended.seconds == clock.now == crew.TICK + crew.LATE / 2


@pytest.mark.parametrize("seconds", [1e7, float("inf")])
def test_a_limit_may_be_longer_than_the_system_waits(seconds):
    assert run([("double", 1)], limits=JobLimits(seconds, memory=seconds)) == [(DONE, 2)]


def test_a_worker_that_dies_while_idle_is_replaced():
    pids = []
    for end in do_jobs([("sleep", 0)] * 3, crew_jobs.work, 1):
        [worker] = [each for each in multiprocessing.active_children() if each.pid == end.value]
        worker.kill()
        worker.join()
        pids.append(end.value)
    assert len(set(pids)) == len(pids) == 3


@pytest.mark.parametrize(
    ("prepare", "why"),
    [(crew_jobs.refuse, "RuntimeError: no library"), (crew_jobs.end, "ended by SIGKILL")],
)
def test_workers_that_do_not_start_are_one_error(prepare, why, capfd):
    with pytest.raises(NavbakeError, match=f"cannot start a worker process: .*{why}"):
        list(do_jobs([("double", 1)], crew_jobs.work, 2, prepare=prepare))
    assert capfd.readouterr() == ("", "")


def test_the_system_may_refuse_more_workers_while_others_work(tmp_path, monkeypatch):
    start, started = SpawnProcess.start, []
    both, refused = tmp_path / "both", tmp_path / "refused"
    both.mkdir()
    refused.mkdir()

    def refuse(process):
        started.append(process)
        if len(started) > 2:
            (refused / "yes").touch()
            raise OSError(errno.EMFILE, "Too many open files")
        start(process)

    monkeypatch.setattr(SpawnProcess, "start", refuse)
    meet, wait_for_it = ("meet", (both, 2)), ("meet", (refused, 2))
    jobs = [("both", [meet, ("exit", 1)]), ("both", [meet, wait_for_it]), *[("double", 1)] * 5]
    ended = run(jobs, 2)
    assert [how for how, _ in ended] == [CRASHED, *[DONE] * 6]


def test_workers_are_gone_when_the_jobs_are_left():
    ended = do_jobs([("sleep", 0), ("sleep", 60)], crew_jobs.work, 1)
    pid = next(ended).value
    assert is_there(pid)
    ended.close()
    assert not is_there(pid)


@linux
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_workers_are_gone_when_the_parent_is(number, tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys\n"
        f"sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / 'tests')!r}]\n"
        "import crew_jobs\n"
        "from navbake.batch.crew import do_jobs\n"
        "if __name__ == '__main__':\n"
        "    for end in do_jobs([('sleep', 0), ('sleep', 60)], crew_jobs.work, 1):\n"
        "        print(end.value, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, script], stdout=-1, stderr=-1, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.send_signal(number)
        parent.wait(crew_jobs.PATIENCE)
    wait_until(lambda: not is_there(pid))


def framed(answer):
    """An answer as a worker's connection sends it."""
    packed = pickle.dumps(answer)
    return len(packed).to_bytes(4, "big") + packed


@pytest.mark.skipif(os.name != "posix", reason="what the ends of a connection are")
@pytest.mark.parametrize(
    ("message", "why"),
    [
        (b"\0\0\0\x04\x80\x05ab", "what it answered can't be read: "),  # no pickle
        (b"\0\0\0\x09ab", "its process ended by SIGKILL"),  # cut off
        (b"\0\0\0\x02N.", "what it answered can't be read: TypeError"),  # None
        (framed(("odd", 1)), "it answered 'odd'"),
    ],
    ids=["no pickle", "cut off", "None", "unknown"],
)
def test_an_answer_that_can_not_be_read_costs_its_job_alone(message, why):
    jobs = [("double", 1), ("garble", message), ("double", 2)]
    (first, garbled, last) = run(jobs)
    assert (first, last) == ((DONE, 2), (DONE, 4))
    assert garbled[0] == CRASHED and garbled[1].startswith(why)


def test_workers_that_end_before_they_begin_a_job_are_one_error():
    events = []
    why = "worker processes end before they begin a scene: its process ended by SIGKILL"
    with pytest.raises(NavbakeError, match=why):
        run([("double", 1)] * 3, 2, prepare=crew_jobs.end_when_ready, on_event=events.append)
    assert sum(event.what == LOST for event in events) == 3


@pytest.mark.skipif(files.fcntl is None, reason="nothing can be locked")
def test_nothing_stays_of_a_crew_that_is_killed_while_workers_start(tmp_path, monkeypatch):
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, signal, sys\n"
        f"sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / 'tests')!r}]\n"
        "from navbake.batch import crew\n"
        "if __name__ == '__main__':\n"
        "    crew._Crew._heard = lambda self: os.kill(os.getpid(), signal.SIGKILL)\n"
        "    list(crew.do_jobs([1], print, 1))\n"
    )
    place = tmp_path / "tmp"
    place.mkdir()
    environment = {**os.environ, "TMPDIR": str(place)}
    assert subprocess.run([sys.executable, script], env=environment, timeout=60).returncode == -9
    (left,) = os.listdir(place)
    with files.create_temporary(place)[0]:  # of a worker that starts
        remove_abandoned(place)
        assert len(os.listdir(place)) == 1 and left not in os.listdir(place)
