"""What lies round agents: heights of a pattern of points, and patches of a layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import Array, GridTensors
from navbake.tensors.layers import clearance, floor, is_navigable, island, room
from navbake.tensors.locate import as_array, check_positions, check_scenes, device_of

LAYERS: dict[str, Any] = {
    "floor": floor,
    "free": is_navigable,
    "room": room,
    "island": island,
    "clearance": clearance,
}
"""The function behind each layer of `patch`."""


def heights(
    t: GridTensors,
    positions: Array,
    yaw: Array,
    pattern: Array,
    scene_id: Array | int | None = None,
) -> Array:
    """Floor heights at a pattern of points round each agent, turned with it: a height scan.

    Each point takes the nearest floor below its agent, by the rule of `level_at`, so that an agent
    on the ground doesn't see the floor above.

    Args:
        t: tensors of one or several grids.
        positions: of agents, world x, y, z [m], shape (..., 3).
        yaw: their headings [rad], 0 along x, counted towards y; shape (...).
        pattern: points in the agents' frames, x ahead, y to the left [m], shape (k, 2).
        scene_id: which grid, where there are several; an integer or integers of shape (...).

    Returns:
        World z [m], shape (..., k); NaN where there is no floor.
    """
    points = _turned(t, positions, yaw, pattern)
    return floor(t, points, _per_point(t, scene_id, points.shape[:-2]))


def patch(
    t: GridTensors,
    positions: Array,
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    layer: str = "free",
    scene_id: Array | int | None = None,
) -> Array:
    """Cut an egocentric picture of a layer round each agent, which looks up in it.

    The first row is the farthest ahead and the first column the leftmost; the agent is in the
    middle of all. Each pixel shows the grid's cell that its middle is in, by the rule of
    `level_at` at the agent's z.

    Args:
        t, positions, yaw, scene_id: see `heights`.
        shape: rows and columns.
        cell: size of a pixel [m], > 0.
        layer: ``free`` (bool), ``floor`` (world z [m]), ``clearance`` ([m]), ``room`` or
            ``island`` (int32).

    Returns:
        Shape (..., rows, columns); False, NaN or 0 where there is nothing.
    """
    if layer not in LAYERS:
        raise QueryError(f"no layer {layer!r}: expected one of {', '.join(LAYERS)}")
    if not isinstance(shape, Sequence) or [isinstance(n, int) for n in shape] != [True, True]:
        raise QueryError(f"expected a shape (rows, columns), whole numbers, got {shape!r}")
    rows, cols = shape
    if rows < 1 or cols < 1 or not 0 < cell < math.inf:
        raise QueryError(f"expected rows, columns and a cell > 0, got {shape} and {cell!r}")
    xp, device, cell = t.xp, device_of(t), float(cell)
    ahead = (xp.arange(rows, dtype=t.dtype, device=device) - (rows - 1) / 2) * -cell
    left = (xp.arange(cols, dtype=t.dtype, device=device) - (cols - 1) / 2) * -cell
    grid = xp.stack(
        [
            xp.broadcast_to(ahead[:, None], (rows, cols)),
            xp.broadcast_to(left[None, :], (rows, cols)),
        ],
        axis=-1,
    )
    points = _turned(t, positions, yaw, xp.reshape(grid, (-1, 2)))
    further: dict[str, str] = {"mode": "nearest"} if layer == "clearance" else {}
    values = LAYERS[layer](t, points, _per_point(t, scene_id, points.shape[:-2]), **further)
    return xp.reshape(values, (*values.shape[:-1], rows, cols))


def _turned(t: GridTensors, positions: Array, yaw: Array, pattern: Array) -> Array:
    """World positions of a pattern's points round agents, shape (..., k, 3)."""
    xp = t.xp
    p, turn, points = check_positions(t, positions), as_array(t, yaw), as_array(t, pattern)
    if points.ndim != 2 or points.shape[-1] != 2:
        raise QueryError(f"expected a pattern of shape (k, 2), got {tuple(points.shape)}")
    if tuple(turn.shape) != tuple(p.shape[:-1]):
        raise QueryError(
            f"expected a yaw of shape {tuple(p.shape[:-1])}, one for each position, got "
            f"{tuple(turn.shape)}"
        )
    cos, sin = xp.cos(turn)[..., None], xp.sin(turn)[..., None]
    x = p[..., 0, None] + cos * points[:, 0] - sin * points[:, 1]
    y = p[..., 1, None] + sin * points[:, 0] + cos * points[:, 1]
    return xp.stack([x, y, xp.broadcast_to(p[..., 2, None], x.shape)], axis=-1)


def _per_point(t: GridTensors, scene_id: Array | int | None, shape: tuple[int, ...]) -> Any:
    """The scenes of agents, shape (...), as scenes of their points, shape (..., 1)."""
    scenes = check_scenes(t, scene_id, shape)
    return None if scenes is None else scenes[..., None]
