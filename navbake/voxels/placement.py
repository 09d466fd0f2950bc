"""Places a voxel grid by a centre and counts, a size in metres, or a scene's bounding box."""

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
FINEST = 1e-5  # least edge of a voxel, well above the tolerance of touching [m]


@dataclass(frozen=True)
class Placement:
    """A box of voxels with the lower corner `origin`, (3,) [m], and how far it was `moved`."""

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

    The box round the centre `position` (that of the scene's box if None) is ``cells * res``, or the
    whole voxels that cover `size`. Without both it covers the scene's box `bounds`, (2, 3) [m],
    None if endless, with corners on multiples of `res`. `align` moves any box onto such multiples,
    as octrees need it: by half a voxel at most.

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
    elif bounds is None or not np.isfinite(bounds).all():
        why = "geoms have a pose that is not finite"
        why = "only infinite planes count in the scene" if bounds is None else why
        raise ConfigError(f"{why}, so its box has no end: give a centre, and counts or a size")
    else:
        center = bounds.mean(axis=0)
    if bounds is not None and covers:
        first = np.floor(bounds[0] / edge + CELL_SLACK)
        last = np.maximum(np.ceil(bounds[1] / edge - CELL_SLACK), first + 1)
        nx, ny, nz = (int(n) for n in last - first)
        return Placement(first * edge, edge, (nx, ny, nz))
    if cells is not None:
        counts = list(cells) if np.iterable(cells) else [cells]
        whole = [n for n in counts if isinstance(n, int | np.integer) and n is not True and n > 0]
        if len(counts) != 3 or len(whole) != 3:
            raise ConfigError(f"expected 3 counts of cells, whole numbers >= 1, got {counts}")
        nx, ny, nz = map(int, counts)
    else:
        extent = check_three(size, "a size x, y, z in metres")
        if not (extent > 0).all():
            raise ConfigError(f"expected a size > 0 m along each axis, got {extent.tolist()}")
        nx, ny, nz = (num_cells(min(float(length), MANY * edge), edge) for length in extent)
    check_memory((nx, ny, nz), 1)  # before arrays overflow
    origin = center - np.array((nx, ny, nz)) * edge / 2
    aligned = np.round(origin / edge) * edge if align else origin
    return Placement(aligned, edge, (nx, ny, nz), float(np.abs(aligned - origin).max()))


def check_memory(shape: Sequence[int], itemsize: int) -> None:
    """Raise a ConfigError for an array larger than free memory."""
    needed, free = min(math.prod(shape) * itemsize, MANY), _free_memory()
    if needed > free:
        counts = (str(n) if n < 10**15 else f"{min(n, MANY):.3g}" for n in shape)
        raise ConfigError(
            f"a grid of {' × '.join(counts)} voxels takes {needed / 2**30:.3g} GiB, and "
            f"{free / 2**30:.3g} GiB of memory are free: expected fewer or larger voxels"
        )


def finite_array(value: object, shape: tuple[int, ...]) -> Float | None:
    """A value as finite float64 numbers of a shape, else None."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return numbers if numbers.shape == shape and np.isfinite(numbers).all() else None


def check_three(value: ArrayLike | None, expected: str) -> Float:
    """Three finite numbers; a ConfigError says `expected` otherwise."""
    numbers = finite_array(value, (3,))
    if numbers is None:
        raise ConfigError(f"expected {expected}, got {value!r}")
    return numbers


def _free_memory() -> int:
    """Memory available without swapping [bytes]; 2**62 if unknown."""
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
