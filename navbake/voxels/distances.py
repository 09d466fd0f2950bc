"""Distances from the occupied voxels of a grid, and their gradients: a Euclidean distance field.

A distance is measured from the centre of a voxel to the nearest point of the nearest occupied
voxel, which is a cube. So the distance of an empty voxel beside an occupied one is half an edge;
between their centres it would be a whole one. No distance is longer than that to the geometry
itself, which lies in the cubes: a ball whose radius is at most the distance meets no occupied
voxel.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navbake.lazy import lazy, resolve
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Vector3
from navbake.voxels.positions import check_inside, check_xyz

distance_kernels = lazy("navbake.voxels.distance_kernels")  # numba loads slowly

LEAST_POINTS = 4096  # fewest points that are worth a thread


@dataclass(frozen=True, eq=False, repr=False)
class DistanceField:
    """Distances from the occupied voxels of a grid, at the centres of its voxels.

    Attributes:
        values: Distance of each voxel's centre from the nearest point of the nearest occupied voxel
            [m], shape (nx, ny, nz), float64; inf where nothing is occupied. Occupied voxels have 0;
            in a signed field, minus the distance of their centre from the nearest point of the
            nearest voxel that is not occupied. Space outside the grid counts as neither.
        origin: Lower corner of voxel (0, 0, 0), world x, y, z [m].
        res: Edge of a voxel [m].
        is_signed: Whether occupied voxels have negative distances.

    Example:
        >>> field = voxels.distances(signed=True)
        >>> field.at([(1.0, 0.5, 1.2), (1.1, 0.5, 1.2)])
        >>> field.gradients_at((1.0, 0.5, 1.2))  # points away from what is nearest
    """

    values: Float
    origin: Vector3
    res: float
    is_signed: bool = False

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.values.shape))
        kind = "signed distances" if self.is_signed else "distances"
        return (
            f"DistanceField({shape} {kind}, {self.values.min():.3g} to {self.values.max():.3g} m)"
        )

    @property
    def bounds(self) -> Float:
        """Lower and upper corner of the grid, world x, y, z [m], shape (2, 3), float64."""
        lower = np.array(self.origin)
        return np.stack([lower, lower + np.array(self.values.shape) * self.res])

    def at(self, xyz: ArrayLike) -> Float:
        """Interpolate distances at positions, trilinearly between the centres of voxels.

        A signed field is 0 on a flat face between occupied and empty voxels, and so right on both
        sides of it. Elsewhere the interpolation is an estimate, off by less than a voxel's edge.

        Args:
            xyz: World x, y, z [m], shape (..., 3), in the grid.

        Returns:
            Distances [m], shape (...), float64; inf in a field without occupied voxels.

        Raises:
            QueryError: A position is outside the grid, or not a finite number.
        """
        return self._interpolate(xyz)[0]

    def gradients_at(self, xyz: ArrayLike) -> Float:
        """Return the gradients of the interpolated distances of `at`.

        They point away from what is nearest, and are about 1 long where one thing is nearest.

        Args:
            xyz: World x, y, z [m], shape (..., 3), in the grid.

        Returns:
            Change of the distance along x, y and z for each metre, shape (..., 3), float64; 0 in a
            field without occupied voxels.

        Raises:
            QueryError: A position is outside the grid, or not a finite number.
        """
        return self._interpolate(xyz)[1]

    def _interpolate(self, xyz: ArrayLike) -> tuple[Float, Float]:
        """Return distances and gradients at positions."""
        positions = check_xyz(xyz)
        check_inside(positions, self.bounds)
        shape = positions.shape[:-1]
        some_distance = float(self.values[0, 0, 0])
        if not np.isfinite(some_distance):  # so are all others
            return np.full(shape, some_distance), np.zeros(positions.shape)
        points = ((positions - self.origin) / self.res - 0.5).reshape(-1, 3)
        distances = np.empty(len(points))
        gradients = np.empty(points.shape)
        run_in_chunks(
            distance_kernels.interpolate,
            len(points),
            self.values,
            points,
            distances,
            gradients,
            min_chunk_size=LEAST_POINTS,
        )
        return distances.reshape(shape), gradients.reshape(positions.shape) / self.res

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the field as a NumPy archive: `distances`, `origin`, `res` and `is_signed`.

        Args:
            path: Name of the file, which ends in ``.npz``.

        Raises:
            FormatError: The name has another ending, or the file cannot be written.

        Example:
            >>> field.save("esdf.npz")
            >>> numpy.load("esdf.npz")["distances"]
        """
        # the formats import this folder
        resolve("navbake.formats.npz:write_distances")(self, path)


def find_distances(occupied: Bool, origin: Vector3, res: float, *, signed: bool) -> DistanceField:
    """Compute the distances of voxels from the occupied ones: `VoxelGrid.distances`.

    Args:
        occupied: Mask of the occupied voxels, shape (nx, ny, nz).
        origin: Lower corner of voxel (0, 0, 0), world x, y, z [m].
        res: Edge of a voxel [m].
        signed: Whether occupied voxels get negative distances.
    """
    distances = _measure(occupied, res)
    if signed:
        distances -= _measure(~occupied, res)
    return DistanceField(distances, origin, res, signed)


def _measure(is_target: Bool, res: float) -> Float:
    """Measure how far each voxel's centre is from the nearest target voxel [m], 0 in targets."""
    squares = np.where(is_target, 0.0, np.inf)
    for axis in (2, 1, 0):
        # the lines along the axis; neighbouring lines are worked on together, as they are
        # neighbours in memory
        lines = np.moveaxis(squares, axis, 2)
        run_in_chunks(distance_kernels.spread_along_axis, len(lines), lines)
    np.sqrt(squares, out=squares)
    squares *= res / 2.0  # from half voxels to metres
    return squares
