"""Lengths and positions as text."""

from collections.abc import Iterable

FAR_COORDINATE = 10_000.0  # beyond it, six digits tell no centimetres any more [m]


def format_length(length: float, num_decimals: int = 2) -> str:
    """Format a length or a coordinate with a fixed number of decimals; it is never ``-0.00``.

    Args:
        length: The length, a finite number [m].
        num_decimals: How many decimals the text has.
    """
    return f"{round(float(length), num_decimals) + 0.0:.{num_decimals}f}"


def format_position(position: Iterable[float]) -> str:
    """Format a position for a message, see `format_coordinate`.

    Args:
        position: The coordinates, finite numbers [m].

    Returns:
        The numbers with commas in between, such as ``1.5, -2, 0.25``.
    """
    return ", ".join(map(format_coordinate, position))


def format_coordinate(coordinate: float) -> str:
    """Format a coordinate or a bound for a message; it is never ``-0``.

    Args:
        coordinate: The coordinate, a finite number [m].

    Returns:
        The number with six digits, to a micrometre at most, such as ``-2.25``. Beyond 10 km, to a
        centimetre, such as ``5411932.25``: places of maps in UTM lie so far from the origin.
    """
    # a millionth of a metre is far below what positions are exact to
    rounded_coordinate = round(float(coordinate), 6) + 0.0
    if abs(rounded_coordinate) < FAR_COORDINATE:
        return f"{rounded_coordinate:g}"
    return f"{round(rounded_coordinate, 2):.12g}"


def format_bounds(bounds: Iterable[float]) -> str:
    """Format a rectangle for a message, such as ``x -5 to 5, y 0 to 4``.

    Args:
        bounds: Its lowest x and y, and its highest x and y, finite numbers [m].
    """
    x_min, y_min, x_max, y_max = map(format_coordinate, bounds)
    return f"x {x_min} to {x_max}, y {y_min} to {y_max}"
