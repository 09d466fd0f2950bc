"""What bakes are compared with: Recast, and the plain Python loop that one would write first.

Recast is the navigation mesh builder of game engines; it is compiled here, and run on triangles.
It takes Debian's `librecast-dev` and g++. Where either is missing, rows say so. The loop casts rays
down each column, then asks FCL.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from functools import cache
from pathlib import Path
from typing import Any

import fcl
import mujoco
import numpy as np

from benchmarks.measure import Job, Sample, run_process
from benchmarks.scenes import AGENT, CELL, MAX_SLOPE, RADIUS, STEP, Soup, num_cells
from make_house import ROOM

SOURCE = Path(__file__).with_name("recast.cpp")
HEADERS = Path("/usr/include/recastnavigation")
SAMPLE = 100  # cells that the loop bakes; all others are taken to cost as much


@cache
def why_no_recast() -> str:
    """Say why Recast can't be run here; empty where it can."""
    if shutil.which("g++") is None:
        return "no Recast to compare with: there is no g++"
    return "" if HEADERS.is_dir() else "no Recast to compare with: apt install librecast-dev"


def recast_job(folder: Path, soup: Soup) -> Job:
    """Recast from rasterizing to regions, over a soup of triangles, without reading them."""
    program, path = folder / "recast_bench", folder / f"{soup.path.stem}.triangles"
    if not program.exists():
        flags = ["-std=c++17", "-O3", "-DNDEBUG", f"-I{HEADERS}"]
        command = ["g++", *flags, str(SOURCE), "-o", str(program), "-lRecast"]
        subprocess.run(command, check=True)

    def measure() -> Sample:
        if not path.exists():
            _write(path, soup)
        numbers = [str(value) for value in (CELL, STEP, AGENT, RADIUS, MAX_SLOPE)]
        return run_process([str(program), str(path), *numbers])

    return Job("Recast, rasterize to regions", measure)


def _write(path: Path, soup: Soup) -> None:
    """Write what the program reads: y is up, and the corners stay anticlockwise from outside."""
    vertices, corners = soup.read()
    turned = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
    counts = np.array([len(vertices), len(corners)], "<i4")
    parts = counts, turned.astype("<f4"), corners.astype("<i4")
    path.write_bytes(b"".join(part.tobytes() for part in parts))


# --- the plain loop ------------------------------------------------------------------------


def plain_loop_job(path: Path, rooms: int) -> Job:
    """The loop over all cells of a house, extrapolated from a sample."""

    def measure() -> Sample:
        seconds = sum(time_plain_loop(path, rooms, SAMPLE)) * num_cells(rooms)
        return Sample(seconds, None, {"from cells": SAMPLE})

    return Job("plain Python loop, extrapolated", measure)


def time_plain_loop(path: Path, rooms: int, sample: int) -> tuple[float, float]:
    """Bake a random sample of cells cell by cell; return its seconds, a cell, (rays, FCL)."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    objects, low, high = _fcl_objects(model, data)
    edge = float(np.sqrt(rooms)) * ROOM
    cells = np.random.default_rng(0).integers(0, round(edge / CELL), (sample, 2))
    start = time.perf_counter()
    floors = [_floor(model, data, (col + 0.5) * CELL, (row + 0.5) * CELL) for row, col in cells]
    middle = time.perf_counter()
    for (row, col), floor in zip(cells, floors, strict=True):
        if floor is None:
            continue
        # the cell's box above the floor, with all geoms whose bounds it meets
        place = np.array([(col + 0.5) * CELL, (row + 0.5) * CELL, floor + (STEP + AGENT) / 2])
        size = np.array([CELL, CELL, AGENT - STEP])
        box = fcl.CollisionObject(fcl.Box(*size), fcl.Transform(place))
        meets = (low <= place + size / 2).all(axis=1) & (high >= place - size / 2).all(axis=1)
        request = fcl.CollisionRequest()
        _ = any(fcl.collide(box, objects[i], request, fcl.CollisionResult())
                for i in np.flatnonzero(meets))  # fmt: skip
    return (middle - start) / sample, (time.perf_counter() - middle) / sample


def _floor(model: Any, data: Any, x: float, y: float) -> float | None:
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


def _fcl_objects(model: Any, data: Any) -> tuple[list[Any], np.ndarray, np.ndarray]:
    """FCL's objects and the bounds of all geoms but the ground plane, which is below all."""
    objects, low, high = [], [], []
    for g in range(model.ngeom):
        kind, size = mujoco.mjtGeom(model.geom_type[g]), model.geom_size[g]
        if kind == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        rotation, position = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g].copy()
        shape = _fcl_shape(model, g, kind, size)
        objects.append(fcl.CollisionObject(shape, fcl.Transform(rotation, position)))
        middle = position + rotation @ model.geom_aabb[g, :3]
        extent = abs(rotation) @ model.geom_aabb[g, 3:]
        low.append(middle - extent)
        high.append(middle + extent)
    return objects, np.array(low), np.array(high)


def _fcl_shape(model: Any, geom: int, kind: Any, size: np.ndarray) -> Any:
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
