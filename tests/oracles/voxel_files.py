"""Voxel files read and written one voxel at a time, from the formats' descriptions alone."""

from __future__ import annotations

import numpy as np


def read_binvox_plainly(data):
    """Values[x, y, z], lower corner and edge of a binvox file by the format's own rules."""
    text, _, runs = data.partition(b"data\n")
    fields = dict(line.split(maxsplit=1) for line in text.decode().splitlines())
    depth, height, width = (int(n) for n in fields["dim"].split())
    flat = []
    for n in range(0, len(runs), 2):
        flat += [runs[n]] * runs[n + 1]
    values = np.zeros((depth, width, height), dtype=np.uint8)
    for index, value in enumerate(flat):
        rest, y = divmod(index, width)
        x, z = divmod(rest, height)
        values[x, y, z] = value
    low = np.array([float(t) for t in fields["translate"].split()])
    return values, low, float(fields["scale"]) / max(depth, height, width)


def write_binvox_as_airsim(filled, shape, res):
    """A file as simCreateVoxelGrid writes it, and where it sampled what is filled.

    Args:
        filled: cells (i, j, k) along north, east and up.
        shape: their numbers.
        res: [m].

    Returns:
        The file, and (north, east, up) of each filled cell's sample, less the position.
    """
    nx, ny, nz = shape
    cells = [0] * (nx * ny * nz)
    samples = []
    for i, j, k in filled:
        cells[i + nx * (k + nz * j)] = 1
        samples.append(((i - nx // 2) * res, (j - ny // 2) * res, (k - nz // 2) * res))
    x, y, z = (n * res for n in shape)
    header = (
        f"#binvox 1\ndim {nx} {nz} {ny}\ntranslate {-x * 0.5:g} {-y * 0.5:g} {-z * 0.5:g}\n"
        f"scale {1 / x:g}\ndata\n"
    )
    runs = bytearray()
    value, count = cells[0], 0
    for cell in cells:
        if cell == value:
            count += 1
            if count == 255:
                runs += bytes([value, count])
                count = 0
        else:
            runs += bytes([value, count])  # of no length after a run of 255
            value, count = cell, 1
    if count:
        runs += bytes([value, count])
    return header.encode() + bytes(runs), samples
