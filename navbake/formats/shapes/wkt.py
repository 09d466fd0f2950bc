"""Well-known text (OGC simple features): a table of a grid's rooms, walkable areas and doors.

It is CSV whose column ``WKT`` holds the geometries, as GDAL, QGIS, PostGIS and pandas take it: WKT
itself has no place for names.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

from navbake.formats.shapes.outlines import DECIMALS
from navbake.formats.shapes.shape import find_shapes, import_shapely
from navbake.formats.source import Files
from navbake.navgrid.grid import NavGrid

COLUMNS = ("kind", "level", "levelName", "height", "id", "name", "area")


def encode_wkt(grid: NavGrid, path: Path) -> Files:
    """Make a CSV of a grid's shapes, see `navbake.formats.shapes.shape.find_shapes`.

    The columns are ``WKT`` and then the properties that all features of a GeoJSON of the grid have.

    Raises:
        MissingDependencyError: shapely is not installed.
    """
    shapely = import_shapely()
    text = io.StringIO()
    # lines end as RFC 4180 has it; with other ends, csv leaves a name with such an end unquoted
    table = csv.writer(text, lineterminator="\r\n")
    table.writerow(["WKT", *COLUMNS])
    for shape in find_shapes(grid):
        wkt = shapely.to_wkt(shape.geometry, rounding_precision=DECIMALS)
        properties = shape.properties
        table.writerow([wkt, *(properties[column] for column in COLUMNS)])
    return {path: text.getvalue().encode()}
