"""Checks of positions in the box of a voxel grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.lengths import format_position
from navbake.types import Float


def check_xyz(xyz: ArrayLike, key: str = "xyz") -> Float:
    """Check that positions are finite, and return them as an array.

    Args:
        xyz: World x, y, z [m], shape (..., 3).
        key: The name of the argument, which the error has as its key.

    Returns:
        The positions, shape (..., 3), float64.

    Raises:
        QueryError: The value is not numbers of this shape, or one of them is not finite.
    """
    expected = "finite positions x, y, z [m]"
    try:
        positions = np.asarray(xyz, dtype=np.float64)
    except (TypeError, ValueError) as error:
        message = f"expected {expected}, got {xyz!r}"[:200]
        raise QueryError(message, key=key, value=xyz, expected=expected) from error
    if positions.shape[-1:] != (3,) or not np.isfinite(positions).all():
        message = f"expected {expected}, got {positions.tolist()}"[:200]
        raise QueryError(message, key=key, value=xyz, expected=expected)
    return positions


def check_inside(positions: Float, bounds: Float) -> None:
    """Check that positions are in the box of a grid.

    Args:
        positions: World x, y, z [m], shape (..., 3).
        bounds: Lower and upper corner of the box [m], shape (2, 3). The upper faces are not in it.

    Raises:
        QueryError: A position is outside; the error names the first.
    """
    lower, upper = bounds
    is_outside = ((positions < lower) | (positions >= upper)).any(axis=-1)
    if is_outside.any():
        position = positions.reshape(-1, 3)[int(np.argmax(is_outside.ravel()))]
        box = f"from ({format_position(lower)}) to ({format_position(upper)})"
        raise QueryError(
            f"no voxel at ({format_position(position)}): the grid is {box}",
            key="xyz",
            value=tuple(position.tolist()),
        )
