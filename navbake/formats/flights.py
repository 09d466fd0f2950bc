"""Files of flights: JSON, and MCAP for Foxglove and rerun.

A JSON file is an object with ``positions`` (n × 3, world x, y, z [m], z up), ``length`` [m],
``cost`` [m] and ``radius`` [m] of a `FlightPath`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import msgspec
import numpy as np
import orjson

from navbake.errors import FormatError
from navbake.formats.mcap import encode_flight
from navbake.formats.source import read_bytes, write_bytes
from navbake.types import Vector3
from navbake.voxels.finder import FlightPath
from navbake.voxels.grid import VoxelGrid


class FlightFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of a JSON file."""

    positions: tuple[Vector3, ...]
    length: float
    cost: float
    radius: float


def read_flight(path: str | PathLike[str]) -> FlightPath:
    """Read a path through voxels from a JSON file that `FlightPath.save` wrote.

    Args:
        path: the file.

    Returns:
        The path; its ``voxels`` are empty, since the file has none.

    Raises:
        FormatError: the file can't be read, or has no path.
    """
    content, name = read_bytes(path)
    try:
        flight = msgspec.json.decode(content, type=FlightFile)
    except msgspec.DecodeError as error:
        expected = "a path that `navbake fly` wrote as JSON"
        raise FormatError(f"expected {expected} in {name}: {error}", expected=expected) from error
    positions = np.array(flight.positions).reshape(-1, 3)
    if not len(positions) or not np.isfinite(positions).all() or not flight.radius > 0.0:
        expected = "one finite position or more, and a radius > 0 m"
        raise FormatError(f"expected {expected} in {name}", expected=expected)
    return FlightPath(
        positions, np.empty((0, 3), np.int64), flight.length, flight.cost, flight.radius
    )


def write_flight(
    flight: FlightPath, path: str | PathLike[str], voxels: VoxelGrid | None = None
) -> None:
    """Write a path through voxels: `FlightPath.save`.

    Args:
        flight: the path.
        path: the file, which ends in ``.json`` or ``.mcap``.
        voxels: voxels to show in an MCAP file; None for none.

    Raises:
        FormatError: the name has another ending, or the file cannot be written.
        MissingDependencyError: mcap-ros2-support is not installed, for ``.mcap``.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        facts = {
            "positions": flight.positions.tolist(),
            "length": flight.length,
            "cost": flight.cost,
            "radius": flight.radius,
        }
        content = orjson.dumps(facts, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)
    elif suffix == ".mcap":
        content = encode_flight(flight, voxels)
    else:
        expected = "a name that ends in .json or .mcap"
        raise FormatError(f"expected {expected}, got {path}", value=path, expected=expected)
    write_bytes(content, path)
