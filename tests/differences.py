"""Where two grids differ: in a line, and as a map."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import navbake
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D


def fresh(baker: navbake.Baker, **settings: Any) -> NavGrid:
    """A bake of a baker's model as it is now."""
    data = mujoco.MjData(baker.model)
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = baker.pose
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return navbake.bake(baker.model, data, **settings)


def first_difference(a: NavGrid, b: NavGrid) -> str | None:
    """Compare two grids in everything but timings.

    NaN equals NaN. Weights count by value, because a file has no dtype for them; of
    ``cellAttributes``, the completed form counts (`describe_attributes`).

    Returns:
        None if they are the same grid, else one line that says where they are not: level,
        field, and for arrays how many cells differ, the first of them, and both its values.
    """
    if type(a) is not type(b):
        return f"types: {type(a).__name__} and {type(b).__name__}"
    if len(a.levels) != len(b.levels):
        return f"number of levels: {len(a.levels)} and {len(b.levels)}"
    for compare in (_cells_difference, _facts_difference):
        for number, (x, y) in enumerate(zip(a.levels, b.levels, strict=True)):
            found = compare(x, y)
            if found:
                return f"level {number}: {found}" if isinstance(a, MultiLevelGrid) else found
    return _facts_difference(a, b)


def _cells_difference(a: SceneGrid2D, b: SceneGrid2D) -> str | None:
    if a.shape != b.shape:
        return f"shape (height, width): {a.shape} and {b.shape}"
    pairs = [("weights", a.weights.astype(np.float64), b.weights.astype(np.float64))]
    for name in a.attributes | b.attributes:
        if name not in a.attributes or name not in b.attributes:
            return f"{name}: only in the {'first' if name in a.attributes else 'second'}"
        pairs.append((name, a.attributes[name], b.attributes[name]))
    for name, x, y in pairs:
        if x.dtype != y.dtype:
            return f"dtype of {name}: {x.dtype} and {y.dtype}"
        differs = _differing(x, y)
        if differs.any():
            row, col = divmod(int(np.argmax(differs)), a.width)
            return (
                f"{name}: {np.count_nonzero(differs)} of {differs.size} cells differ, "
                f"the first at row {row}, col {col}: {x[row, col]!s} and {y[row, col]!s}"
            )
    return _json_difference(a.user_data, b.user_data, "user_data")


def _facts_difference(a: NavGrid, b: NavGrid) -> str | None:
    """Compare what is neither of a cell nor of a level below."""
    for name in ("cell_size", "min_yup", "bbox_yup", "unit", "extra"):
        found = _json_difference(getattr(a, name, None), getattr(b, name, None), name)
        if found:
            return found
    x, y = (
        grid.metadata | {"cellAttributes": {entry["name"]: entry for entry in grid.cell_attributes}}
        for grid in (a, b)
    )
    return _json_difference(x, y, "metadata")


def _differing(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray((a != b) & ~((a != a) & (b != b)))  # only NaN is not itself


def _json_difference(a: Any, b: Any, path: str) -> str | None:
    if a == b:
        return None
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in {**a, **b}:
            inner = f"{path}[{key}]" if isinstance(key, int) else f"{path}.{key}"
            if key not in a or key not in b:
                return f"{inner}: only in the {'first' if key in a else 'second'}"
            found = _json_difference(a[key], b[key], inner)
            if found:
                return found
        return None
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        if len(a) != len(b):
            return f"length of {path}: {len(a)} and {len(b)}"
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            found = _json_difference(x, y, f"{path}[{i}]")
            if found:
                return found
        return None
    return f"{path}: {_shortened(a)} and {_shortened(b)}"


def _shortened(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "…"


def difference_map(a: SceneGrid2D, b: SceneGrid2D, max_size: int = 80) -> str:
    """Draw where two levels differ in weights, attributes or user data.

    Row 0 is at the top, as in the arrays (the world's y points up, its x to the right). A grid
    of more than `max_size` rows or columns is drawn in squares of k × k cells, each as the
    first of x, #, ., space that one of its cells is.

    Args:
        a: a level.
        b: another. An attribute that only one of them has is not compared.
        max_size: rows and columns that the picture may have, >= 1.

    Returns:
        A line a row and a legend; one sentence if the shapes differ.
    """
    if a.shape != b.shape:
        return (
            f"no picture: the first grid has {a.width} × {a.height} cells (width × height), "
            f"the second {b.width} × {b.height}"
        )
    differs = _differing(a.weights, b.weights)
    for name in a.attributes.keys() & b.attributes.keys():
        differs = differs | _differing(a.attributes[name], b.attributes[name])
    for cell_id in a.user_data.keys() | b.user_data.keys():
        if a.user_data.get(cell_id) != b.user_data.get(cell_id):
            differs[divmod(cell_id, a.width)] = True
    rank = np.where(np.isnan(a.floor_height), 0, 2)
    rank = np.where(a.free, 1, rank)
    rank = np.where(differs, 3, rank)
    k = math.ceil(max(a.shape) / max_size)
    starts = [np.arange(0, size, k) for size in a.shape]
    rank = np.maximum.reduceat(np.maximum.reduceat(rank, starts[0], axis=0), starts[1], axis=1)
    rows = ["".join(row) for row in np.array(list(" .#x"))[rank]]
    scale = f", a character is {k} × {k} cells" if k > 1 else ""
    count = np.count_nonzero(differs)
    legend = f". free, # blocked, space no floor, x differs ({count} of {differs.size} cells)"
    return "\n".join([*rows, legend + scale])
