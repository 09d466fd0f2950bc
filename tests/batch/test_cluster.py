"""What is asked of the actors of a cluster, and what becomes of jobs when they are lost.

A stand-in for Ray answers; `test_ray.py` runs Ray itself.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from concurrent.futures import Future
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from navbake.batch.cluster import executor
from navbake.batch.cluster.connection import connected
from navbake.batch.cluster.executor import ALL, CodeHandover, RayExecutor
from navbake.batch.cluster.slot import Settled, Slot, Terms
from navbake.batch.crew import AGAIN, BEGUN, CRASHED, DONE, LOST, READY, Ended, JobLimits
from navbake.errors import MissingDependencyError, NavbakeError

HOSTS = "ab"  # of the stand-in's nodes; actors are spread over them


class LostError(Exception):
    """Ray's error of an actor that is lost."""


class StandIn:
    """Ray, as far as the executor calls it; actors answer as `answer` says."""

    exceptions = SimpleNamespace(RayError=LostError)

    def __init__(self, answer, cpus=2):
        self.answer, self.cpus = answer, cpus
        self.actors, self.calls, self.killed = [], [], []

    def cluster_resources(self):
        return {"CPU": float(self.cpus)} if self.cpus else {}

    def put(self, value):
        return value

    def kill(self, actor, no_restart):
        self.killed.append(actor)
        for future in actor.waiting:
            if not future.done():
                future.set_exception(LostError("it was killed"))

    def remote(self, **options):
        return lambda cls: self

    def options(self, **options):
        return SimpleNamespace(remote=self.start)

    def start(self, terms):
        self.actors.append(Actor(self, len(self.actors)))
        return self.actors[-1]


class Actor:
    """An actor; it answers at once, or never where the answer is `...`."""

    def __init__(self, ray, number):
        self.ray, self.number, self.waiting = ray, number, []
        self.host = HOSTS[number % len(HOSTS)]

    def __getattr__(self, method):
        return SimpleNamespace(remote=lambda *arguments: self.ask(method, arguments))

    def ask(self, method, arguments):
        self.ray.calls.append((self.host, method))
        future = Future()
        try:
            answer = self.ray.answer(self, method, *arguments)
            if answer is ...:
                self.waiting.append(future)
            else:
                future.set_result(answer)
        except LostError as error:
            future.set_exception(error)
        return SimpleNamespace(future=lambda: future)


def behave(actor, method, *arguments):
    """Answer as a slot does where all is well."""
    if method == "settle":
        return Settled(actor.host, f"host-{actor.host}", None)
    if method == "hand_over":
        return ""
    number, job = arguments
    return Ended(number, DONE, 2 * job, 0.0)


@pytest.fixture
def run(monkeypatch):
    """Do jobs by a stand-in; how they ended, and what was told."""
    told = []

    def run(answer, jobs, count=ALL, cpus=2, is_own=False):
        ray = StandIn(answer, cpus)

        @contextmanager
        def connect(address, num_slots):
            yield ray, is_own

        monkeypatch.setattr(executor, "connected", connect)
        code = CodeHandover(lambda: b"code", len)
        ended = [*RayExecutor(None, told.append, code)(jobs, len, count)]
        assert {*ray.killed} == {*ray.actors}
        return ended, ray, told

    return run


def test_each_node_gets_code_once_before_its_first_job(run):
    def answer(actor, method, *arguments):
        if method == "hand_over":
            assert arguments == (len, b"code")
            return "it compiles" if actor.host == "b" else ""
        return behave(actor, method, *arguments)

    ended, ray, told = run(answer, [*range(20)], cpus=6)
    assert sorted(end.value for end in ended) == [2 * job for job in range(20)]
    assert len(ray.actors) == 6 and told == ["node host-b: it compiles"]
    for host in HOSTS:
        asked = [method for where, method in ray.calls if where == host]
        assert asked.count("hand_over") == 1 and asked.index("hand_over") < asked.index("do")
    _, ray, _ = run(answer, [1, 2], is_own=True)
    assert "hand_over" not in [method for _, method in ray.calls]


