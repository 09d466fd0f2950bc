"""How many threads a bake may be told to run on."""

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest
from numba import njit

import navbake
from navbake.errors import ConfigError
from navbake.threads import limit_threads, num_threads, run_beside, run_in_chunks


@pytest.mark.parametrize("count", ["2", 1.5, True, 0, -1, [], "x"], ids=repr)
def test_what_is_no_number_of_threads(tmp_path, count):
    with (
        pytest.raises(ConfigError, match="expected a number of threads >= 1, got"),
        limit_threads(count),
    ):
        pass
    scene = tmp_path / "scene.xml"
    scene.write_text('<mujoco><worldbody><geom type="box" size="1 1 .1"/></worldbody></mujoco>')
    with pytest.raises(ConfigError, match="expected a number of threads >= 1, got"):
        navbake.bake(scene, threads=count)


@pytest.mark.parametrize("count", [1, np.int64(1), 10**30, None], ids=repr)
def test_numbers_of_threads(count):
    before = num_threads()
    with limit_threads(count):
        assert num_threads() == (1 if count == 1 else before)
    assert num_threads() == before


@njit(nogil=True)
def _count(values, first, end):
    for i in range(first, end):
        values[i] += 1


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 8, 1000])
@pytest.mark.parametrize("least", [1, 3, 2000])
def test_each_part_of_the_work_is_done_once(monkeypatch, threads, count, least):
    monkeypatch.setattr("navbake.threads.num_threads", lambda: threads)
    values = np.zeros(1000, np.int64)
    run_in_chunks(_count, count, values, min_chunk_size=least)
    assert (values == (np.arange(1000) < count)).all()


def test_an_error_in_a_thread_is_raised(monkeypatch):
    monkeypatch.setattr("navbake.threads.num_threads", lambda: 4)

    def fail(first, end):
        time.sleep(0.01)
        raise ValueError(f"{first}")

    with pytest.raises(ValueError, match=r"\d"):
        run_in_chunks(fail, 100)


def test_a_limit_holds_in_its_thread_alone():
    with limit_threads(1), ThreadPoolExecutor(1) as pool:
        assert num_threads() == 1
        assert pool.submit(num_threads).result() == numba.config.NUMBA_NUM_THREADS
    assert num_threads() == numba.config.NUMBA_NUM_THREADS


@pytest.mark.parametrize("threads", [1, 2])
def test_run_beside_gives_the_result_or_raises(threads):
    with limit_threads(threads):
        assert run_beside(divmod, 7, 2)() == (3, 1)
        result = run_beside(divmod, 7, 0)
        with pytest.raises(ZeroDivisionError):
            result()


def test_what_runs_beside_has_the_limit_too(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 5)
    with limit_threads(2):
        assert run_beside(num_threads)() == 2
    assert run_beside(num_threads)() == 5


def test_what_a_chunk_starts_runs_on_its_thread_alone():
    """Else a bake that is told to run on few threads would run on more."""
    threads_by_chunk = {}

    def note_threads(first_index, end_index):
        threads_by_chunk[first_index] = num_threads()

    with limit_threads(2):
        threads = num_threads()
        run_in_chunks(note_threads, 100)
        assert num_threads() == threads
    assert set(threads_by_chunk.values()) == {1}


def test_what_no_thread_has_begun_is_run_by_the_one_that_asks():
    """Else it would wait for threads that are at work for others, perhaps for itself."""
    go_on = threading.Event()
    busy = [run_beside(go_on.wait) for _ in range(num_threads())]
    try:
        assert run_beside(threading.get_ident)() == threading.get_ident()
    finally:
        go_on.set()
    for wait in busy:
        assert wait()


INTERRUPTED = """
import os, signal, threading
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run in the background
start_thread = threading.Thread.start
def start_and_interrupt(thread):
    threading.Thread.start = start_thread
    start_thread(thread)
    os.kill(os.getpid(), signal.SIGINT)
threading.Thread.start = start_and_interrupt
from navbake.threads import num_threads, run_beside
try:
    for _ in range(100):
        run_beside(num_threads)
except KeyboardInterrupt:
    print("interrupted", flush=True)
assert run_beside(num_threads)() == num_threads()
"""


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
def test_ctrl_c_while_a_thread_starts_leaves_none_that_never_ends():
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED],
        env={**os.environ, "NUMBA_NUM_THREADS": "2"},
        stdout=subprocess.PIPE,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout == "interrupted\n"


def test_no_chunk_begins_after_ctrl_c(monkeypatch):
    """Also where it comes before this thread has begun to work."""
    monkeypatch.setattr("navbake.threads.num_threads", lambda: 2)
    chunks = []

    def note(first, end):
        chunks.append(first)
        time.sleep(0.05)

    class InterruptedPool(ThreadPoolExecutor):
        def submit(self, *arguments):
            super().submit(*arguments)
            while not chunks:
                time.sleep(0.001)
            raise KeyboardInterrupt

    with InterruptedPool(1) as pool:
        monkeypatch.setattr("navbake.threads._pool", pool)
        with pytest.raises(KeyboardInterrupt):
            run_in_chunks(note, 100)
    assert chunks == [0]


def test_a_pool_without_threads_raises_the_error(monkeypatch):
    """Where the system starts no further thread."""

    def fail(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("navbake.threads._pool", None)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", fail)
        with pytest.raises(RuntimeError, match="can't start new thread"):
            run_beside(num_threads)
    assert run_beside(num_threads)() == num_threads()
