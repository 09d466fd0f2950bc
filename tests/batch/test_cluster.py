"""Batches on a Ray cluster: the same bytes, whatever is lost on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import crew_jobs
from batch_in_process import run_sources, stay_in_process
from batch_processes import PATIENCE, digests, start_list, wait_for_grids, wait_until_gone
from batch_scenes import write_scenes, wrong_rows
from navbake.batch.workers import CRASHED, DONE, TOO_LONG, JobLimits, run_on_ray
from project_paths import ROOT
from ray_cluster import VARIABLES, two_nodes

pytestmark = pytest.mark.skipif(
    find_spec("ray") is None or sys.platform != "linux", reason="needs ray, and signals of Linux"
)
COUNT = 8
MAKE = "episodes:point:uniform:5:0"
OPTIONS = ("--time-limit", "10", "--memory-limit", "0.7", "--set", "grid.cell_size=0.1")
OPTIONS += ("--make", MAKE)


def test_two_nodes_of_which_one_is_killed_make_the_same(tmp_path, monkeypatch):
    expected = write_scenes(tmp_path / "scenes", COUNT, endings=True)
    source = tmp_path / "scenes" / "list.jsonl"
    lines = [json.loads(line) for line in source.read_text().splitlines()]
    lines = [line for line in lines if line.get("id") != "takes"]  # it takes long
    source.write_text("".join(json.dumps(line) + "\n" for line in lines))
    del expected["takes"]
    good = [str(source.parent / line["scene"]) for line in lines if "id" not in line]
    with monkeypatch.context() as patch:
        stay_in_process(patch)
        settings = {"grid": {"cell_size": 0.1}}
        run_sources(*good, settings=settings, out=tmp_path / "one", products=[MAKE])
    whole = digests(tmp_path / "one")
    assert len(whole) == 2 * COUNT
    with two_nodes(1) as nodes:
        on_ray = (tmp_path / "scenes", tmp_path / "out", "--executor", "ray")
        on_ray = (*on_ray, "--ray-address", nodes.address, *OPTIONS)
        with start_list(*on_ray, stderr=subprocess.DEVNULL) as process:
            wait_for_grids(tmp_path / "out", 2)
            process.terminate()
            assert process.wait(PATIENCE) == 143
        wait_until_gone(nodes.process.pid, "navbake.batch")
        wait_until_gone(process.pid)  # Python's own tracker of resources ends a moment later
        with start_list(*on_ray, stderr=subprocess.PIPE, text=True) as process:
            wait_for_grids(tmp_path / "out", 4)
            nodes.kill_second()
            _, said = process.communicate(timeout=PATIENCE)
            assert process.returncode == 1
    assert digests(tmp_path / "out") == whole
    (episodes,) = (tmp_path / "one").glob("episodes-*")
    assert (tmp_path / "out" / episodes.name).read_bytes() == episodes.read_bytes()
    lines = (tmp_path / "out" / "index.jsonl").read_text().splitlines()
    assert wrong_rows([json.loads(line) for line in lines], expected) == []
    named = sorted(line.split()[1] for line in said.splitlines() if "warning" not in line)
    assert named == ["crashes:", "hangs:"]


def test_jobs_fail_as_on_one_machine_and_a_task_that_is_lost_is_done_again(tmp_path, monkeypatch):
    for name, value in {**VARIABLES, "PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    jobs = [
        ("lose", str(tmp_path / "once")),
        ("double", 1),
        ("kill", signal.SIGSEGV),
        ("sleep", 60),
        ("lose", None),
        ("raise", "bad value"),
        ("double", 2),
    ]
    done = run_on_ray(jobs, crew_jobs.work, 2, address="local", limits=JobLimits(5.0))
    ended = dict(enumerate(sorted(done)))
    assert [ended[k].result for k in (1, 6)] == [2, 4] and ended[0].how == DONE
    assert (ended[2].how, ended[2].reason) == (CRASHED, "its process ended by SIGSEGV")
    assert (ended[3].how, ended[3].reason) == (TOO_LONG, "it took more than 5 s")
    assert (ended[5].how, ended[5].reason) == (CRASHED, "ValueError: bad value")
    assert ended[4].how == CRASHED
    assert ended[4].reason.startswith("it was lost 4 times, as ")
    assert [*run_on_ray([], crew_jobs.work, None, address="local")] == []


def test_ctrl_c_ends_the_cluster_that_the_batch_started(tmp_path):
    write_scenes(tmp_path / "scenes", COUNT)
    before = {*Path("/tmp").glob("navbake-ray-*")}
    on_ray = (tmp_path / "scenes", tmp_path / "out", "--executor", "ray")
    on_ray = (*on_ray, "--ray-address", "local", "--jobs", "1", *OPTIONS)
    with start_list(*on_ray, stdout=-1, stderr=-1) as process:
        wait_for_grids(tmp_path / "out", 1)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode in (0, 130) and b"Traceback" not in err
    wait_until_gone(process.pid)
    assert {*Path("/tmp").glob("navbake-ray-*")} <= before
    lines = (tmp_path / "out" / "index.jsonl").read_text().splitlines()
    assert {json.loads(line)["status"] for line in lines} <= {"ok", "left"}