def test_there_are_as_many_actors_as_cpus_or_as_asked_for_and_never_more_than_jobs(run):
    assert len(run(behave, [*range(9)])[1].actors) == 2
    assert len(run(behave, [*range(9)], count=5)[1].actors) == 5
    assert len(run(behave, [1], count=5)[1].actors) == 1
    assert len(run(behave, [*range(9)], cpus=0)[1].actors) == 1  # a cluster that grows when asked


def test_a_job_is_blamed_for_actors_only_if_it_loses_three_in_a_row(run):
    lost = []

    def answer(actor, method, *arguments):
        if method == "do" and (arguments[1] == 7 or (arguments[1] == 3 and len(lost) < 2)):
            lost.append(arguments[1])
            raise LostError("The actor died.\nIts node went away.\n")
        return behave(actor, method, *arguments)

    ended = {end.number: end for end in run(answer, [3, 5, 7])[0]}
    assert (ended[0].value, ended[1].value, ended[2].how) == (6, 10, CRASHED)
    assert ended[2].value == (
        "3 Ray actors in a row were lost at it, the last one as Its node went away."
    )
    assert lost.count(7) == 3


def test_code_is_given_again_where_an_actor_is_lost_while_it_takes_it(run):
    def answer(actor, method, *arguments):
        if method == "hand_over" and actor.number == 0:
            raise LostError("gone")
        return behave(actor, method, *arguments)

    ended, ray, _ = run(answer, [1, 2, 3], cpus=3)
    assert len(ended) == 3
    assert [call for call in ray.calls if call == ("a", "hand_over")] == [("a", "hand_over")] * 2


def test_nodes_that_will_not_do_are_left_out_and_told_once(run):
    def answer(actor, method, *arguments):
        if method == "settle" and actor.host == "b":
            return Settled("b", "host-b", "no such folder")
        return behave(actor, method, *arguments)

    ended, ray, told = run(answer, [*range(9)], cpus=4)
    assert len(ended) == 9 and ("b", "do") not in ray.calls
    assert told == ["no worker can work on node host-b: no such folder"]


def test_where_no_node_will_do_it_is_one_error(run):
    def answer(actor, method, *arguments):
        if method == "settle" and actor.number:
            return Settled("b", "host", "no such folder")
        if method == "do":
            return "cannot start a worker process: no memory"
        return behave(actor, method, *arguments)

    with pytest.raises(
        NavbakeError, match=r"no worker can work on node host.*: (no such folder|.* no memory)"
    ):
        run(answer, [*range(9)], cpus=4)

    def lose(actor, method, *arguments):
        raise LostError("ModuleNotFoundError: No module named 'navbake'")

    with pytest.raises(NavbakeError, match="no worker can work: ModuleNotFoundError: No module"):
        run(lose, [*range(9)], count=3)


def test_what_passes_ends_no_batch(run, monkeypatch):
    monkeypatch.setattr(executor, "LOOK", 0.01)
    asked = []

    def answer(actor, method, *arguments):
        asked.append(method)
        if method == "do" and 3 <= asked.count("do") <= 5:
            return "cannot start a worker process: no memory"
        return behave(actor, method, *arguments)

    ended, _, told = run(answer, [*range(9)], cpus=2)
    assert len(ended) == 9 and len(told) == 1


def test_actors_without_jobs_are_ended_before_the_others_are_done(run):
    killed = []

    def finish(actor):
        """End its job when the other actor is killed; later, where that is never."""
        end = time.monotonic() + 30.0
        while not (actor.waiting and actor.ray.killed) and time.monotonic() < end:
            time.sleep(0.005)
        killed.extend(other.number for other in actor.ray.killed)
        actor.waiting[0].set_result(Ended(1, DONE, None, 0.0))

    def answer(actor, method, *arguments):
        if method == "do" and arguments[1] == "long":
            threading.Thread(target=finish, args=[actor]).start()
            return ...
        return behave(actor, method, *arguments)

    ended, ray, _ = run(answer, [1, "long"])
    assert len(ended) == 2 and killed == [0] and len(ray.actors) == 2


