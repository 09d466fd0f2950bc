"""The index of a batch that writes into a store, where no file can be added to and none is locked.

While the batch runs, what became of scenes is in parts: each a file in `.navbake-index`, written
every few seconds. At the end they become `index.jsonl`, as on this machine. A file with a token of
the batch, written anew as often, keeps others away; see `RemoteIndex`.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread

from navbake.batch.index import LOCK, NAME, join_rows, order_rows, parse_rows
from navbake.batch.stores.store import (
    list_folder,
    read_file,
    read_files,
    read_if_there,
    remove_all,
    remove_files,
    write_file,
    write_first,
)
from navbake.batch.stores.urls import shown
from navbake.errors import NavbakeError
from navbake.files import TEMPORARY
from navbake.types import Json

PARTS = ".navbake-index"
INTERVAL = 5.0  # between two parts [s]
PATIENCE = 30.0  # how long a batch must not have written its token to be taken for dead [s]
MAX_BYTES = 4 << 30  # of an index
MAX_TOKEN = 1 << 16  # bytes of a token


class TakenOverError(NavbakeError):
    """Another batch has taken over the folder: nothing more may be written into it."""


class RemoteIndex:
    """The index of a folder on a store, to which one batch adds rows.

    Only one batch at a time may have it, as far as the store lets anybody know: a batch writes a
    token, and writes it anew every `INTERVAL`. Another batch that finds one waits to see whether
    it changes within `PATIENCE`; if so, it gives up, else it takes over. One whose token was
    replaced ends, and leaves the index as it is. So does one whose token is gone: another batch
    may have taken over and ended.

    Attributes:
        known: the rows that were there before, by id.
        rows: all rows, once it is finished: those of the batch's scenes, then others.

    Raises:
        NavbakeError: another batch has it, or the store refuses it.
    """

    def __init__(self, folder: str) -> None:
        self._folder, self._lock = folder, f"{folder}/{LOCK}"
        self._token, self._beats = os.urandom(8).hex(), 0
        self._added: list[Json] = []
        self._num_written, self._num_parts = 0, 0
        self._is_lost, self._end = False, Event()
        self.rows: list[Json] = []
        self._take()
        try:
            self.known = self._read()
        except BaseException:
            self._give_back()
            raise
        self._writer = Thread(target=self._keep_writing, daemon=True)
        self._writer.start()

    def add(self, row: Json) -> None:
        """Add a scene's row; it is on the store within `INTERVAL`."""
        self._check_token()
        self._added.append(row)

    def wait_for_disk(self) -> None:
        """Nothing: a store has what it has taken."""

    def finish(
        self, ids: Iterable[str], skipped: Collection[str], left: Callable[[str], Json]
    ) -> None:
        """Replace the parts by one file; see `Index.finish`."""
        self._stop()
        self._look_at_token()  # which the thread did up to `INTERVAL` ago
        added = {row["id"]: row for row in self._added}
        own, others = order_rows(ids, self.known, added, skipped, left)
        self._check_token()
        self.rows = [*own, *others]
        write_file(f"{self._folder}/{NAME}", join_rows(self.rows))
        self._remove_parts()

    def write(self, name: str, content: bytes) -> None:
        """Write a file beside the index."""
        self._check_token()
        write_file(f"{self._folder}/{name}", content)

    def remove(self, name: str) -> None:
        """Remove a file beside the index, if it is there."""
        self._check_token()
        remove_files([f"{self._folder}/{name}"])

    def close(self) -> None:
        """Let other batches have it."""
        self._stop()
        self._give_back()

    def _read(self) -> dict[str, Json]:
        """All rows; those in the parts of a batch that was killed become lines of the index."""
        names = list_folder(self._folder, is_own=True)
        remove_files(f"{self._folder}/{name}" for name in names if TEMPORARY.fullmatch(name))
        content = read_file(f"{self._folder}/{NAME}", MAX_BYTES) if NAME in names else b""
        parts = sorted(list_folder(f"{self._folder}/{PARTS}"))
        pieces = read_files([f"{self._folder}/{PARTS}/{name}" for name in parts])
        known = parse_rows(b"\n".join([content, *pieces]))
        if parts:
            write_file(f"{self._folder}/{NAME}", join_rows(known.values()))
            self._remove_parts()
        return known

    def _remove_parts(self) -> None:
        folder = f"{self._folder}/{PARTS}"
        remove_all([f"{folder}/{name}" for name in list_folder(folder)])

    # ---------------------------------------------------------------- the token

    def _take(self) -> None:
        if write_first(self._lock, self._next_token()):
            return
        found = self._read_token()
        end = time.monotonic() + PATIENCE
        while found and not _is_of_dead(found) and time.monotonic() < end:
            time.sleep(INTERVAL / 4)
            now = self._read_token()
            if now is None and write_first(self._lock, self._next_token()):
                return
            if now not in (found, b"", None):
                raise NavbakeError(
                    f"another batch writes into {shown(self._folder)}: wait for it, or choose "
                    "another folder"
                )
        token = self._next_token()
        write_file(self._lock, token)
        time.sleep(INTERVAL / 20)  # another may have seen the same
        if self._read_token() != token:
            raise NavbakeError(f"another batch begins to write into {shown(self._folder)}")

    def _next_token(self) -> bytes:
        self._beats += 1
        stated = {"token": self._token, "beat": self._beats, "host": platform.node()}
        return json.dumps({**stated, "ids": owner_of_ids(), "pid": os.getpid()}).encode()

    def _read_token(self) -> bytes | None:
        """The token; None where it was given back, nothing where the store refuses it."""
        try:
            return read_if_there(self._lock, MAX_TOKEN)
        except NavbakeError:
            return b""

    def _look_at_token(self) -> None:
        """Notice where another batch has taken over."""
        found = read_if_there(self._lock, MAX_TOKEN)
        self._is_lost |= found is None or self._token.encode() not in found

    def _check_token(self) -> None:
        if self._is_lost:
            raise TakenOverError(
                f"another batch took {shown(self._folder)} over: this one was not heard of for "
                f"{PATIENCE:g} s"
            )

    def _give_back(self) -> None:
        with suppress(NavbakeError):
            if not self._is_lost:
                remove_files([self._lock])

    # ---------------------------------------------------------------- the writer's thread

    def _keep_writing(self) -> None:
        while not self._end.wait(INTERVAL):
            with suppress(Exception):  # it is tried again, and told at the end
                self._write_part()

    def _write_part(self) -> None:
        self._look_at_token()
        if self._is_lost:
            return
        write_file(self._lock, self._next_token())
        rows = self._added[self._num_written :]
        if rows:
            self._num_parts += 1
            name = f"{self._num_parts:06}-{self._token}.jsonl"
            write_file(f"{self._folder}/{PARTS}/{name}", join_rows(rows))
            self._num_written += len(rows)

    def _stop(self) -> None:
        self._end.set()
        self._writer.join()


def owner_of_ids() -> str:
    """Whose ids of processes this machine's are, on Linux: containers may share a host's name."""
    with suppress(OSError):
        kernel = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{kernel} {os.readlink('/proc/self/ns/pid')}"
    return ""


def _is_of_dead(token: bytes) -> bool:
    """Whether a token is of a process of this machine that is gone."""
    with suppress(ValueError, KeyError, TypeError, OSError):
        stated = json.loads(token)
        is_here = stated["host"] == platform.node() and stated["ids"] == owner_of_ids()
        if is_here and os.name == "posix":
            try:
                os.kill(int(stated["pid"]), 0)
            except ProcessLookupError:
                return True
    return False
