"""Voxel grids in memory, and their placement in a scene.

A grid is placed by a centre and counts, a size in metres, or a scene's bounding box.
"""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import ConfigError, FormatError, QueryError
from navbake.lazy import resolve
from navbake.lengths import format_position
from navbake.navgrid.lattice import CELL_SLACK, LEAST_EDGE, MAX_COORDINATE, count_cells
from navbake.processes import measure_free_memory
from navbake.types import Bool, Float, Int, Vector3
from navbake.voxels.distances import DistanceField, find_distances
from navbake.voxels.positions import check_inside, check_xyz

DTYPES = ("bool", "uint8", "uint16", "uint32")  # of voxels; integers are IDs
HUGE_COUNT = 2**200  # more than any memory holds, and still a float
MIN_EDGE = 1e-5  # smallest edge of a voxel, well above the tolerance for touching [m]


VoxelLayout: TypeAlias = Literal["binvox", "airsim"]
# AirSim samples a grid of even counts at places that are shifted by this much from the middles of
# the voxels of a grid round the same centre, along x, y and z [voxels]
AIRSIM_SHIFT = np.array([-0.5, 0.5, -0.5])


@dataclass(eq=False, kw_only=True, repr=False)
class VoxelGrid:
    """A box of cubic voxels, parallel to the world's axes.

    Voxel (i, j, k) is the cube of edge `res` with the lower corner ``origin + (i, j, k) * res``.

    Attributes:
        values: The voxels, shape (nx, ny, nz). Either bool, True for occupied; or IDs, 0 for empty,
            uint8, uint16 or uint32.
        origin: Lower corner of voxel (0, 0, 0), world x, y, z [m].
        res: Edge of a voxel [m], > 0.
        names: ID -> name. IDs may have no name; 0 has none.
        known: Shape (nx, ny, nz), bool, False where the occupancy is unknown; None if all is known.
        notes: Assumptions and warnings from making, reading or writing the grid, one line each.
    """

    values: NDArray[Any]
    origin: Vector3
    res: float
    names: dict[int, str] = field(default_factory=dict)
    known: Bool | None = None
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        shape = self.values.shape
        dtype = self.values.dtype
        known = self.known
        if len(shape) != 3 or 0 in shape:
            expected = "voxels of shape (nx, ny, nz), each >= 1"
            raise _make_field_error("values", shape, expected, f"{shape}")
        if dtype.name not in DTYPES:
            expected = f"voxels of dtype {', '.join(DTYPES)}"
            raise _make_field_error("values", dtype.name, expected, f"{dtype}")
        if known is not None and known.shape != shape:
            expected = f"`known` of the voxels' shape {shape}"
            raise _make_field_error("known", known.shape, expected, f"{known.shape}")
        if known is not None and known.dtype != np.bool_:
            raise _make_field_error(
                "known", known.dtype.name, "`known` of dtype bool", f"{known.dtype}"
            )
        corner = to_finite_array(self.origin, (3,))
        if corner is None:
            origin_text = reprlib.repr(self.origin)[:80]
            raise _make_field_error(
                "origin", self.origin, "a lower corner x, y, z [m]", origin_text
            )
        self.origin = tuple(corner.tolist())
        self.res = float(self.res)
        if not (np.isfinite(self.res) and self.res > 0):
            raise _make_field_error("res", self.res, "a voxel's edge > 0 m", f"{self.res:g}")
        with np.errstate(over="ignore"):
            is_near = np.abs(self.bounds).max() <= MAX_COORDINATE
        if not is_near or self.res < LEAST_EDGE:
            expected = (
                f"voxels of {LEAST_EDGE:g} m or more within {MAX_COORDINATE:g} m of the origin"
            )
            text = f"{self.res:g} m from {self.origin} on"
            raise _make_field_error("res", self.res, expected, text)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nx, ny, nz): the numbers of voxels along x, y and z."""
        nx, ny, nz = self.values.shape
        return nx, ny, nz

    @property
    def is_segmented(self) -> bool:
        """Whether the voxels hold IDs."""
        return self.values.dtype != np.bool_

    @property
    def occupied(self) -> Bool:
        """Mask of the occupied voxels, shape (nx, ny, nz), bool; `values` itself if it is bool."""
        return self.values if not self.is_segmented else self.values != 0

    @property
    def bounds(self) -> Float:
        """Lower and upper corner of the grid, world x, y, z [m], shape (2, 3), float64."""
        lower = np.array(self.origin)
        return np.stack([lower, lower + np.array(self.shape) * self.res])

    def centers(self) -> Float:
        """Return the centres of the occupied voxels, world x, y, z [m], shape (n, 3), float64."""
        centers: Float = (np.argwhere(self.values) + 0.5) * self.res + np.array(self.origin)
        return centers

    def indices(self, xyz: ArrayLike) -> Int:
        """Return the indices of the voxels at positions, which may lie outside the grid.

        Args:
            xyz: World x, y, z [m], shape (..., 3).

        Returns:
            Indices (i, j, k), shape (..., 3), int64; negative or too large outside of the grid.
        """
        coordinates_in_voxels = (np.asarray(xyz, dtype=np.float64) - self.origin) / self.res
        return np.floor(coordinates_in_voxels).astype(np.int64)

    def at(self, xyz: ArrayLike) -> NDArray[Any]:
        """Return the values of the voxels at positions.

        Args:
            xyz: World x, y, z [m], shape (..., 3).

        Returns:
            The values, shape (...), of the dtype of `values`.

        Raises:
            QueryError: A position is outside the grid, or not a finite number.
        """
        positions = check_xyz(xyz)
        check_inside(positions, self.bounds)
        index = np.minimum(self.indices(positions), np.array(self.shape) - 1)
        return np.asarray(self.values[index[..., 0], index[..., 1], index[..., 2]])

    def distances(self, *, signed: bool = False, unknown_occupied: bool = False) -> DistanceField:
        """Compute how far each voxel is from the nearest occupied voxel.

        A distance is measured from the voxel's centre to the nearest point of the occupied voxel,
        which is a cube of edge `res`. So a ball round the centre meets no occupied voxel if its
        radius is at most the distance. What is outside the grid does not count.

        Args:
            signed: Give occupied voxels the negative distance of their centre from the nearest
                voxel that is not occupied, in place of 0.
            unknown_occupied: Count voxels as occupied where `known` is False.

        Returns:
            The distances [m], `values` of shape (nx, ny, nz); inf if nothing is occupied. The field
            also interpolates distances and their gradients at positions.

        Example:
            >>> voxels = navbake.create_voxel_grid("house.xml", res=0.1)
            >>> field = voxels.distances(signed=True)
            >>> field.values.shape == voxels.shape
            True
            >>> field.at((1.0, 0.5, 1.2)), field.gradients_at((1.0, 0.5, 1.2))
        """
        occupied = self.occupied
        if unknown_occupied and self.known is not None:
            occupied = occupied | ~self.known
        return find_distances(occupied, self.origin, self.res, signed=signed)

    def ids(self) -> list[int]:
        """Return the IDs that occur, ascending, without 0; [] if voxels hold no IDs."""
        ids: set[int] = set()
        if self.is_segmented:
            for plane in self.values:  # plane by plane, to limit memory
                ids.update(np.unique(plane).tolist())
        return sorted(ids - {0})

    def without_ids(self) -> VoxelGrid:
        """Return the same voxels as bool, without names."""
        return replace(self, values=self.occupied, names={})

    def with_ids(self, ids: Mapping[int, int]) -> VoxelGrid:
        """Return the same voxels with their IDs replaced.

        Args:
            ids: Maps each ID to its new ID, >= 0 and < 2**32; IDs that are missing become 0.

        Raises:
            QueryError: The voxels hold no IDs.
        """
        if not self.is_segmented:
            raise QueryError("these voxels hold no IDs")
        # a table of the IDs that occur; one of all 2**32 is too large
        present_ids = np.array([0, *self.ids()], dtype=np.int64)
        new_ids = np.array([0, *(ids.get(int(old_id), 0) for old_id in present_ids[1:])])
        values = np.empty(self.shape, dtype=dtype_of(max(ids.values(), default=0)))
        for old_plane, new_plane in zip(self.values, values, strict=True):
            new_plane[...] = new_ids[np.searchsorted(present_ids, old_plane)]
        names = {
            new_id: self.names[old_id]
            for old_id, new_id in ids.items()
            if new_id and old_id in self.names
        }
        return replace(self, values=values, names=names)

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.shape))
        corner = format_position(self.origin)
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

        The names of IDs are written into a second file beside it, which is ``a.npz.names.json`` for
        ``a.npz``.

        Args:
            path: Name of the file, which ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``.
            free: For octrees (``.bt``, ``.ot``): write known voxels that are not occupied as free,
                not as unknown.
            layout: For ``.binvox``: ``airsim`` is the layout of AirSim's ``simCreateVoxelGrid``,
                which does not store the position of the grid. The grid's `notes` say which position
                to state when the file is read.
            mapping: For ``.binvox``: ID -> the ID that is written for it, 0 to 255. ``"compact"``
                numbers the IDs that occur from 1, in order. None writes them as they are.

        Raises:
            FormatError: The name has another ending, the format cannot hold the voxels, or the file
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


def _make_field_error(key: str, value: object, expected: str, text: str) -> FormatError:
    """Return an error for a wrong value of an attribute; the message shows the value as `text`."""
    message = f"expected {expected}, got {text}"
    return FormatError(message, key=key, value=value, expected=expected)


def dtype_of(max_id: int) -> np.dtype[Any]:
    """Return the smallest unsigned dtype that holds IDs up to `max_id`, which is below 2**32."""
    return np.min_scalar_type(max_id)


# --- where a grid is placed -----------------------------------------------------------------------


@dataclass(frozen=True)
class Placement:
    """Where a grid of voxels lies.

    Attributes:
        origin: Its lower corner, world x, y, z [m], shape (3,).
        res: Edge of a voxel [m].
        shape: Numbers of voxels along x, y and z.
        alignment_shift: By how much the grid was moved to align it with multiples of `res` [m]: the
            largest of the moves along x, y and z.
    """

    origin: Float
    res: float
    shape: tuple[int, int, int]
    alignment_shift: float = 0.0


def place_grid(
    position: ArrayLike | None,
    cells: Sequence[int] | None,
    size: Sequence[float] | None,
    res: float,
    bounds: Float | None,
    *,
    align: bool = False,
    layout: VoxelLayout = "binvox",
) -> Placement:
    """Place a voxel grid around a centre, or over a scene.

    Args:
        position: Centre of the grid, world x, y, z [m]; None for the centre of `bounds`.
        cells: Numbers of voxels along x, y and z; None for as many as `size` or `bounds` need.
        size: Lengths along x, y and z that whole voxels are to cover [m]. With neither `cells` nor
            `size`, the grid covers `bounds`, and its corners are multiples of `res`.
        res: Edge of a voxel [m], >= 1e-5.
        bounds: Lower and upper corner of the scene's box, shape (2, 3) [m]; None if the scene is
            endless.
        align: Move the corners onto multiples of `res`, as octrees need it: by half a voxel at
            most.
        layout: ``airsim`` to place voxels where AirSim samples them round a centre: of n voxels
            along an axis, the middle of voxel ``n // 2`` is at the centre, counted along north (x),
            east (-y) and up. So grids of even counts lie half a voxel off.

    Returns:
        Where the grid lies.

    Raises:
        ConfigError: A number is wrong; both `cells` and `size` are given, or only a centre is; or
            the grid needs more memory than there is.
    """
    checked_edge = to_finite_array(res, ())
    if checked_edge is None or checked_edge < MIN_EDGE:
        expected = f"to be >= {MIN_EDGE:g} m"
        raise ConfigError(
            f"expected `res`, the edge of a voxel, {expected}, got {res}",
            key="res",
            value=res,
            expected=expected,
        )
    edge = float(checked_edge)
    if cells is not None and size is not None:
        raise ConfigError("expected either counts of cells or a size in metres, got both")
    covers_bounds = cells is None and size is None
    if covers_bounds and position is not None:
        raise ConfigError(
            "expected counts of cells (`--cells NX NY NZ`) or a size in metres (`--size X Y Z`) "
            "beside the centre"
        )
    if position is not None:
        center = check_three_numbers(position, "the centre to be x, y, z [m]")
    elif bounds is None or not np.isfinite(bounds).all():
        reason = "the scene has geoms with a pose that is not finite"
        if bounds is None:
            reason = "only infinite planes count in the scene"
        hint = "give a centre, and counts or a size"
        raise ConfigError(f"{reason}, so its box has no end: {hint}", hint=hint)
    else:
        center = bounds.mean(axis=0)
    if bounds is not None and covers_bounds:
        lower_index = np.floor(bounds[0] / edge + CELL_SLACK)  # in voxels
        upper_index = np.maximum(np.ceil(bounds[1] / edge - CELL_SLACK), lower_index + 1)
        return Placement(lower_index * edge, edge, _as_shape((upper_index - lower_index).tolist()))
    if cells is not None:
        counts = list(cells) if np.iterable(cells) else [cells]
        if len(counts) != 3 or not all(map(_is_count, counts)):
            expected = "3 counts of cells, whole numbers >= 1"
            raise ConfigError(
                f"expected {expected}, got {counts}", key="cells", value=cells, expected=expected
            )
        shape = _as_shape(counts)
    else:
        lengths = check_three_numbers(size, "a size x, y, z in metres")
        if not (lengths > 0).all():
            expected = "a size > 0 m along each axis"
            raise ConfigError(
                f"expected {expected}, got {lengths.tolist()}",
                key="size",
                value=size,
                expected=expected,
            )
        max_length = HUGE_COUNT * edge
        shape = _as_shape([count_cells(min(float(length), max_length), edge) for length in lengths])
    check_memory(shape, 1)  # before arrays overflow
    origin = center - np.array(shape) * edge / 2
    if layout == "airsim":
        is_even = np.array(shape) % 2 == 0
        origin = origin + is_even * AIRSIM_SHIFT * edge
    aligned_origin = np.round(origin / edge) * edge if align else origin
    return Placement(aligned_origin, edge, shape, float(np.abs(aligned_origin - origin).max()))


def _is_count(value: object) -> bool:
    return isinstance(value, int | np.integer) and value is not True and bool(value > 0)


def _as_shape(counts: Sequence[float]) -> tuple[int, int, int]:
    nx, ny, nz = counts
    return int(nx), int(ny), int(nz)


def check_memory(shape: Sequence[int], itemsize: int) -> None:
    """Raise a ConfigError if an array is larger than the free memory.

    Args:
        shape: Numbers of voxels along each axis.
        itemsize: Memory for a voxel [bytes].
    """
    needed_bytes = min(math.prod(shape) * itemsize, HUGE_COUNT)
    free_bytes = measure_free_memory()
    if needed_bytes > free_bytes:
        count_texts = (
            str(count) if count < 10**15 else f"{min(count, HUGE_COUNT):.3g}" for count in shape
        )
        expected = "fewer or larger voxels"
        raise ConfigError(
            f"a grid of {' × '.join(count_texts)} voxels takes {needed_bytes / 2**30:.3g} GiB, and "
            f"{free_bytes / 2**30:.3g} GiB of memory are free: expected {expected}",
            value=tuple(shape),
            expected=expected,
        )


def to_finite_array(value: object, shape: tuple[int, ...]) -> Float | None:
    """Convert a value to finite numbers, float64.

    Args:
        value: A number, or numbers in any form that numpy takes.
        shape: The shape that the numbers must have.

    Returns:
        The numbers; None if `value` has another shape, or holds anything but finite numbers.
    """
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return numbers if numbers.shape == shape and np.isfinite(numbers).all() else None


def check_three_numbers(value: ArrayLike | None, expected: str) -> Float:
    """Check that a value is three finite numbers, and return them as an array, float64.

    Args:
        value: The numbers.
        expected: The text after ``expected`` in the ConfigError's message.

    Returns:
        The numbers, shape (3,).

    Raises:
        ConfigError: The value is not three finite numbers.
    """
    numbers = to_finite_array(value, (3,))
    if numbers is None:
        raise ConfigError(f"expected {expected}, got {value!r}", value=value, expected=expected)
    return numbers
