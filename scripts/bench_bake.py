"""Measures the bake of house-N, next to the plain Python loop that one would write first.

Start-up is left out: each bake runs in a process of its own, after a small one that warms the
kernels up. The loading of the scene (MJCF compiled, geoms collected) counts, and is also shown
apart. The least of several runs is printed, as machines are noisy.

    python scripts/bench_bake.py [--sample 300] [--repeats 3] [--threads N]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import fcl
import mujoco
import numpy as np

from make_house import ROOM, make_house
from navbake.baker.pipeline import run_bake
from navbake.config.settings import BakeConfig, parse_config

CELL = 0.05  # [m]
STEP, AGENT = 0.25, 1.14  # traversable floor height and height of the agent [m]
MAIN = 100  # rooms of the house that is compared with the loop
SIZES = (4, 25, 100, 400)
LIMITS = "at most 6 s and 2048 MiB on 2 cores"
RATIO_LIMIT = 1.3
SHARE_LIMIT = 0.3
SHORT = 0.5  # bakes are repeated for at least this long [s]
DOORS_LIMIT = 1.0  # on all doors of the main house [s]


# --- the plain loop ------------------------------------------------------------------------


def time_plain_loop(path: Path, sample: int) -> tuple[float, float]:
    """Bake a random sample of cells cell by cell; return its seconds, a cell, (rays, FCL)."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    objects, low, high = make_fcl_objects(model, data)
    edge = float(np.sqrt(MAIN)) * ROOM
    cells = np.random.default_rng(0).integers(0, round(edge / CELL), (sample, 2))
    start = time.perf_counter()
    floors = [find_floor(model, data, (col + 0.5) * CELL, (row + 0.5) * CELL) for row, col in cells]
    middle = time.perf_counter()
    for (row, col), floor in zip(cells, floors, strict=True):
        if floor is not None:
            is_occupied(objects, low, high, (col + 0.5) * CELL, (row + 0.5) * CELL, floor)
    return (middle - start) / sample, (time.perf_counter() - middle) / sample


def find_floor(model: Any, data: Any, x: float, y: float) -> float | None:
    """Follow a ray down through everything; the floor is the lowest face that looks up."""
    geom, normal, down = np.zeros(1, np.int32), np.zeros(3), np.array([0.0, 0.0, -1.0])
    z, floor = 10.0, None
    while True:
        origin = np.array([x, y, z])
        distance = mujoco.mj_ray(model, data, origin, down, None, 1, -1, geom, normal)
        if distance < 0:
            return floor
        z -= distance
        if normal[2] > 0.7 and z > -0.1:  # not the ground below the slab
            floor = z
        z -= 1e-6


def is_occupied(
    objects: list[Any], low: np.ndarray, high: np.ndarray, x: float, y: float, floor: float
) -> bool:
    """Collide the cell's box above the floor with all geoms whose bounds it meets."""
    bottom, top, half = floor + STEP, floor + AGENT, CELL / 2
    box = fcl.CollisionObject(
        fcl.Box(CELL, CELL, top - bottom), fcl.Transform(np.array([x, y, (bottom + top) / 2]))
    )
    lower, upper = (x - half, y - half, bottom), (x + half, y + half, top)
    near = np.flatnonzero((low <= upper).all(axis=1) & (high >= lower).all(axis=1))
    request = fcl.CollisionRequest()
    return any(fcl.collide(box, objects[i], request, fcl.CollisionResult()) for i in near)


def make_fcl_objects(model: Any, data: Any) -> tuple[list[Any], np.ndarray, np.ndarray]:
    """Make FCL's objects and bounds of all geoms but the ground plane, which is below all."""
    objects, low, high = [], [], []
    for g in range(model.ngeom):
        kind, size = mujoco.mjtGeom(model.geom_type[g]), model.geom_size[g]
        if kind == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        rotation, position = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g].copy()
        objects.append(
            fcl.CollisionObject(
                make_fcl_shape(model, g, kind, size), fcl.Transform(rotation, position)
            )
        )
        middle = position + rotation @ model.geom_aabb[g, :3]
        extent = abs(rotation) @ model.geom_aabb[g, 3:]
        low.append(middle - extent)
        high.append(middle + extent)
    return objects, np.array(low), np.array(high)


def make_fcl_shape(model: Any, geom: int, kind: Any, size: np.ndarray) -> Any:
    types = mujoco.mjtGeom
    if kind == types.mjGEOM_BOX:
        return fcl.Box(*(2 * size))
    if kind == types.mjGEOM_SPHERE:
        return fcl.Sphere(size[0])
    if kind == types.mjGEOM_CYLINDER:
        return fcl.Cylinder(size[0], 2 * size[1])
    if kind == types.mjGEOM_CAPSULE:
        return fcl.Capsule(size[0], 2 * size[1])
    mesh = model.mesh(model.geom_dataid[geom])
    vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    faces = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
    shape = fcl.BVHModel()
    shape.beginModel(len(vertices), len(faces))
    shape.addSubModel(vertices.astype(float), faces)
    shape.endModel()
    return shape


# --- navbake -------------------------------------------------------------------------------


def settings_of(path: Path, bare: bool = False) -> BakeConfig:
    settings: dict[str, Any] = {"scene": {"path": str(path)}, "grid": {"cell_size": CELL}}
    if bare:
        settings |= {"rooms": "none", "doors": {"find": False}, "names": False}
    return parse_config(settings)


