"""Shows what a batch withstands, and how fast it is.

    python scripts/sweep_batch.py [PART ...] [--kills 50] [--scenes 200] [--seed 0]

faults  200 scenes, 20 broken in ten ways, one that hangs, one that takes 27 GiB, one that crashes
        its process: what became of each, held against what was to become of it.
kills   a batch whose process group is killed by SIGKILL at random moments, and started again each
        time, while a thread reads the folder: at the end the grids of an undisturbed batch.
ray     the scenes of faults on a Ray cluster of two nodes, of which one is killed half way: what
        became of each, and the grids of a batch on one machine. Left out where ray isn't installed.
speed   two workers against one, what a batch adds to scenes of a second, and scenes of 10 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from batch_scenes import write_scenes, wrong_rows  # noqa: E402 (of the tests)
from navbake.batch.index import read_index  # noqa: E402
from ray_cluster import VARIABLES, two_nodes  # noqa: E402

PARTS = ("faults", "kills", "speed", "ray")
LIMITS = ("--time-limit", "30", "--memory-limit", "4")
AFTER = (0.0, 5.0)  # when a batch is killed; its first scene is done after about 2 s [s]


def start(folder: Path, out: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start a batch of a folder's scenes, in a process group of its own."""
    command = [sys.executable, "-m", "navbake", "batch", "list.jsonl", "-o", str(out), *options]
    environment = {**os.environ, **VARIABLES, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(command, cwd=folder, env=environment, start_new_session=True)


def run(folder: Path, out: Path, *options: str) -> tuple[int, float]:
    """Run a batch; its exit status, and how long it took [s]."""
    begin = time.perf_counter()
    with start(folder, out, *options) as process:
        return process.wait(), time.perf_counter() - begin


def digests(out: Path) -> dict[str, str]:
    """sha256 of each grid."""
    found = {}
    for path in out.glob("*/*.json.gz"):
        with contextlib.suppress(FileNotFoundError):
            found[str(path.relative_to(out))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def show_faults(folder: Path, args: argparse.Namespace) -> bool:
    """One run over scenes of which some end it."""
    num_good = args.scenes - 23
    expected = write_scenes(folder / "scenes", num_good, broken=20, endings=True)
    status, seconds = run(folder / "scenes", folder / "out", "--jobs", "2", *LIMITS)
    rows = [*read_index(folder / "out").values()]
    wrong = wrong_rows(rows, expected)
    num_ok = sum(row["status"] == "ok" for row in rows)
    print(f"{num_ok} good grids, {len(rows) - num_ok} named with reasons, {seconds:.1f} s")
    print("\n".join(wrong) or "each as expected")
    is_fine = not wrong and status == 1 and num_ok == num_good == len(digests(folder / "out"))
    status, seconds = run(folder / "scenes", folder / "out", "--jobs", "2", "-q", *LIMITS)
    print(f"again, what failed: {seconds:.1f} s")
    return is_fine and status == 1


def show_kills(folder: Path, args: argparse.Namespace) -> bool:
    """Kill a batch again and again."""
    scenes, random_ = folder / "scenes", random.Random(args.seed)
    write_scenes(scenes, args.scenes)
    options = ("--jobs", "2", "-q", "--make", "inflated:0.3", "--set", "grid.cell_size=0.03")
    run(scenes, folder / "whole", *options)
    expected = digests(folder / "whole")
    out, kills, starts, looks = folder / "out", 0, 0, 0
    torn: set[str] = set()
    ended = threading.Event()

    def watch() -> None:
        nonlocal looks
        while not ended.is_set():
            found = digests(out)
            torn.update(name for name, digest in found.items() if expected[name] != digest)
            looks += len(found)
            time.sleep(0.005)

    watcher = threading.Thread(target=watch)
    watcher.start()
    is_done = False
    while not is_done or kills < args.kills:
        if is_done:  # begin anew
            for path in out.rglob("*.*"):
                path.unlink()
        starts += 1
        with start(scenes, out, *options) as process:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(random_.uniform(*AFTER) if kills < args.kills else None)
            is_done = process.poll() is not None
            kills += not is_done
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    ended.set()
    watcher.join()
    rows = read_index(out).values()
    is_same = digests(out) == expected and all(row["status"] == "ok" for row in rows)
    print(
        f"{kills} kills, {starts} starts, {len(expected)} files at the end "
        f"{'as undisturbed' if is_same else 'THAT DIFFER'}; a watcher read {looks:,} files, "
        f"{len(torn)} of them broken; load {os.getloadavg()[0]:.1f}"
    )
    return is_same and not torn


def show_ray(folder: Path, args: argparse.Namespace) -> bool:
    """Kill a node when half of the good scenes are done."""
    if find_spec("ray") is None:
        print("left out: ray isn't installed")
        return True
    scenes, out, cold = folder / "scenes", folder / "out", folder / "cold"
    num_good = args.scenes - 23
    expected = write_scenes(scenes, num_good, broken=20, endings=True)
    _, embedded = run(scenes, folder / "one", "--jobs", "2", "-q", *LIMITS)
    whole = digests(folder / "one")
    # the second node has no compiled code of its own
    with two_nodes(1, PYTHONPATH=str(ROOT), NUMBA_CACHE_DIR=str(cold)) as nodes:
        options = ("--executor", "ray", "--ray-address", nodes.address, *LIMITS)
        begin = time.perf_counter()
        with start(scenes, out, *options) as process:
            while process.poll() is None and len(digests(out)) < num_good // 2:
                time.sleep(0.05)
            killed, done = time.perf_counter() - begin, len(digests(out))
            is_running = process.poll() is None
            nodes.kill_second()
            status = process.wait()
        seconds = time.perf_counter() - begin
    wrong = wrong_rows([*read_index(out).values()], expected)
    is_same = digests(out) == whole
    print(
        f"a node killed after {killed:.1f} s with {done} grids; {len(digests(out))} grids at the "
        f"end {'as on one machine' if is_same else 'THAT DIFFER'}, {seconds:.1f} s, on one machine "
        f"{embedded:.1f} s; {len([*cold.rglob('*.nbc')])} files of compiled code handed on"
    )
    print("\n".join(wrong) or "each as expected")
    return is_same and is_running and not wrong and status == 1 and len(whole) == num_good


def events(folder: Path, out: Path, *options: str) -> Iterator[tuple[float, dict[str, Any]]]:
    """The lines that a batch prints, with when they came [s]."""
    command = [sys.executable, "-m", "navbake", "batch", "list.jsonl", "-o", str(out), "--json"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [*command, *options], cwd=folder, env=environment, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            yield time.perf_counter(), json.loads(line)


def measure(folder: Path, name: str, *options: str) -> tuple[float, float]:
    """Scenes a second once workers run, and the share of it that the bakes themselves take."""
    lines = [*events(folder / "scenes", folder / name, *options)]
    scenes = [(when, line) for when, line in lines if line["event"] == "scene"]
    seconds = scenes[-1][0] - scenes[0][0]
    baked = sum(sum(line["stages"].values()) for _, line in scenes[1:])
    return (len(scenes) - 1) / seconds, baked / seconds


def show_speed(folder: Path, args: argparse.Namespace) -> bool:
    """Rates and overheads; judged by a person, as the machine may be busy with other things."""
    for title, count, half, edge in (("10 ms", 600, 2.0, 0.2), ("1 s", 12, 4.0, 0.006)):
        place = folder / title.replace(" ", "-")
        write_scenes(place / "scenes", count, half=half)
        cells = ("--set", f"grid.cell_size={edge}")
        one, share = measure(place, "one", "--jobs", "1", *cells)
        two, _ = measure(place, "two", "--jobs", "2", *cells)
        rows = [*read_index(place / "one").values()]
        bake = sum(sum(row["stages"].values()) for row in rows) / len(rows)
        print(
            f"scenes of {1e3 * bake:.0f} ms: {one:.2f} a second by one worker, {two:.2f} by two, "
            f"{two / one:.2f} x; {100 * (1 / share - 1):.1f} % over the bakes; "
            f"load {os.getloadavg()[0]:.1f}"
        )
    return True


def main() -> None:
    """Show what is asked for, all if nothing is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    shows = {"faults": show_faults, "kills": show_kills, "speed": show_speed, "ray": show_ray}
    failed = []
    for part in args.parts or PARTS:
        with tempfile.TemporaryDirectory() as folder:
            print(f"-- {part}", flush=True)
            if not shows[part](Path(folder), args):
                failed.append(part)
    sys.exit(f"failed: {', '.join(failed)}" if failed else None)


if __name__ == "__main__":
    main()
