"""Shows what a batch withstands, and how fast it is.

    python scripts/sweep_batch.py [PART ...] [--kills 50] [--scenes 200] [--seed 0]
                                   [--many 2000] [--few 24] [--sliced 1000]

faults  200 scenes, 20 broken in ten ways, one that hangs, one that takes 27 GiB, one that crashes
        its process: what became of each, held against what was to become of it.
kills   a batch whose process group is killed by SIGKILL at random moments, and started again each
        time, while a thread reads the folder: at the end the grids of an undisturbed batch.
ray     the scenes of faults on a Ray cluster of two nodes, of which one is killed half way: what
        became of each, and the grids of a batch on one machine. Left out where ray isn't installed.
slices  1,000 scenes in 8 slices, two at a time, merged, and the same in one run: grids, episodes,
        shards and the index without times.
memory  what a worker grows by, over scenes of 80,000 triangles each, with the meshes that MuJoCo
        keeps by itself and with those that it keeps in a worker of a batch.
speed   what a batch adds to a loop of bakes, for scenes of 10 ms and of 1 s, and two workers
        against one; figures count while all workers are at work.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import mujoco
import trimesh

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from batch_processes import Watcher, digests, start_list  # noqa: E402 (of the tests)
from batch_scenes import draw_room, write_scenes, wrong_rows  # noqa: E402
from navbake.baker.bake.pipeline import run_bake  # noqa: E402
from navbake.batch.index import INDEX_NAME, read_index  # noqa: E402
from navbake.batch.job import MESH_CACHE_SIZE, prepare_worker  # noqa: E402
from navbake.config.settings import as_config  # noqa: E402
from navbake.formats.navgrid import write_navgrid  # noqa: E402
from ray_cluster import two_nodes  # noqa: E402

PARTS = ("faults", "kills", "speed", "ray", "slices", "memory")
NUM_SLICES = 8
NUM_MESHES = 40
TIMES = ("seconds", "stages", "ended")  # of a row of the index, which differ each time
LIMITS = ("--time-limit", "30", "--memory-limit", "4")
WARM = 4  # scenes of each worker that don't count
WHILE_STARTING = 0.2  # share of the kills that don't wait until a scene is done
AFTER = (0.0, 2.0)  # how long after its start, or a scene, a batch is killed [s]


def run(folder: Path, out: Path, *options: str) -> tuple[int, float]:
    """Run a batch; its exit status, and how long it took [s]."""
    begin = time.perf_counter()
    with start_list(folder, out, *options) as process:
        return process.wait(), time.perf_counter() - begin


def grids(out: Path) -> dict[str, str]:
    """sha256 of each grid."""
    return digests(out, "*/*.json.gz")


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
    is_fine = not wrong and status == 1 and num_ok == num_good == len(grids(folder / "out"))
    before = {path: path.stat().st_mtime_ns for path in (folder / "out").glob("*/*.gz")}
    (folder / "scenes" / "good-0000.xml").write_text(draw_room(1000))
    status, seconds = run(folder / "scenes", folder / "out", "--jobs", "2", "-q", *LIMITS)
    anew = sum(path.stat().st_mtime_ns != when for path, when in before.items())
    print(f"again, after a scene changed: {anew} baked anew, and what failed: {seconds:.1f} s")
    return is_fine and status == 1 and anew == 1


def wait_for_moment(process: subprocess.Popen[bytes], out: Path, random_: random.Random) -> None:
    """Wait until a batch is to be killed: as it starts, or after it has done another scene."""

    def size() -> int:
        return index.stat().st_size if index.exists() else 0

    index = out / INDEX_NAME
    before, starts = size(), random_.random() < WHILE_STARTING
    while not starts and process.poll() is None and size() <= before:
        time.sleep(0.01)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(random_.uniform(*AFTER))


def show_kills(folder: Path, args: argparse.Namespace) -> bool:
    """Kill a batch again and again."""
    scenes, random_ = folder / "scenes", random.Random(args.seed)
    write_scenes(scenes, args.scenes)
    options = ("--jobs", "2", "-q", "--make", "inflated:0.3", "--set", "grid.cell_size=0.03")
    run(scenes, folder / "whole", *options)
    expected = grids(folder / "whole")
    out, kills, rounds, done = folder / "out", 0, 0, []
    is_done = False
    with Watcher(out, expected) as watcher:
        while not is_done or kills < args.kills:
            if is_done:  # begin anew
                rounds += 1
                for path in [*out.rglob("*.*"), out / INDEX_NAME]:
                    path.unlink(missing_ok=True)
            with start_list(scenes, out, *options) as process:
                if kills < args.kills:
                    wait_for_moment(process, out, random_)
                else:
                    process.wait()
                is_done = process.poll() is not None
                kills += not is_done
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            done.append(len(grids(out)))
    rows = read_index(out).values()
    is_same = grids(out) == expected and all(row["status"] == "ok" for row in rows)
    leftovers = [*out.rglob("*.tmp")]
    print(
        f"{kills} kills in {len(done)} starts, files after each: {done}; {len(expected)} at the "
        f"end {'as undisturbed' if is_same else 'THAT DIFFER'}, {len(leftovers)} leftovers; a "
        f"watcher read {watcher.looks:,} files, {len(watcher.torn)} of them broken; "
        f"{rounds} times begun anew; load {os.getloadavg()[0]:.1f}"
    )
    return is_same and watcher.looks > 0 and not watcher.torn and not leftovers


def show_ray(folder: Path, args: argparse.Namespace) -> bool:
    """Kill a node when half of the good scenes are done."""
    if find_spec("ray") is None:
        print("left out: ray isn't installed")
        return True
    scenes, out = folder / "scenes", folder / "out"
    num_good = args.scenes - 23
    expected = write_scenes(scenes, num_good, broken=20, endings=True)
    _, embedded = run(scenes, folder / "one", "--jobs", "2", "-q", *LIMITS)
    whole = grids(folder / "one")
    with two_nodes(1, PYTHONPATH=str(ROOT)) as nodes:
        options = ("--executor", "ray", "--ray-address", nodes.address, *LIMITS)
        begin = time.perf_counter()
        with start_list(scenes, out, *options) as process:
            while process.poll() is None and len(grids(out)) < num_good // 2:
                time.sleep(0.05)
            killed, done = time.perf_counter() - begin, len(grids(out))
            is_running = process.poll() is None
            nodes.kill_second()
            status = process.wait()
        seconds = time.perf_counter() - begin
    wrong = wrong_rows([*read_index(out).values()], expected)
    is_same = grids(out) == whole
    print(
        f"a node killed after {killed:.1f} s with {done} grids; {len(grids(out))} grids at the "
        f"end {'as on one machine' if is_same else 'THAT DIFFER'}, {seconds:.1f} s, on one machine "
        f"{embedded:.1f} s"
    )
    print("\n".join(wrong) or "each as expected")
    return is_same and is_running and not wrong and status == 1 and len(whole) == num_good


def show_slices(folder: Path, args: argparse.Namespace) -> bool:
    """The same scenes in slices and in one run; a twentieth equal others, ten are broken."""
    scenes, parts, one = folder / "scenes", folder / "parts", folder / "one"
    write_scenes(scenes, args.sliced, broken=10, half=1.5)
    for number in range(0, args.sliced, 20):
        (scenes / f"good-{number + 1:04}.xml").write_text(draw_room(number, 1.5))
    options = ("-q", "--set", "grid.cell_size=0.2", "--make", "episodes:point:uniform:3")
    _, whole = run(scenes, one, "--jobs", "2", "--shards", "10", *options)

    def run_slice(number: int) -> float:
        return run(scenes, parts, "--slice", f"{number}/{NUM_SLICES}", *options)[1]

    with ThreadPoolExecutor(2) as pool:
        sliced = sum(pool.map(run_slice, range(1, NUM_SLICES + 1))) / 2
    _, merged = run(scenes, parts, "--merge", "--shards", "10", *options)
    of_one, of_parts = (
        {**digests(out), **digests(out, "*.tar"), **digests(out, "episodes*")}
        for out in (one, parts)
    )
    rows_of_one, rows_of_parts = (
        [
            {key: value for key, value in row.items() if key not in TIMES}
            for row in read_index(out).values()
        ]
        for out in (one, parts)
    )
    is_same = of_one == of_parts and [*rows_of_one] == [*rows_of_parts]
    indexes = [path.name for path in parts.glob("*index*")]
    before = (parts / INDEX_NAME).read_bytes().splitlines()
    run(scenes, parts, *options)
    after = (parts / INDEX_NAME).read_bytes().splitlines()
    good = [b'"status":"ok"' in line for line in before]
    same = all(a == b for a, b, ok in zip(before, after, good, strict=True) if ok)
    print(
        f"{len(of_one)} files and {len(rows_of_one)} rows of one run ({whole:.0f} s) and of "
        f"{NUM_SLICES} slices ({sliced:.0f} s, merged in {merged:.1f} s) "
        f"{'are the same' if is_same else 'DIFFER'}; indexes: {', '.join(indexes)}; a run after "
        f"that leaves the bytes of {sum(good)} rows {'as they are' if same else 'CHANGED'}"
    )
    return is_same and same and indexes == [INDEX_NAME]


def grow(folder: str, limited: bool) -> list[int]:
    """Resident memory of a worker before its first scene and after the last, and the peak [MB]."""
    prepare_worker((), False)
    cache = mujoco.mj_getCache()
    mujoco.mj_setCacheCapacity(cache, MESH_CACHE_SIZE if limited else 500 << 20)
    begin = resident()
    for path in sorted(Path(folder).glob("*.xml")):
        config = as_config({"scene": {"path": str(path)}, "grid": {"cell_size": 0.2}})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run_bake(config, threads=1)
    return [begin, resident(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10]


def resident() -> int:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() >> 20


def show_memory(folder: Path, args: argparse.Namespace) -> bool:
    """Scenes with a mesh of its own each."""
    ball = trimesh.creation.icosphere(6)
    for number in range(NUM_MESHES):
        ball.vertices *= 1 + 1e-3 * random.Random(number).random()
        ball.export(folder / f"{number}.stl")
        mesh = f'<asset><mesh name="m" file="{number}.stl"/></asset>'
        geoms = '<geom type="box" size="3 3 .1"/><geom type="mesh" mesh="m" contype="0"/>'
        text = f"<mujoco>{mesh}<worldbody>{geoms}</worldbody></mujoco>"
        (folder / f"{number}.xml").write_text(text)
    for limited in (False, True):
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            begin, end, most = pool.apply(grow, (str(folder), limited))
        kept = f"{MESH_CACHE_SIZE >> 20} MB" if limited else "500 MB"
        print(
            f"{NUM_MESHES} scenes, MuJoCo keeps meshes of {kept}: {begin} MB before, {end} MB "
            f"after, {most} MB at most",
            flush=True,
        )
    return end < 2 * begin


def loop(paths: list[str], out: str, edge: float) -> float:
    """Scenes a second that are baked and written in a loop, on one thread, warm."""
    prepare_worker((), False)
    begin = 0.0
    for number, path in enumerate(paths):
        if number == WARM:  # the first ones load what is left to load
            begin = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            config = as_config({"scene": {"path": path}, "grid": {"cell_size": edge}})
            grid = run_bake(config, threads=1).grid
            grid.timings = {}
            write_navgrid(grid, Path(out) / f"{number}.json.gz")
    return (len(paths) - WARM) / (time.perf_counter() - begin)


def measure(folder: Path, name: str, workers: int, edge: float) -> float:
    """Scenes a second of a batch while all workers are at work."""
    options = ("--json", "--jobs", str(workers), "--set", f"grid.cell_size={edge}")
    count = len((folder / "scenes" / "list.jsonl").read_text().splitlines())
    ends = []
    with start_list(folder / "scenes", folder / name, *options, stdout=-1) as process:
        assert process.stdout is not None
        ends = [time.perf_counter() for line in process.stdout if b'"event":"scene",' in line]
    first, last = WARM * workers, count - workers
    return (last - first) / (ends[last - 1] - ends[first - 1])


def show_speed(folder: Path, args: argparse.Namespace) -> bool:
    """Rates; judged by a person, as the machine may be busy with other things."""
    for title, count, half, edge in (
        ("10 ms", args.many, 2.0, 0.2),
        ("1 s", args.few, 4.0, 0.006),
    ):
        place = folder / title.replace(" ", "-")
        write_scenes(place / "scenes", count, half=half)
        (place / "loop").mkdir()
        paths = [str(path) for path in sorted((place / "scenes").glob("*.xml"))[:500]]
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            alone = pool.apply(loop, (paths, str(place / "loop"), edge))
        one, two = (measure(place, f"{count}", count, edge) for count in (1, 2))
        print(
            f"{count} scenes of {title}, a second: {alone:.2f} baked and written in a loop, "
            f"{one:.2f} by a worker, {two:.2f} by two; load {os.getloadavg()[0]:.1f}",
            flush=True,
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
    parser.add_argument("--many", type=int, default=2000, help="scenes of 10 ms")
    parser.add_argument("--few", type=int, default=24, help="scenes of 1 s")
    parser.add_argument("--sliced", type=int, default=1000, help="scenes in slices")
    args = parser.parse_args()
    shows = {"faults": show_faults, "kills": show_kills, "speed": show_speed, "ray": show_ray}
    shows |= {"slices": show_slices, "memory": show_memory}
    failed = []
    for part in args.parts or PARTS:
        with tempfile.TemporaryDirectory() as folder:
            print(f"-- {part}", flush=True)
            if not shows[part](Path(folder), args):
                failed.append(part)
    sys.exit(f"failed: {', '.join(failed)}" if failed else None)


if __name__ == "__main__":
    main()
