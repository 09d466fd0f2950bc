"""Where a voxel grid lies: from a centre and counts, a size in metres, or a whole scene's box."""

import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import ConfigError
from navbake.navgrid.lattice import CELL_SLACK, num_cells
from navbake.types import Float

MANY = 2**200  # more than any memory, and still a float
FINEST = 1e-5  # least edge of a voxel, well above what counts as touching [m]


@dataclass(frozen=True)
class Placement:
    """A box of voxels from its lower corner `origin`, (3,), on; `moved` from where it was asked.

    World frame; metres.
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

    The box round the centre `position` (the middle of the scene's box if None) is ``cells * res``,
    or as many whole voxels as cover `size`. Without both it covers the scene's box `bounds`,
    (2, 3) [m], None if endless, with corners on whole multiples of `res`. `align` moves
    any box onto such multiples, as octrees need it: by half a voxel at most.

    Raises:
        ConfigError: a number is wrong, or both cells and size are given, or a centre alone.
    """
    given = finite_array(res, ())
    if given is None or given < FINEST:
        raise ConfigError(f"expected `res`, the edge of a voxel, to be >= {FINEST:g} m, got {res}")
    edge = float(given)
    if cells is not None and size is not None:
        raise ConfigError("expected either counts of cells or a size in metres, got both")
    covers = cells is None and size is None
    if covers and position is not None:
        raise ConfigError("expected counts of cells or a size in metres beside the centre")
    if position is not None:
        center = check_three(position, "the centre to be x, y, z [m]")
    elif bounds is None:
        why = "only infinite planes count in the scene, so its box has no end"
        raise ConfigError(f"{why}: give a centre, and counts of cells or a size")
    elif not np.isfinite(bounds).all():
        why = "the scene has geoms with a pose that is not finite"
        raise ConfigError(f"{why}: give a centre and a size")
    else:
        center = bounds.mean(axis=0)
    if bounds is not None and covers:
        first = np.floor(bounds[0] / edge + CELL_SLACK)
        last = np.maximum(np.ceil(bounds[1] / edge - CELL_SLACK), first + 1)
        nx, ny, nz = (int(n) for n in last - first)
        return Placement(first * edge, edge, (nx, ny, nz))
    if cells is not None:
        counts = list(cells) if np.iterable(cells) else [cells]
        if len(counts) != 3 or not all(
            isinstance(n, int | np.integer) and n is not True and n > 0 for n in counts
        ):
            raise ConfigError(f"expected 3 counts of cells, whole numbers >= 1, got {counts}")
        nx, ny, nz = map(int, counts)
    else:
        extent = check_three(size, "a size x, y, z in metres")
        if not (extent > 0).all():
            raise ConfigError(f"expected a size > 0 m along each axis, got {extent.tolist()}")
        nx, ny, nz = (num_cells(min(float(length), MANY * edge), edge) for length in extent)
    check_memory((nx, ny, nz), 1)  # before such numbers meet arrays
    origin = center - np.array((nx, ny, nz)) * edge / 2
    aligned = np.round(origin / edge) * edge if align else origin
    return Placement(aligned, edge, (nx, ny, nz), float(np.abs(aligned - origin).max()))


def check_memory(shape: Sequence[int], itemsize: int) -> None:
    """Raise a ConfigError for a grid that does not fit into free memory."""
    needed, free = min(math.prod(shape) * itemsize, MANY), _free_memory()
    if needed > free:
        counts = (str(n) if n < 10**15 else f"{min(n, MANY):.3g}" for n in shape)
        raise ConfigError(
            f"a grid of {' × '.join(counts)} voxels takes {needed / 2**30:.3g} GiB, and "
            f"{free / 2**30:.3g} GiB of memory are free: expected fewer or larger voxels"
        )


def finite_array(value: object, shape: tuple[int, ...]) -> Float | None:
    """A value as float64 if it is finite numbers of that shape, else None."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return numbers if numbers.shape == shape and np.isfinite(numbers).all() else None


def check_three(value: ArrayLike | None, expected: str) -> Float:
    """Three finite numbers, or a ConfigError that says what was `expected`."""
    numbers = finite_array(value, (3,))
    if numbers is None:
        raise ConfigError(f"expected {expected}, got {value!r}")
    return numbers


def _free_memory() -> int:
    """Memory that can be had without swapping [bytes]; 2**62 where the system does not say."""
    free = 2**62
    # ValueError: a container's limit is "max"; IndexError: a line without a number
    with suppress(OSError, ValueError):
        free = int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii"))
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return min(free, int(line.split()[1]) * 1024)
    with suppress(AttributeError, ValueError, OSError):  # there is no sysconf on Windows
        free = min(free, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return free
