"""Beams of a planar lidar, square by square: where each enters the box of each occupied cell."""

from __future__ import annotations

import numpy as np


def enter_box(x, y, angle, box) -> float:
    """How far a beam goes before it enters a box (x_min, y_min, x_max, y_max); inf for never.

    The beam is in the box where it is between both pairs of parallel lines.
    """
    entry, leave = 0.0, np.inf
    for start, speed, low, high in (
        (x, np.cos(angle), box[0], box[2]),
        (y, np.sin(angle), box[1], box[3]),
    ):
        if abs(speed) < 1e-12:
            if not low <= start <= high:
                return np.inf
            continue
        crossings = sorted(((low - start) / speed, (high - start) / speed))
        entry, leave = max(entry, crossings[0]), min(leave, crossings[1])
    return entry if entry <= leave else np.inf


def beam_ranges(level, x, y, angles, max_range, margin=0.0) -> np.ndarray:
    """Distances to the occupied cells of a level, whose squares are larger by a margin [m]."""
    lattice = level.lattice
    boxes = []
    for row, col in np.argwhere(level.solid):
        west = lattice.x_min + col * lattice.cell_size
        north = lattice.y_max - row * lattice.cell_size
        south, east = north - lattice.cell_size, west + lattice.cell_size
        boxes.append((west - margin, south - margin, east + margin, north + margin))
    found = [min((enter_box(x, y, a, box) for box in boxes), default=np.inf) for a in angles]
    return np.array([distance if distance <= max_range else np.inf for distance in found])
