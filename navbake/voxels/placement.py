"""Where a voxel grid lies: from a centre and counts, a size in metres, or a whole scene's box."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import ConfigError
from navbake.navgrid.lattice import CELL_SLACK, num_cells
from navbake.types import Float

MANY = 2**200  # more than any memory, and still a float
FINEST = 1e-5  # least edge of a voxel, well above what counts as touching [m]


@dataclass(frozen=True)
class Placement:
    """A box of voxels.

    Attributes:
        origin: its lower corner, shape (3,), float64, world frame [m].
        res: edge of a voxel [m].
        shape: voxels along x, y and z.
        moved: how far it lies from where it was asked for [m].
    """

    origin: Float
    res: float
    shape: tuple[int, int, int]
    moved: float = 0.0


def place_grid(
    position: ArrayLike | None,
    cells: Sequence[int] | None,
    size: Sequence[float] | None,
    res: float,
    bounds: Float | None,
    *,
    align: bool = False,
) -> Placement:
    """Place a voxel grid.

    With a centre it covers ``cells * res`` round it. With a size, it has as many cells as cover
    that. With neither it covers the scene's box, its corners on whole multiples of `res`.

    Args:
        position: the centre, shape (3,), world frame [m]; the middle of the scene's box if None.
        cells: voxels along x, y and z, >= 1 each.
        size: or what they cover [m], > 0 each.
        res: edge of a voxel [m], >= 1e-5.
        bounds: the scene's box, shape (2, 3) [m], or None if it is endless.
        align: move the grid by half a voxel at most, so that its corners lie on whole multiples
            of `res`, as the voxels of an octree do.

    Raises:
        ConfigError: a number is wrong, or both cells and size are given, or a centre alone.
    """
    edge = _check_res(res)
    if cells is not None and size is not None:
        raise ConfigError("expected either counts of cells or a size in metres, got both")
    if cells is None and size is None:
        if position is not None:
            raise ConfigError("expected counts of cells or a size in metres beside the centre")
        return _cover(_check_bounds(bounds), edge)
    shape = _check_cells(cells) if cells is not None else _count_cells(size, edge)
    check_memory(shape, 1)  # before such numbers meet arrays
    if position is None:
        center = _check_bounds(bounds).mean(axis=0)
    else:
        center = check_three(position, "the centre to be x, y, z [m]")
    origin = center - np.array(shape) * edge / 2
    if not align:
        return Placement(origin, edge, shape)
    aligned = np.round(origin / edge) * edge
    return Placement(aligned, edge, shape, float(np.abs(aligned - origin).max()))


def check_memory(shape: Sequence[int], itemsize: int) -> None:
    """Raise for a grid that does not fit into free memory.

    Raises:
        ConfigError: it needs more than there is.
    """
    needed, free = min(math.prod(shape) * itemsize, MANY), _free_memory()
    if needed > free:
        raise ConfigError(
            f"a grid of {' × '.join(_short(n) for n in shape)} voxels takes "
            f"{needed / 2**30:.3g} GiB, and "
            f"{free / 2**30:.3g} GiB of memory are free: expected fewer or larger voxels"
        )


def _short(count: int) -> str:
    return str(count) if count < 10**15 else f"{min(count, MANY):.3g}"


def _cover(bounds: Float, res: float) -> Placement:
    first = np.floor(bounds[0] / res + CELL_SLACK)
    last = np.maximum(np.ceil(bounds[1] / res - CELL_SLACK), first + 1)
    nx, ny, nz = (int(n) for n in last - first)
    return Placement(first * res, res, (nx, ny, nz))


def _check_res(res: Any) -> float:
    try:
        edge = float(res)
    except (TypeError, ValueError):
        edge = math.nan
    if not (math.isfinite(edge) and edge >= FINEST):
        raise ConfigError(f"expected `res`, the edge of a voxel, to be >= {FINEST:g} m, got {res}")
    return edge


def _check_cells(cells: Sequence[Any]) -> tuple[int, int, int]:
    counts = list(cells) if np.iterable(cells) else [cells]
    whole = all(
        isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in counts
    )
    if len(counts) != 3 or not whole:
        raise ConfigError(f"expected 3 counts of cells, whole numbers >= 1, got {counts}")
    nx, ny, nz = (int(n) for n in counts)
    return nx, ny, nz


def _count_cells(size: ArrayLike | None, res: float) -> tuple[int, int, int]:
    extent = check_three(size, "a size x, y, z in metres")
    if not (extent > 0).all():
        raise ConfigError(f"expected a size > 0 m along each axis, got {extent.tolist()}")
    nx, ny, nz = (num_cells(min(float(length), MANY * res), res) for length in extent)
    return nx, ny, nz


def check_three(value: ArrayLike | None, expected: str) -> Float:
    """Three finite numbers, shape (3,), float64.

    Raises:
        ConfigError: they are not; the message says what was `expected`.
    """
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.full(0, np.nan)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ConfigError(f"expected {expected}, got {value!r}")
    return numbers


def _check_bounds(bounds: Float | None) -> Float:
    if bounds is None:
        raise ConfigError(
            "only infinite planes count in the scene, so its box has no end: "
            "give a centre, and counts of cells or a size"
        )
    if not np.isfinite(bounds).all():
        raise ConfigError(
            "the scene has geoms with a pose that is not finite: give a centre and a size"
        )
    return bounds


def _free_memory() -> int:
    """Memory that can be had without swapping [bytes]; 2**62 where the system does not say."""
    free = 2**62
    try:
        with open("/sys/fs/cgroup/memory.max", encoding="ascii") as file:  # a container's
            free = int(file.read())
    except (OSError, ValueError):  # ValueError: "max"
        pass
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return min(free, int(line.split()[1]) * 1024)
    except (OSError, ValueError, IndexError):
        pass
    try:
        return min(free, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):  # not on Windows
        return free
