"""The plain Python loop that one would write first: rays down each column, then FCL."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import fcl
import mujoco
import numpy as np

from benchmarks.measure import Job, Sample
from benchmarks.scenes import AGENT, CELL, STEP, num_cells
from make_house import ROOM

SAMPLE = 100  # cells that are baked; all others are taken to cost as much


def plain_loop_job(path: Path, rooms: int) -> Job:
    """The loop over all cells of a house, extrapolated from a sample."""

    def measure() -> Sample:
        rays, contacts = time_plain_loop(path, rooms, SAMPLE)
        return Sample((rays + contacts) * num_cells(rooms), None, {"from cells": SAMPLE})

    return Job("plain Python loop, extrapolated", measure)


def time_plain_loop(path: Path, rooms: int, sample: int) -> tuple[float, float]:
    """Bake a random sample of cells cell by cell; return its seconds, a cell, (rays, FCL)."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    objects, low, high = make_fcl_objects(model, data)
    edge = float(np.sqrt(rooms)) * ROOM
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
