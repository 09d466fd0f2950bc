"""Flights through voxels, slowly: distances, moves and routes by definition, and in MuJoCo."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from navbake.voxels.grid import VoxelGrid

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]

NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]
TOLERANCE = 1e-9  # as in the finder [m]


def measure_distances(occupied: Mask, res: float) -> Floats:
    """From each voxel's centre to the nearest point of the nearest occupied cube, one by one."""
    cubes = np.argwhere(occupied)
    distances = np.full(occupied.shape, np.inf)
    if len(cubes):
        for voxel in np.ndindex(occupied.shape):
            excess = np.maximum(np.abs(cubes - np.array(voxel)) - 0.5, 0.0)
            distances[voxel] = res * np.sqrt((excess**2).sum(axis=1).min())
    return distances


def distance_of_line(begin: Floats, end: Floats, cubes: Floats, res: float) -> float:
    """The least distance of a line from cubes, by their centres."""
    return float(distances_of_line(begin, end, cubes, res).min(initial=np.inf))


def distances_of_line(begin: Floats, end: Floats, cubes: Floats, res: float) -> Floats:
    """The distance of a line from each cube: golden sections, all at once.

    Each cube may have a line of its own: `begin` and `end` are then arrays like `cubes`.
    """
    ratio = (np.sqrt(5.0) - 1.0) / 2.0

    def measure(shares: Floats) -> Floats:
        points = begin + shares[:, None] * (end - begin)
        return np.linalg.norm(np.maximum(np.abs(points - cubes) - res / 2, 0.0), axis=1)

    low, high = np.zeros(len(cubes)), np.ones(len(cubes))
    for _ in range(40):
        first, second = high - ratio * (high - low), low + ratio * (high - low)
        is_lower = measure(first) <= measure(second)
        low, high = np.where(is_lower, low, first), np.where(is_lower, second, high)
    ends = np.minimum(measure(np.zeros(len(cubes))), measure(np.ones(len(cubes))))
    return np.asarray(np.minimum(measure(low), ends))


def fits(voxels: VoxelGrid, radius: float, heights: tuple[float, float] | None = None) -> Mask:
    """Where a ball round a voxel's centre is in the grid and meets no occupied cube."""
    is_free = measure_distances(voxels.occupied, voxels.res) >= radius - TOLERANCE
    low, high = voxels.bounds
    for voxel in np.ndindex(voxels.shape):
        center = low + (np.array(voxel) + 0.5) * voxels.res
        if ((center - low < radius - TOLERANCE) | (high - center < radius - TOLERANCE)).any():
            is_free[voxel] = False
        if heights and not heights[0] <= center[2] <= heights[1]:
            is_free[voxel] = False
    return is_free


def make_graph(
    voxels: VoxelGrid, radius: float, cost: float = 0.0, heights: tuple[float, float] | None = None
) -> csr_array:
    """All moves of a ball between free neighbours, with their costs: each tried for itself."""
    is_free = fits(voxels, radius, heights)
    distances = measure_distances(voxels.occupied, voxels.res)
    cubes = voxels.centers()
    origin = np.array(voxels.origin)
    rows, columns, costs = [], [], []
    for step in NEIGHBOURS:
        begins = np.argwhere(is_free)
        ends = begins + step
        is_inside = ((ends >= 0) & (ends < voxels.shape)).all(axis=1)
        begins, ends = begins[is_inside], ends[is_inside]
        begins, ends = begins[is_free[tuple(ends.T)]], ends[is_free[tuple(ends.T)]]
        begin_at = origin + (begins + 0.5) * voxels.res
        end_at = origin + (ends + 0.5) * voxels.res
        is_near = np.abs(cubes - begin_at[:, None]).max(axis=2) < radius + 2.0 * voxels.res
        move, cube = np.nonzero(is_near)
        least = np.full(len(begins), np.inf)
        pair_distances = distances_of_line(begin_at[move], end_at[move], cubes[cube], voxels.res)
        np.minimum.at(least, move, pair_distances)
        is_clear = least >= radius - TOLERANCE
        begins, ends = begins[is_clear], ends[is_clear]
        weights = [1.0 + cost / distances[tuple(each.T)] for each in (begins, ends)]
        rows.append(np.ravel_multi_index(tuple(begins.T), voxels.shape))
        columns.append(np.ravel_multi_index(tuple(ends.T), voxels.shape))
        costs.append(np.linalg.norm(step) * voxels.res * (weights[0] + weights[1]) / 2)
    size = voxels.values.size
    entries = np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))
    return coo_array(entries, shape=(size, size)).tocsr()


