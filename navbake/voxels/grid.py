"""Voxel grids in memory: what one is, and where it is placed.

A grid is placed by a centre and counts, a size in metres, or a scene's bounding box.
"""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import ConfigError, FormatError, QueryError
from navbake.lazy import resolve
from navbake.navgrid.lattice import CELL_SLACK, FARTHEST, LEAST_EDGE, num_cells
from navbake.types import Bool, Float, Int, Vector3

DTYPES = ("bool", "uint8", "uint16", "uint32")  # of voxels; integers hold IDs
MANY = 2**200  # more than any memory, and still a float
FINEST = 1e-5  # least edge of a voxel, well above the tolerance of touching [m]


@dataclass(eq=False, kw_only=True, repr=False)
class VoxelGrid:
    """A box of cubic voxels, parallel to the world's axes.

    Voxel (i, j, k) is the cube of edge `res` with the lower corner ``origin + (i, j, k) * res``.
    """

    #: Shape (nx, ny, nz): bool, True for occupied; or uint8, uint16 or uint32 IDs, 0 for empty.
    values: NDArray[Any]
    origin: Vector3  #: The lower corner of voxel (0, 0, 0), world frame [m].
    res: float  #: Edge of a voxel [m], > 0.
    names: dict[int, str] = field(default_factory=dict)  #: Of the IDs, as far as known, without 0.
    #: Shape (nx, ny, nz), bool, False for unknown occupancy; None if all is known.
    known: Bool | None = None
    #: Assumptions and warnings of the grid's maker, reader or writer, one line each.
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        shape = self.values.shape
        dtype = self.values.dtype
        known = self.known
        if len(shape) != 3 or 0 in shape:
            raise FormatError(f"expected voxels of shape (nx, ny, nz), each >= 1, got {shape}")
        if dtype.name not in DTYPES:
            raise FormatError(f"expected voxels of dtype {', '.join(DTYPES)}, got {dtype}")
        if known is not None and known.shape != shape:
            raise FormatError(f"expected `known` of the voxels' shape {shape}, got {known.shape}")
        if known is not None and known.dtype != np.bool_:
            raise FormatError(f"expected `known` of dtype bool, got {known.dtype}")
        corner = finite_array(self.origin, (3,))
        if corner is None:
            given = reprlib.repr(self.origin)[:80]  # on one line
            raise FormatError(f"expected a lower corner x, y, z [m], got {given}")
        self.origin = tuple(corner.tolist())
        self.res = float(self.res)
        if not (np.isfinite(self.res) and self.res > 0):
            raise FormatError(f"expected a voxel's edge > 0 m, got {self.res:g}")
        with np.errstate(over="ignore"):
            is_near = np.abs(self.bounds).max() <= FARTHEST
        if not is_near or self.res < LEAST_EDGE:
            why = f"expected voxels of {LEAST_EDGE:g} m or more within {FARTHEST:g} m of the origin"
            raise FormatError(f"{why}, got {self.res:g} m from {self.origin} on")

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nx, ny, nz), voxels along x, y and z."""
        nx, ny, nz = self.values.shape
        return nx, ny, nz

    @property
    def is_segmented(self) -> bool:
        """Whether voxels hold IDs."""
        return self.values.dtype != np.bool_

    @property
    def occupied(self) -> Bool:
        """Occupied voxels, shape (nx, ny, nz), bool; `values` itself if it is bool."""
        return self.values if not self.is_segmented else self.values != 0

    @property
    def bounds(self) -> Float:
        """Lower and upper corner, shape (2, 3), float64, world frame [m]."""
        low = np.array(self.origin)
        return np.stack([low, low + np.array(self.shape) * self.res])

    def centers(self) -> Float:
        """The centres of the occupied voxels, shape (n, 3), float64, world frame [m]."""
        middles: Float = (np.argwhere(self.values) + 0.5) * self.res + np.array(self.origin)
        return middles

    def indices(self, xyz: ArrayLike) -> Int:
        """Return the indices of the voxels at positions; they go on beyond the grid.

        Args:
            xyz: World x, y, z [m], shape (..., 3).

        Returns:
            Indices (i, j, k), shape (..., 3), int64; negative or too large outside of the grid.
        """
        place = (np.asarray(xyz, dtype=np.float64) - self.origin) / self.res
        return np.floor(place).astype(np.int64)

    def at(self, xyz: ArrayLike) -> NDArray[Any]:
        """Return the values of the voxels at positions.

        Args:
            xyz: World x, y, z [m], shape (..., 3).

        Returns:
            The values, shape (...), of the dtype of `values`.

        Raises:
            QueryError: A position is outside the grid, or not a finite number.
        """
        places = np.asarray(xyz, dtype=np.float64)
        if places.shape[-1:] != (3,) or not np.isfinite(places).all():
            raise QueryError(f"expected finite positions x, y, z [m], got {places.tolist()}"[:200])
        index = self.indices(places)
        beside = ((index < 0) | (index >= self.shape)).any(axis=-1)
        if beside.any():
            corners = places.reshape(-1, 3)[int(np.argmax(beside.ravel()))], *self.bounds
            first, low, high = (", ".join(f"{value:.6g}" for value in xyz) for xyz in corners)
            raise QueryError(f"no voxel at ({first}): the grid is from ({low}) to ({high})")
        return np.asarray(self.values[index[..., 0], index[..., 1], index[..., 2]])

    def ids(self) -> list[int]:
        """The IDs that occur, ascending, without 0; [] without IDs."""
        found: set[int] = set()
        if self.is_segmented:
            for part in self.values:  # slice by slice, to limit memory
                found.update(np.unique(part).tolist())
        return sorted(found - {0})

    def without_ids(self) -> VoxelGrid:
        """The same voxels as bool."""
        return replace(self, values=self.occupied, names={})

    def with_ids(self, ids: Mapping[int, int]) -> VoxelGrid:
        """Replace IDs.

        Args:
            ids: the new ID of each, >= 0 and < 2**32; missing IDs become 0.

        Raises:
            QueryError: the voxels hold no IDs.
        """
        if not self.is_segmented:
            raise QueryError("these voxels hold no IDs")
        # a table of the IDs that occur; one of all 2**32 is too large
        present = np.array([0, *self.ids()], dtype=np.int64)
        table = np.array([0, *(ids.get(int(old), 0) for old in present[1:])])
        values = np.empty(self.shape, dtype=dtype_of(max(ids.values(), default=0)))
        for part, target in zip(self.values, values, strict=True):
            target[...] = table[np.searchsorted(present, part)]
        names = {new: self.names[old] for old, new in ids.items() if new and old in self.names}
        return replace(self, values=values, names=names)

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.shape))
        corner = ", ".join(f"{v:g}" for v in self.origin)
        count = f"{np.count_nonzero(self.values):,} occupied"
        return f"VoxelGrid({shape} voxels of {self.res:g} m from ({corner}) on, {count})"

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        free: bool = False,
        layout: Literal["binvox", "airsim"] = "binvox",
        mapping: Mapping[int, int] | Literal["compact"] | None = None,
    ) -> None:
        """Write the voxels in the format of the file's ending; `navbake.load_voxels` reads them.

        The names of IDs are written beside it: those of ``a.npz`` into ``a.npz.names.json``.

        Args:
            path: Name of the file, which ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``.
            free: Of octrees (``.bt``, ``.ot``): write known voxels that are not occupied as free,
                not as unknown.
            layout: Of ``.binvox``: ``airsim`` is the layout of AirSim's ``simCreateVoxelGrid``,
                which lacks the position of the grid.
            mapping: Of ``.binvox``: the ID to write for each ID, 0 to 255; ``"compact"`` numbers
                the IDs that occur from 1, in order. None to write them as they are.

        Raises:
            FormatError: The ending is another one, the format cannot hold the voxels, or the file
                cannot be written.
        """
        # the formats import this module
        write_voxels = resolve("navbake.formats.voxels:write_voxels")
        write_voxels(self, path, free=free, layout=layout, mapping=mapping)

    def _repr_png_(self) -> bytes:
        """Return a picture of the voxels as PNG, which notebooks show."""
        # pictures import this module
        picture: bytes = resolve("navbake.views.notebook:draw_voxels")(self)
        return picture


def dtype_of(most: int) -> np.dtype[Any]:
    """The smallest dtype for IDs up to a number, below 2**32."""
    return np.min_scalar_type(most)


# --- where a grid is placed -----------------------------------------------------------------------


@dataclass(frozen=True)
class Placement:
    """Where a grid of voxels lies."""

    origin: Float  # its lower corner, (3,) [m]
    res: float  # the edge of a voxel [m]
    shape: tuple[int, int, int]  # in voxels
    moved: float = 0.0  # by aligning it, the most along any axis [m]


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
        why = "the scene has geoms with a pose that is not finite"
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
    needed = min(math.prod(shape) * itemsize, MANY)
    free = _free_memory()
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
