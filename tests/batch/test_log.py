"""The log of a batch: what happens is lines of one form."""

from __future__ import annotations

import json
import os
import sys
from datetime import datetime, timezone
from pathlib import Path

import pytest

from navbake.batch.index import LineFile
from navbake.batch.job import current_time
from navbake.batch.run import describe_event
from navbake.batch.workers import CRASHED, RETRIED, SCENE_BEGUN
from navbake.errors import NavbakeError


def test_lines_say_when_how_serious_and_what():
    row = {"id": "a", "status": "ok", "warnings": [], "inputs": {"a.xml": 1}, "key": "0"}
    retry = {"id": "b", "worker": 22, "seconds": 0.5, "how": CRASHED, "error": "by SIGSEGV"}
    events = [
        ("begin", {"scenes": 3, "skipped": 1}),
        (SCENE_BEGUN, {"id": "a"}),
        (RETRIED, retry),
        ("scene", {**row, "seconds": 1.5, "ended": current_time(), "worker": 23}),
        ("scene", {**row, "id": "b", "warnings": ["low"]}),
        ("scene", {"id": "c", "status": "failed", "how": "error", "error": "none"}),
        ("end", {"baked": 2, "failed": 0, "stopped": None, "seconds": 1.235}),
    ]
    lines = [describe_event(*event) for event in events]
    times = [datetime.fromisoformat(line.pop("time").replace("Z", "+00:00")) for line in lines]
    assert times == sorted(times) and times[0].tzinfo == timezone.utc
    assert abs((datetime.now(timezone.utc) - times[-1]).total_seconds()) < 60
    assert [(line.pop("level"), line.pop("event")) for line in lines] == [
        ("info", "begin"),
        ("info", "scene-begin"),
        ("warning", "retry"),
        ("info", "scene"),
        ("warning", "scene"),
        ("error", "scene"),
        ("info", "end"),
    ]
    assert lines[1] == {"id": "a"}
    assert lines[2] == retry
    assert lines[3] == {"id": "a", "status": "ok", "warnings": [], "seconds": 1.5, "worker": 23}
    assert lines[6] == {"baked": 2, "failed": 0, "stopped": None, "seconds": 1.235}


def test_a_log_is_added_to_and_its_folder_made(tmp_path):
    path = tmp_path / "logs" / "a.jsonl"
    for number in range(2):
        log = LineFile(path, "the log")
        log.add({"n": number, "id": "\u2028\n"})
        log.close()
    assert [json.loads(line)["n"] for line in path.read_bytes().splitlines()] == [0, 1]


def test_a_log_that_cannot_be_written_is_one_error(tmp_path):
    with pytest.raises(NavbakeError, match="cannot write the log"):
        LineFile(tmp_path, "the log")


@pytest.mark.skipif(sys.platform != "linux", reason="a device that is full")
def test_a_full_disk_is_one_error():
    log = LineFile(Path("/dev/full"), "the log /dev/full")
    with pytest.raises(NavbakeError, match="cannot write the log /dev/full: No space left"):
        log.add({})
    log.close()


def test_a_line_of_which_a_part_was_written_is_ended(tmp_path, monkeypatch):
    write = os.write
    monkeypatch.setattr("os.write", lambda file, data: write(file, data[:3]))
    log = LineFile(tmp_path / "a.jsonl", "the log")
    log.add({"id": "a long one"})
    log.close()
    assert json.loads((tmp_path / "a.jsonl").read_bytes()) == {"id": "a long one"}
