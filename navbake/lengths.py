"""Lengths as text."""


def format_length(length: float, num_decimals: int = 2) -> str:
    """Format a length or a coordinate with a fixed number of decimals; it is never ``-0.00``.

    Args:
        length: The length, a finite number [m].
        num_decimals: How many decimals the text has.
    """
    return f"{round(float(length), num_decimals) + 0.0:.{num_decimals}f}"
