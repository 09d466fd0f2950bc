"""Files of flights: JSON, and MCAP for Foxglove and rerun.

A JSON file is an object with ``positions`` (n × 3, world x, y, z [m], z up), ``length`` [m],
``cost`` [m] and ``radius`` [m] of a `FlightPath`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import orjson

from navbake.errors import FormatError
from navbake.formats.mcap import encode_flight
from navbake.formats.source import write_bytes
from navbake.voxels.finder import FlightPath
from navbake.voxels.grid import VoxelGrid


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
