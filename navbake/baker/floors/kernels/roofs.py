"""How much of each sheet is open to the sky, and how much lies over another sheet: one count."""

import numpy as np

from navbake.compiled import kernel


@kernel(nogil=True)
def count_open_and_over(every, counts):
    """Count the surfaces of sheets that are open to the sky, and those over another sheet.

    Args:
        every: all standable surfaces.
        counts: the sheets that are asked for, (sheets,) bool.

    Returns:
        By sheet, how many surfaces have nothing above them, and how many have a surface of another
        sheet below, (sheets,) int64; 0 for those that are not asked for.
    """
    is_open = np.zeros(counts.shape[0], np.int64)
    is_over = np.zeros(counts.shape[0], np.int64)
    for cell in range(every.start.shape[0] - 1):
        first, last = every.start[cell], every.start[cell + 1]
        for i in range(first, last):
            sheet = every.sheet[i]
            if not counts[sheet]:
                continue
            if every.is_top[i]:
                is_open[sheet] += 1
            if i > first and every.sheet[i - 1] != sheet:
                is_over[sheet] += 1
    return is_open, is_over
