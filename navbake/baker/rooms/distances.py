"""Distances of nodes to targets, such as walls."""

import numpy as np

from navbake.baker.rooms.kernels.watershed import sweep_columns, sweep_rows
from navbake.threads import run_in_bands
from navbake.types import Bool, Int32

STRIP = 64  # columns that are worth a thread's while


def squared_distances(target: Bool, reach: int, first: int = 0, step: int = 1) -> Int32:
    """Squared distance of each node to the nearest target, exact up to `reach`.

    Args:
        target: shape (rows, cols).
        reach: nodes, >= 0.
        first: the first row to answer for.
        step: of the rows from there on, each step-th is answered for.

    Returns:
        Shape (answered rows, cols); ``(reach + 1) ** 2`` where there is none within reach.
    """
    along = np.empty(target.shape, dtype=np.int16)
    target = np.ascontiguousarray(target)
    run_in_bands(sweep_columns, target.shape[1], target, np.int16(reach + 1), along, least=STRIP)
    rows = np.arange(first, len(target), step)
    answer = np.empty((len(rows), target.shape[1]), dtype=np.int32)
    run_in_bands(sweep_rows, len(rows), along, reach, rows, answer)
    return answer
