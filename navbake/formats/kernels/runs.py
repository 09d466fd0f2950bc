"""Runs of equal bytes, as pairs of value and count up to 255, in any order of a 3-D array."""

import numpy as np

from navbake.compiled import kernel

LONGEST = 255


@kernel
def encode_runs(values, out):
    """Write the runs of a 3-D array of uint8, last index fastest, to `out`; return their bytes.

    An empty `out` only counts them.
    """
    writing = out.shape[0] > 0
    num = 0
    value, count = values[0, 0, 0], 0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                # a count fills one byte, so a longer run is written as several
                if values[i, j, k] == value and count < LONGEST:
                    count += 1
                    continue
                if writing:
                    out[num], out[num + 1] = value, count
                num += 2
                value, count = values[i, j, k], 1
    if writing:
        out[num], out[num + 1] = value, count
    return num + 2


@kernel
def decode_runs(pairs, values):
    """Fill a 3-D array of zeros from runs, last index fastest; return how many values they hold.

    Empty runs are skipped. Values beyond the array are only counted.
    """
    rows, cols = values.shape[1], values.shape[2]
    size = values.shape[0] * rows * cols
    done = np.int64(0)
    for n in range(0, pairs.shape[0] - 1, 2):
        value, count = pairs[n], np.int64(pairs[n + 1])
        if value != 0:  # the array holds zeros already
            for place in range(done, min(done + count, size)):
                rest = place // cols
                values[rest // rows, rest % rows, place % cols] = value
        done += count
    return done
