"""Sends Ctrl-C and SIGTERM to commands at random moments, and shows how they end.

    python scripts/sweep_signals.py [PART ...] [--signals 40] [--seed 0]

Each part sends so many SIGINT, which is what Ctrl-C sends, and so many SIGTERM, each to another run
of a command, from this process. The moment is drawn between the start of the command, once it
handles signals, and its end. Half of the signals go to all processes of the command, as those of a
terminal do. A command is to end within 2 s with status 130 or 143, unless it was done before; each
file that it writes is the old or the new one, whole; and no process stays. What it leaves under
temporary names is counted, before and after the next run.

bake      a house of two storeys
inflate   its grid, for a larger radius
convert   its grid, to a map of nav2 in several files
ask       a path on its grid
batch     twelve rooms, in two workers
compile   a bake whose kernels are not compiled yet; it is slow, and left out unless named
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from batch_processes import members  # noqa: E402 (of the tests)
from batch_scenes import write_scenes  # noqa: E402
from navbake.files import TEMPORARY_NAME  # noqa: E402

COARSE = ("--set", "grid.cell_size=0.2")
MAX_SECONDS = 2.0  # from a signal to the end of the process [s]
PATIENCE = 30.0  # after that, a process hangs [s]
COMPILE_SECONDS = 15.0  # signals to a bake that compiles come within this time [s]
NUM_ROOMS = 12
STATUSES = {signal.SIGINT: 130, signal.SIGTERM: 143}
TERMINATE_BIT = 1 << (signal.SIGTERM - 1)  # of the signals that a process handles, in /proc


@dataclass
class Part:
    """A command, the folder that it writes into, and what that folder may hold.

    Attributes:
        command: the arguments of `navbake`.
        folder: what the command writes into; None if it writes nothing.
        old: by path, the digest of each file before a run.
        new: by path, the digest of each file after a run that nobody stopped.
        seconds: how long such a run takes, once it handles signals [s].
        new_caches: whether each run begins without compiled kernels.
    """

    command: tuple[str, ...]
    folder: Path | None = None
    old: dict[str, str] = field(default_factory=dict)
    new: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    new_caches: bool = False


@dataclass
class Ending:
    """How a command ended after a signal.

    Attributes:
        number: the signal.
        moment: when it was sent, after the command's start [s].
        seconds: from the signal to the end of the process [s].
        status: the exit status; None if it had to be killed.
        faults: what is wrong with the ending, with the files or with the processes.
    """

    number: signal.Signals
    moment: float
    seconds: float
    status: int | None
    faults: list[str]


def digest_file(path: Path) -> str:
    """Digest of a file; of a grid, without its timings."""
    content = path.read_bytes()
    if path.name.endswith(".grid.json"):
        grid = json.loads(content)
        grid.pop("timings", None)
        content = json.dumps(grid).encode()
    return hashlib.sha256(content).hexdigest()


def digest_folder(folder: Path) -> dict[str, str]:
    """Digest of each file in a folder, by path, but of indexes, records and temporary files."""
    digests = {}
    for path in folder.rglob("*"):
        is_listing = path.name.startswith((".", "index"))
        if path.is_file() and not is_listing and not TEMPORARY_NAME.fullmatch(path.name):
            digests[path.relative_to(folder).as_posix()] = digest_file(path)
    return digests


def find_leftovers(folder: Path) -> set[Path]:
    """The temporary files and folders in a folder."""
    return {path for path in folder.rglob("*") if TEMPORARY_NAME.fullmatch(path.name)}


@contextlib.contextmanager
def start(part: Part) -> Iterator[subprocess.Popen[bytes]]:
    """Start a part's command, and wait until it handles signals."""
    with tempfile.TemporaryDirectory() as temporary:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": temporary}
        if part.new_caches:
            environment["NUMBA_CACHE_DIR"] = temporary
        process = subprocess.Popen(
            [sys.executable, "-m", "navbake", *part.command],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        with process:
            while process.poll() is None and not handles_signals(process.pid):
                time.sleep(0.001)
            yield process


def handles_signals(pid: int) -> bool:
    """Whether a process has a handler of SIGTERM, as navbake has and Python alone has not."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
            if line.startswith("SigCgt:"):
                return bool(int(line.split()[1], 16) & TERMINATE_BIT)
    return False


def run_undisturbed(part: Part) -> float:
    """Run a part's command to its end; how long that took, once it handled signals [s]."""
    with start(part) as process:
        begin = time.perf_counter()
        _, stderr = process.communicate()
        if process.returncode != 0:
            sys.exit(f"{part.command} ended with {process.returncode}: {stderr.decode()}")
        return time.perf_counter() - begin


def send_signal(part: Part, number: signal.Signals, random_: random.Random) -> Ending:
    """Run a part's command, send it a signal, and look at how it ends."""
    moment = random_.uniform(0.0, part.seconds)
    is_for_group = random_.random() < 0.5
    faults = []
    status: int | None = None
    with start(part) as process:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(moment)
        sent = time.perf_counter()
        with contextlib.suppress(ProcessLookupError):
            if is_for_group:
                os.killpg(process.pid, number)
            else:
                process.send_signal(number)
        try:
            process.wait(PATIENCE)
            status = process.returncode
        except subprocess.TimeoutExpired:
            faults.append(f"hangs at {members(process.pid)}")
        seconds = time.perf_counter() - sent
        time.sleep(0.1)  # what cleans up after multiprocessing ends a little later
        remaining = members(process.pid) if status is not None else []
        if remaining:
            time.sleep(1.0)
            remaining = members(process.pid)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        assert process.stderr is not None
        stderr = process.stderr.read().decode(errors="replace")
    if status not in (STATUSES[number], 0):
        faults.append(f"ended with {status}: {stderr}")
    if seconds > MAX_SECONDS:
        faults.append(f"took {seconds:.2f} s")
    if "Traceback" in stderr or "Exception ignored" in stderr:
        faults.append(stderr)
    faults += [f"the process {line} stays" for line in remaining]
    if part.folder is not None:
        digests = digest_folder(part.folder)
        faults += [
            f"{name} is neither the old nor the new file"
            for name in sorted({*part.old, *digests})
            if digests.get(name) not in (part.old.get(name), part.new.get(name))
        ]
        if status == 0 and digests != part.new:
            faults.append("it was done without the new files")
    return Ending(number, moment, seconds, status, faults)


def sweep(name: str, part: Part, old_folder: Path, count: int, random_: random.Random) -> bool:
    """Send a part's command so many signals of each kind, and print what was seen.

    Args:
        name: of the part.
        part: the command.
        old_folder: what the command's folder holds before each run.
        count: number of signals of each kind.
        random_: draws the moments.

    Returns:
        Whether each run ended well.
    """
    endings = []
    num_leftovers = 0
    for number in (*STATUSES,) * count:
        if part.folder is not None:
            before = find_leftovers(part.folder)
            shutil.copytree(old_folder, part.folder, dirs_exist_ok=True)
            for path in sorted(part.new.keys() - part.old.keys()):
                (part.folder / path).unlink(missing_ok=True)
            (part.folder / "index.jsonl").unlink(missing_ok=True)
        ending = send_signal(part, number, random_)
        endings.append(ending)
        if part.folder is not None:
            num_leftovers += len(find_leftovers(part.folder) - before)
        for fault in ending.faults:
            print(f"{name}, {number.name} after {ending.moment:.3f} s: {fault}", flush=True)
    for number, status in STATUSES.items():
        chosen = [ending for ending in endings if ending.number == number]
        stopped = [ending.seconds for ending in chosen if ending.status == status]
        times = (
            f"median {statistics.median(stopped):.2f} s, longest {max(stopped):.2f} s"
            if stopped
            else "-"
        )
        num_done = sum(ending.status == 0 for ending in chosen)
        num_faulty = sum(bool(ending.faults) for ending in chosen)
        print(
            f"{name}, {number.name}: {len(stopped)} of {len(chosen)} ended with {status}, {times}; "
            f"{num_done} done before; {num_faulty} with faults; load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
    if part.folder is not None:
        run_undisturbed(part)
        num_remaining = len(find_leftovers(part.folder))
        print(f"{name}: {num_leftovers} leftovers, {num_remaining} after the next run", flush=True)
    return not any(ending.faults for ending in endings)


def make_part(folder: Path, name: str) -> tuple[Part, Path]:
    """Make the inputs and the old files of a part.

    Returns:
        The part, and the folder that holds the old files.
    """
    inputs = folder / "inputs"
    out = folder / "out"
    old_folder = folder / "old"
    for path in (inputs, out, old_folder):
        path.mkdir(parents=True)
    house = str(ROOT / "configs" / "house.yaml")
    grid = str(inputs / "house.grid.json")
    other_grid = str(inputs / "other.grid.json")
    if name in ("inflate", "convert", "ask"):
        run_undisturbed(Part(("bake", house, "-o", grid, "-q")))
        run_undisturbed(Part(("bake", house, "-o", other_grid, "-q", *COARSE)))

    def command_of(is_new: bool) -> tuple[str, ...]:
        """The command that makes the new files, or the old ones."""
        source = grid if is_new else other_grid
        if name in ("bake", "compile"):
            options = () if is_new else COARSE
            return ("bake", house, "-o", str(out / "house.grid.json"), "-q", *options)
        if name == "inflate":
            return ("inflate", source, "--radius", "0.3", "-o", str(out / "wide.grid.json"))
        if name == "convert":
            return ("convert", source, str(out / "map.yaml"))
        if name == "batch":
            return ("batch", str(inputs / "list.jsonl"), "-o", str(out), "--jobs", "2", "-q")
        return ("path", source, "--from", "0,-5,L0", "--to", "1,1,L1")

    if name == "batch":
        write_scenes(inputs, NUM_ROOMS)
    elif name != "ask":
        run_undisturbed(Part(command_of(is_new=False)))
        shutil.copytree(out, old_folder, dirs_exist_ok=True)
    part = Part(command_of(is_new=True), None if name == "ask" else out)
    part.old = digest_folder(old_folder)
    part.seconds = run_undisturbed(part)
    part.new = digest_folder(out)
    if name == "batch":  # without what is done, it begins anew
        shutil.rmtree(out)
        out.mkdir()
    if name == "compile":
        part.new_caches = True
        part.seconds = COMPILE_SECONDS
    return part, old_folder


PARTS = ("bake", "inflate", "convert", "ask", "batch", "compile")


def main() -> None:
    """Sweep the parts that are asked for; all but `compile` if none is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART")
    parser.add_argument("--signals", type=int, default=40, help="of each kind, to each part (40)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    # A shell's background jobs ignore Ctrl-C, and so would the commands that are started here
    signal.signal(signal.SIGINT, signal.default_int_handler)
    random_ = random.Random(args.seed)
    failed = []
    for name in args.parts or PARTS[:-1]:
        with tempfile.TemporaryDirectory() as folder:
            part, old_folder = make_part(Path(folder), name)
            print(f"-- {name}: {part.seconds:.2f} s", flush=True)
            if not sweep(name, part, old_folder, args.signals, random_):
                failed.append(name)
    sys.exit(f"failed: {', '.join(failed)}" if failed else None)


if __name__ == "__main__":
    main()
