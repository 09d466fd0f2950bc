"""Batches in processes of their own, which may be killed, and what they leave."""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any

from navbake.batch.products import RECORD_NAME
from project_paths import ROOT
from ray_cluster import VARIABLES

PATIENCE = 300.0  # what a busy machine may take, which may have to compile all first [s]


def start(*arguments: str | Path, **options: Any) -> subprocess.Popen[Any]:
    """Start `navbake` in a session of its own.

    Args:
        arguments: of the command line.
        options: of the process.
    """
    command = [sys.executable, "-m", "navbake", *arguments]
    environment = {**os.environ, **VARIABLES, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(command, env=environment, start_new_session=True, **options)


def start_list(folder: Path, out: Path, *arguments: str, **options: Any) -> subprocess.Popen[Any]:
    """Start a batch of the scenes that a folder's ``list.jsonl`` names; see `start`."""
    return start("batch", "list.jsonl", "-o", out, *arguments, cwd=folder, **options)


def digests(out: Path, pattern: str = "*/*") -> dict[str, str]:
    """sha256 of each file in the scenes' folders but records, by its path."""
    found = {}
    for path in out.glob(pattern):
        if path.name == RECORD_NAME:  # it has times
            continue
        with contextlib.suppress(FileNotFoundError):
            found[path.relative_to(out).as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def wait_for_grids(out: Path, count: int = 1) -> None:
    """Wait until there are so many."""
    end = time.monotonic() + PATIENCE
    while len([*out.glob("*/grid.json.gz")]) < count:
        assert time.monotonic() < end
        time.sleep(0.005)


def members(session: int, name: str = "") -> list[str]:
    """Command lines of a session's processes that are no zombies, if they have a text in them."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, _, of_session = (path / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(of_session) == session and state != "Z":
                line = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                found += [line] if name in line else []
    return found


def wait_until_gone(session: int, name: str = "") -> None:
    """Wait until there are no such `members`."""
    end = time.monotonic() + 60.0
    while members(session, name) and time.monotonic() < end:
        time.sleep(0.02)
    assert members(session, name) == []


class Watcher:
    """Reads a batch's grids in a thread, each as it changes, while what is inside of it runs.

    What goes wrong in the thread is raised at the end.

    Attributes:
        looks: how many files it read.
        torn: those that were not as expected.
    """

    def __init__(self, out: Path, expected: dict[str, str]) -> None:
        self._grids = {
            str(out / name): (name, digest)
            for name, digest in expected.items()
            if name.endswith(".json.gz")
        }
        self._pool, self._ended = ThreadPoolExecutor(1), threading.Event()
        self._known: dict[str, tuple[int, int, int]] = {}
        self.looks, self.torn = 0, set[str]()

    def __enter__(self) -> Watcher:
        self._result = self._pool.submit(self._watch)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._pool.shutdown()
        self._result.result()

    def _watch(self) -> None:
        is_last = False
        while not is_last:
            is_last = self._ended.wait(0.002)
            for path, (name, expected_digest) in self._grids.items():
                with contextlib.suppress(FileNotFoundError):
                    self._look(path, name, expected_digest)

    def _look(self, path: str, name: str, expected_digest: str) -> None:
        status = os.stat(path)
        state = status.st_ino, status.st_size, status.st_mtime_ns
        if self._known.get(name) != state:
            digest = hashlib.sha256(Path(path).read_bytes()).hexdigest()
            self._known[name] = state
            self.looks += 1
            if digest != expected_digest:
                self.torn.add(name)