def measure_here(path: Path, warm_up: Path, threads: int | None, bare: bool) -> dict[str, Any]:
    """Bake in this process, to warm up and then by the clock; short bakes several times."""
    run_bake(settings_of(warm_up, bare), threads=threads)
    start = time.perf_counter()
    mujoco.MjModel.from_xml_path(str(path))
    compiled = time.perf_counter()
    total, spent = float("inf"), 0.0
    while spent < SHORT:
        begin = time.perf_counter()
        done = run_bake(settings_of(path, bare), threads=threads)
        took = time.perf_counter() - begin
        spent += took
        if took < total:
            total, result = took, done
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "timings": result.timings,
        "doors": len(result.grid.doors),
        "total": total,
        "compile": compiled - start,
        "peak": peak / (2**20 if sys.platform == "darwin" else 2**10),  # [MiB]
    }


def measure(
    path: Path, warm_up: Path, repeats: int, threads: int | None, bare: bool = False
) -> dict[str, Any]:
    """Bake in processes of their own; return the fastest run, with the highest peak of all."""
    command = [sys.executable, __file__, "--bake", str(path), "--warm-up", str(warm_up)]
    command += ["--threads", str(threads)] if threads else []
    command += ["--bare"] if bare else []
    runs = []
    for _ in range(repeats):
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        runs.append(json.loads(done.stdout))
    best = min(runs, key=lambda run: run["total"])
    return {**best, "peak": max(run["peak"] for run in runs)}


# --- the report ----------------------------------------------------------------------------


def num_cells(rooms: int) -> float:
    return rooms * (ROOM / CELL) ** 2


def report_loop(path: Path, sample: int) -> float:
    """Print what the plain loop takes; return its seconds for all cells."""
    rays, contacts = time_plain_loop(path, sample)
    total = (rays + contacts) * num_cells(MAIN)
    print(f"plain Python loop over house-{MAIN}, from {sample} cells of {num_cells(MAIN):,.0f}")
    print(f"  mj_ray down each column  {rays * 1e6:8.1f} µs a cell")
    print(f"  fcl.collide, near geoms  {contacts * 1e6:8.1f} µs a cell")
    print(f"  all cells                {total:8.1f} s, extrapolated")
    return total


def report_bake(run: dict[str, Any], loop: float) -> None:
    scene = run["timings"]["scene"]
    print(f"\nnavbake over house-{MAIN} at {CELL} m  (asked for: {LIMITS})")
    for stage, seconds in run["timings"].items():
        print(f"  {stage:<24} {seconds:8.2f} s")
    print(
        f"  total                    {run['total']:8.2f} s, loop / bake = {loop / run['total']:.0f}"
    )
    print(f"  total without scene      {run['total'] - scene:8.2f} s")
    print(f"  MJCF compile alone       {run['compile']:8.2f} s, part of scene")
    print(f"  peak memory              {run['peak']:8.0f} MiB")


def report_share(run: dict[str, Any], bare: dict[str, Any]) -> None:
    share = run["total"] / bare["total"] - 1
    print(f"\nrooms, doors and names  (asked for: at most {SHARE_LIMIT:.0%} more)")
    print(f"  total without them       {bare['total']:8.2f} s")
    print(f"  total with them          {run['total']:8.2f} s, {share:.0%} more")


def report_scaling(runs: dict[int, dict[str, Any]]) -> None:
    print("\nrooms      cells   total s   without scene   µs a cell   without scene   peak MiB")
    whole, baked = [], []
    for rooms, run in runs.items():
        scene, cells = run["timings"]["scene"], num_cells(rooms)
        whole.append(run["total"] / cells * 1e6)
        baked.append((run["total"] - scene) / cells * 1e6)
        print(
            f"{rooms:5} {cells:10,.0f} {run['total']:9.2f} {run['total'] - scene:15.2f}"
            f" {whole[-1]:11.2f} {baked[-1]:15.2f} {run['peak']:10.0f}"
        )
    print(
        f"max / min of the cost per cell: {max(whole) / min(whole):.2f}, without scene"
        f" {max(baked) / min(baked):.2f}  (asked for: at most {RATIO_LIMIT})"
    )


def report_doors(run: dict[str, Any], plain: dict[str, Any]) -> None:
    seconds = run["timings"]["doors"]
    print(f"\nhouse-{MAIN} with {run['doors']} doors, each in all its states")
    print(f"  doors                    {seconds:8.2f} s  (asked for: at most {DOORS_LIMIT:g} s)")
    print(f"  total                    {run['total']:8.2f} s, without doors {plain['total']:.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the bake of houses of many rooms.")
    parser.add_argument("--sample", type=int, default=300, help="cells of the plain loop")
    parser.add_argument("--repeats", type=int, default=3, help="bakes of each house")
    parser.add_argument("--threads", type=int, help="default: all cores")
    parser.add_argument("--bake", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--warm-up", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--bare", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.bake:
        print(json.dumps(measure_here(given.bake, given.warm_up, given.threads, given.bare)))
        return
    with tempfile.TemporaryDirectory() as folder:
        paths = {rooms: Path(folder) / f"house-{rooms}.xml" for rooms in SIZES}
        for rooms, path in paths.items():
            path.write_text(make_house(rooms), encoding="utf-8")
        loop = report_loop(paths[MAIN], given.sample)
        runs = {}
        how = (paths[SIZES[0]], given.repeats, given.threads)
        for rooms in sorted(SIZES, key=lambda n: n != MAIN):
            runs[rooms] = measure(paths[rooms], *how)
            if rooms == MAIN:
                report_bake(runs[rooms], loop)
                report_share(runs[rooms], measure(paths[rooms], *how, bare=True))
                path = Path(folder) / f"house-{MAIN}-doors.xml"
                path.write_text(make_house(MAIN, with_doors=True), encoding="utf-8")
                report_doors(measure(path, *how), runs[rooms])
        report_scaling({rooms: runs[rooms] for rooms in SIZES})


if __name__ == "__main__":
    main()