def test_actors_are_started_on_nodes_that_join_and_it_is_told_that_none_is_free(run, monkeypatch):
    monkeypatch.setattr(executor, "LOOK", 0.01)
    monkeypatch.setattr(executor, "PATIENCE", 0.0)

    def answer(actor, method, *arguments):
        actor.ray.cpus = 2
        return ... if actor.number == 0 else behave(actor, method, *arguments)

    ended, ray, told = run(answer, [1, 2, 3], cpus=1)
    assert len(ended) == 3 and len(ray.actors) == 2
    assert told == ["waiting until one of the Ray cluster's CPUs (1) is free"]


def terms(folder, **changed):
    values = {"witness": None, "version": executor.__version__, "variables": {}}
    return Terms(len, JobLimits(), 0, None, str(folder), **(values | changed))


@pytest.fixture
def settle(monkeypatch):
    """Why a slot can't do its work on this node."""
    context = SimpleNamespace(get_node_id=lambda: "1")
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(get_runtime_context=lambda: context))
    monkeypatch.setitem(sys.modules, "__main__", SimpleNamespace())
    return lambda terms: Slot(terms).settle().why_not


def test_a_slot_works_where_the_batch_does(settle, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("NUMBA_CPU_NAME", "mine")
    (tmp_path / "work").mkdir()
    (tmp_path / "witness").touch()
    given = {"NUMBA_CACHE_DIR": str(tmp_path / "nowhere"), "NUMBA_CPU_NAME": "theirs"}
    seen = str(tmp_path / "witness")
    assert settle(terms(tmp_path / "work", witness=seen, variables=given)) is None
    assert os.getcwd() == str(tmp_path / "work")
    assert "NUMBA_CACHE_DIR" not in os.environ and os.environ["NUMBA_CPU_NAME"] == "mine"
    shared = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert settle(terms(tmp_path, variables=shared)) is None
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path)
    del os.environ["NUMBA_CACHE_DIR"]


def test_a_slot_says_why_it_cannot_work(settle, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "and the batch is one of 0.0" in settle(terms(tmp_path, version="0.0"))
    assert "can't be entered there (No such file" in settle(terms(tmp_path / "no"))
    why = settle(terms(tmp_path, witness=str(tmp_path / "out" / "witness")))
    assert why.startswith(f"what the batch has written into {tmp_path / 'out'} isn't seen")


def test_a_cluster_that_is_not_there_and_a_missing_ray_are_one_error(monkeypatch):
    stand_in = SimpleNamespace(is_initialized=lambda: False)
    monkeypatch.setitem(sys.modules, "ray", stand_in)
    monkeypatch.delenv("RAY_USAGE_STATS_ENABLED", raising=False)
    with pytest.raises(NavbakeError, match=r"cannot connect to a Ray cluster at 127\.0\.0\.1:1: "):
        connected("127.0.0.1:1", 1).__enter__()
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[ray\]"'):
        connected("local", 1).__enter__()
    assert "RAY_USAGE_STATS_ENABLED" not in os.environ


def test_events_tell_of_actors_that_start_and_are_lost(monkeypatch):
    lost = []

    def answer(actor, method, *arguments):
        if method == "do" and not lost:
            lost.append(actor.number)
            raise LostError("its node died")
        return behave(actor, method, *arguments)

    @contextmanager
    def connect(address, num_slots):
        yield StandIn(answer, cpus=1), True

    monkeypatch.setattr(executor, "connected", connect)
    events = []
    assert len([*RayExecutor(None, print)([5], len, ALL, on_event=events.append)]) == 1
    assert [(event.what, event.worker, event.number, event.why) for event in events] == [
        (READY, 1, None, ""),
        (BEGUN, 1, 0, ""),
        (LOST, 1, 0, "its node died"),
        (AGAIN, 1, 0, "its node died"),
        (READY, 2, None, ""),
        (BEGUN, 2, 0, ""),
    ]
