"""Map descriptors: the explored squares of an arena and their obstacles, as two hex strings.

Part 1 has a bit for each square, 1 for explored, between two bits 11 and two bits 11.
Part 2 has a bit for each explored square, 1 for an obstacle, and 0s up to a full byte. Squares
go row by row from the bottom, each row from the left. An arena of 15 × 20 squares fills 38 bytes
in part 1; other sizes get 0s after the closing 11, up to a full byte.

Arrays are ``[row, col]`` with row 0 at the top, as in all of navbake.
"""

from collections.abc import Sequence
from string import hexdigits

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import FormatError
from navbake.types import Bool

ARENA = (20, 15)  # rows and columns of the format's arena
SQUARE = 0.1  # edge of its squares [m]
PAD = np.array([1, 1], dtype=np.uint8)
MOST = 10**8  # squares of a map

UNEXPLORED, FREE, OBSTACLE = "?", ".", "#"


def encode(explored: ArrayLike, obstacles: ArrayLike) -> tuple[str, str]:
    """Encode a map.

    Args:
        explored: shape (rows, cols), row 0 at the top, true for explored squares.
        obstacles: the same, true for obstacles; unexplored squares are ignored.

    Returns:
        Part 1 and part 2, in capitals; part 2 is empty if nothing is explored.

    Raises:
        FormatError: the two aren't of one shape, or of no squares.
    """
    known, filled = _flags(explored, "explored"), _flags(obstacles, "obstacles")
    if known.shape != filled.shape:
        both = f"{known.shape} and {filled.shape}"
        raise FormatError(f"expected explored and obstacles of one shape (rows, cols), got {both}")
    # the format goes from the bottom row up, arrays from the top row down
    squares, content = known[::-1].ravel(), filled[::-1].ravel()
    parts = np.concatenate([PAD, squares, PAD]), content[squares]
    part1, part2 = (np.packbits(bits.astype(np.uint8)).tobytes().hex().upper() for bits in parts)
    return part1, part2


def decode(part1: str, part2: str, shape: Sequence[int] = ARENA) -> tuple[Bool, Bool]:
    """Decode a map; the inverse of `encode`.

    Also reads small letters, and a part 2 that is filled up to a digit instead of a byte.

    Args:
        shape: rows and columns, >= 1 each.

    Returns:
        explored and obstacles, shape (rows, cols), bool, row 0 at the top; unexplored squares
        have no obstacle.

    Raises:
        FormatError: a string isn't hexadecimal, too short or too long, or its padding is wrong.
    """
    rows, cols = check_shape(shape)
    bits, got = _from_hex(part1, "part 1")
    count = rows * cols + 4
    digits = 2 * -(-count // 8)
    if got != digits:
        squares = f"{rows} × {cols} squares"
        raise FormatError(f"expected {digits} digits in part 1 for {squares}, got {got}")
    for name, (a, b) in (("first", bits[:2]), ("last", bits[count - 2 : count])):
        if not (a and b):
            raise FormatError(f"expected the {name} two bits of part 1 to be 11, got {a}{b}")
    if bits[count:].any():
        raise FormatError("expected 0s after the closing 11 of part 1, got others")
    explored = bits[2 : count - 2].astype(np.bool_)
    known = int(explored.sum())
    content, got = _from_hex(part2, "part 2")
    digits, whole = -(-known // 4), 2 * -(-known // 8)
    if got not in (digits, whole):
        expected = f"{whole}" if digits == whole else f"{whole} (or {digits})"
        squares = f"the {known} squares that part 1 has explored"
        got_what = f"{got}: {'more' if got > whole else 'fewer'} than it has"
        raise FormatError(f"expected {expected} digits in part 2 for {squares}, got {got_what}")
    if content[known:].any():
        why = "it is longer than the squares that part 1 has explored"
        raise FormatError(f"expected 0s after the {known} bits of part 2, got more: {why}")
    obstacles = np.zeros(rows * cols, dtype=np.bool_)
    obstacles[explored] = content[:known]
    return explored.reshape(rows, cols)[::-1].copy(), obstacles.reshape(rows, cols)[::-1].copy()


def draw(explored: ArrayLike, obstacles: ArrayLike) -> str:
    """Draw a map: ``?`` unexplored, ``.`` free, ``#`` obstacle; a line a row, the top one first."""
    known, filled = _flags(explored, "explored"), _flags(obstacles, "obstacles")
    marks = np.where(known, np.where(filled, OBSTACLE, FREE), UNEXPLORED)
    return "\n".join("".join(row) for row in marks)


def _flags(values: ArrayLike, name: str) -> Bool:
    try:
        flags = np.asarray(values)
    except ValueError:  # rows of several lengths
        flags = np.empty(0)
    if flags.dtype.kind not in "biuf":
        raise FormatError(f"expected {name} of true and false, got dtype {flags.dtype}")
    if flags.ndim != 2 or 0 in flags.shape:
        raise FormatError(f"expected {name} of shape (rows, cols), got {flags.shape}")
    return np.asarray(flags != 0)


def check_shape(shape: Sequence[int]) -> tuple[int, int]:
    """Rows and columns of a map; a FormatError if they aren't whole numbers >= 1, or too many."""
    sizes = list(shape) if np.iterable(shape) else [shape]
    if len(sizes) != 2 or not all(isinstance(n, int | np.integer) and n >= 1 for n in sizes):
        raise FormatError(f"expected a shape (rows, cols), each >= 1, got {sizes}")
    rows, cols = int(sizes[0]), int(sizes[1])
    if rows * cols > MOST:
        raise FormatError(f"expected at most {MOST} squares, got {rows} × {cols}")
    return rows, cols


def _from_hex(text: str, name: str) -> tuple[NDArray[np.uint8], int]:
    """The bits, filled up to a full byte, and the number of digits."""
    if not isinstance(text, str):
        raise FormatError(f"expected {name} as a string of hexadecimal digits, got {text!r}")
    digits = text.strip()
    if odd := digits.strip(hexdigits):
        raise FormatError(f"expected hexadecimal digits in {name}, got {odd[0]!r}")
    data = bytes.fromhex(digits + "0" * (len(digits) % 2))
    return np.unpackbits(np.frombuffer(data, dtype=np.uint8)), len(digits)