def make_large_graph(voxels: VoxelGrid, radius: float, cost: float = 0.0) -> csr_array:
    """The same graph for large grids: each move dilates what is occupied by all that it sweeps."""
    reach = int(radius / voxels.res) + 3
    offsets = np.array([*itertools.product(range(-reach, reach + 1), repeat=3)])

    def is_met(step: tuple[int, int, int]) -> Mask:
        end = np.array(step) * voxels.res
        distances = distances_of_line(np.zeros(3), end, offsets * voxels.res, voxels.res)
        swept = distances < radius - TOLERANCE
        # dilation adds the structure to what is occupied; here it is to be looked up from the voxel
        structure = np.reshape(swept, 3 * (2 * reach + 1,))[::-1, ::-1, ::-1]
        return np.asarray(ndimage.binary_dilation(voxels.occupied, structure))

    is_free = ~is_met((0, 0, 0))
    for axis, count in enumerate(voxels.shape):
        to_border = (np.minimum(np.arange(count), np.arange(count)[::-1]) + 0.5) * voxels.res
        too_near = to_border < radius - TOLERANCE
        is_free &= ~np.expand_dims(too_near, tuple({0, 1, 2} - {axis}))
    weights = np.ones(voxels.shape)
    if cost:
        weights += cost / np.maximum(voxels.distances().values, 1e-9)
    numbers = np.arange(voxels.values.size).reshape(voxels.shape)
    rows, columns, costs = [], [], []
    for step in NEIGHBOURS:
        begins = tuple(slice(max(-d, 0), min(-d, 0) or None) for d in step)
        ends = tuple(slice(max(d, 0), min(d, 0) or None) for d in step)
        is_clear = is_free[begins] & is_free[ends] & ~is_met(step)[begins]
        rows.append(numbers[begins][is_clear])
        columns.append(numbers[ends][is_clear])
        means = (weights[begins][is_clear] + weights[ends][is_clear]) / 2
        costs.append(np.linalg.norm(step) * voxels.res * means)
    size = voxels.values.size
    entries = np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))
    return coo_array(entries, shape=(size, size)).tocsr()


def find_costs(graph: csr_array, sources: list[int]) -> Floats:
    """Costs from some voxels, by their flat numbers, to all others: scipy's Dijkstra."""
    return np.asarray(dijkstra(graph, directed=False, indices=sources))


# --- in MuJoCo ------------------------------------------------------------------------------------


class CapsuleProbe:
    """Measures how far the geoms of a scene are from a ball that flies along lines.

    Args:
        path: the scene, as MJCF.
        counted: which of its geoms count, by id.
        joints: positions of its joints, qpos.
    """

    def __init__(self, path: str, counted: list[bool], joints: Floats) -> None:
        spec = mujoco.MjSpec.from_file(path)
        body = spec.worldbody.add_body(name="probe", mocap=True)
        body.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.1, 0.1, 0])
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self.model, self.data)
        self.probe = int(self.model.geom("probe").id)
        names = [geom for geom in range(self.model.ngeom) if geom != self.probe]
        self.geoms = [geom for geom, is_counted in zip(names, counted, strict=True) if is_counted]

    def clearance(self, begin: Floats, end: Floats, radius: float) -> float:
        """The distance of the nearest geom from the swept ball [m], negative where it meets one."""
        length = float(np.linalg.norm(end - begin))
        rotation = np.zeros(9)
        direction = (end - begin) / length if length else np.array([0.0, 0.0, 1.0])
        quaternion = np.zeros(4)
        mujoco.mju_quatZ2Vec(quaternion, direction)
        mujoco.mju_quat2Mat(rotation, quaternion)
        self.model.geom_size[self.probe] = (radius, length / 2, 0)
        self.model.geom_rbound[self.probe] = radius + length / 2
        self.data.geom_xpos[self.probe] = (begin + end) / 2
        self.data.geom_xmat[self.probe] = rotation
        least = 0.05
        for geom in self.geoms:
            distance = mujoco.mj_geomDistance(self.model, self.data, self.probe, geom, least, None)
            least = min(least, float(distance))
        return least
