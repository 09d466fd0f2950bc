"""Maps of ROS and nav2: an image of a level, and its YAML.

A map has its origin at the lower left corner of the image's lower left pixel, and its rows from
the top. Position (x, y) lies in column ``floor((x - origin_x) / resolution)``, and, from the
bottom, in the row of the same formula of y.

Source: ``map_io.cpp`` of ``nav2_map_server``, whose rules for pixels `read_pixel_values` follows:
the three modes, both thresholds, ``negate`` (which ``raw`` ignores), and transparency. The
rules are those of a version:

- ``humble``, to Jazzy: a grey is the mean of its channels, a value on a threshold is neither free
  nor occupied, and transparency counts as a fourth channel in mode ``trinary`` and makes a pixel
  unknown in ``scale``.
- ``main``: a grey is its luma, of 8 bits; a value on a threshold is free or occupied; what is
  transparent is unknown in both modes.

Files that `encode_nav2` writes have the same values by both.
"""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.files import check_regular, readable_stem
from navbake.formats import occupancy
from navbake.formats.allowance import MISSING, JsonPath, check_number, check_vector
from navbake.formats.convert import list_level_paths
from navbake.formats.navgrid import check_grid
from navbake.formats.source import (
    Files,
    Pixels,
    check_named,
    check_path,
    encode_image,
    read_pixels,
    read_yaml,
)
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE, Lattice, rounded
from navbake.runtime.inflation import NAV2_SCALING
from navbake.types import Json
from navbake.yaml_text import encode_yaml

MODES = ("trinary", "scale", "raw")
PIXEL_RULES = ("humble", "main")
IMAGES = ("pgm", "png")
YAMLS = (".yaml", ".yml")
# of map_saver; 0.25 takes 205 for free
OCCUPIED_THRESHOLD = 0.65
FREE_THRESHOLD = 0.196
DIGITS = 9  # of an origin, after the point: nanometres [m]
# of mode trinary, as map_saver writes them
GREY = 0
UNKNOWN_GREY = 205
FREE_GREY = 254


class MapYaml(NamedTuple):
    """The content of a map's YAML."""

    image: Path
    resolution: float  # [m]
    origin: tuple[float, float, float]  # x, y [m], yaw [rad]
    mode: str
    negate: bool
    occupied: float
    free: float
    ground: float = 0.0  # world z of the floor [m]; navbake's own key


def encode_nav2(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    radius: float | None = None,
    mode: str = "trinary",
    image: str | None = None,
    inflation: float | None = None,
    scaling: float | None = None,
) -> Files:
    """Encode the maps of a grid: for each level an image, and a YAML that names it.

    Cells without a floor are unknown, others free or occupied. Modes ``scale`` and ``raw`` have
    costs, too: 1 to 98 for weights above 1, and 99 for cells that only an inflation closed.

    Args:
        path: ends in ``.yaml`` or ``.yml``; several levels have numbers after the stem:
            ``map_0.yaml``, ``map_1.yaml``.
        level: this level's map only, under the name itself.
        radius: inflate for a robot of this radius first [m]; see `SceneGrid2D.inflate`.
        mode: ``trinary``, ``scale`` or ``raw``.
        image: ``pgm`` or ``png``; ``png`` in mode ``scale``, else ``pgm``, if None.
        inflation: costs by nav2's formula up to this distance from obstacles, its
            ``inflation_radius`` [m]; not in mode ``trinary``. The default radius is the grid's.
        scaling: nav2's ``cost_scaling_factor`` [1/m]; 10 if None.

    Raises:
        FormatError: there is no such level, mode or image, or options exclude each other.
        QueryError: a radius, inflation or scaling out of its range.
    """
    image = image or ("png" if mode == "scale" else "pgm")
    check_choice(mode, MODES, "mode")
    check_choice(image, IMAGES, "image")
    if mode == "scale" and image == "pgm":
        raise FormatError("mode scale marks unknown cells by transparency: expected image png")
    if inflation is not None and mode == "trinary":
        raise FormatError("mode trinary has no costs: expected mode scale or raw with an inflation")
    if scaling is not None and inflation is None:
        raise FormatError("scaling is how fast the costs of an inflation fall: expected one")
    scaling = NAV2_SCALING if scaling is None else scaling
    if radius is not None and inflation is None:
        grid = grid.inflate(radius)
    files: Files = {}
    for k, yaml_path in list_level_paths(grid, path, level, YAMLS).items():
        if inflation is None:
            values = occupancy.compute_occupancy_values(grid, k)
        else:
            robot = grid.agent_radius if radius is None else radius
            values = occupancy.compute_costmap_values(grid, k, robot, inflation, scaling)
        files |= encode_map(grid.levels[k], values, yaml_path, mode, image)
    return files


def encode_map(
    level: SceneGrid2D, values: occupancy.Values, path: Path, mode: str, image: str
) -> Files:
    """The image of a level's values, and the YAML that names it."""
    unknown = values == occupancy.UNKNOWN
    if mode == "raw":
        pixels = np.where(unknown, 255, values)
    elif mode == "trinary":
        pixels = np.where(values >= occupancy.INSCRIBED, GREY, FREE_GREY)
        pixels = np.where(unknown, UNKNOWN_GREY, pixels)
    else:  # colours with opacity
        grey = np.where(unknown, 127, np.rint((100 - values.astype(float)) * 2.55))
        pixels = np.stack([grey, grey, grey, np.where(unknown, 0, 255)], axis=-1)
    image_path = path.with_suffix(f".{image}")
    check_named(image_path)
    x_min, y_min, _, _ = level.lattice.bounds
    # in mode scale, values between the thresholds are spread over 0 to 100; keep them distinct
    occupied, free = (1.0, 0.0) if mode == "scale" else (OCCUPIED_THRESHOLD, FREE_THRESHOLD)
    entries: Json = {
        "image": image_path.name,
        "mode": mode,
        "resolution": float(level.lattice.cell_size),
        "origin": [rounded(x_min, DIGITS), rounded(y_min, DIGITS), 0.0],
        "negate": 0,
        "occupied_thresh": occupied,
        "free_thresh": free,
        "navbake": {"ground": rounded(level.ground, DIGITS)},  # ignored by nav2
    }
    kind = {"pgm": "PPM", "png": "PNG"}[image]
    return {image_path: encode_image(pixels.astype(np.uint8), kind), path: encode_yaml(entries)}


def read_nav2(path: str | PathLike[str], *, rules: str = "humble") -> SceneGrid2D:
    """Read a map of ROS 1 or ROS 2 as a grid of one level.

    Free and occupied cells have a flat floor at z = 0 (or at navbake's own key
    ``navbake.ground``), unknown ones have none. In modes ``scale`` and ``raw``, values of 1
    to 98 become weights of nav2's costs; 99 is blocked.

    A map with a ``yaw`` of quarter turns, to a tenth of a cell over its diagonal, is rotated
    exactly. Otherwise it is resampled on cells along the world's axes: a cell has the value of the
    map at its centre, but is occupied if occupied cells of the map cover 1 % of it, so that no wall
    gets a gap. The content of the YAML is kept as ``nav2`` in the metadata.

    Args:
        path: the YAML.
        rules: for pixels, those of nav2 from ``humble`` to Jazzy, or of its branch ``main``; see
            `navbake.formats.nav2`.

    Raises:
        FormatError: the YAML or its image is missing, broken or too large, or there are no such
            rules.
    """
    values, lattice, stated = read_map(path, rules)
    content = {**stated._asdict(), "image": stated.image.name, "origin": list(stated.origin)}
    metadata = {"sceneId": readable_stem(path), "nav2": content}
    level = occupancy.level_from_values(values, lattice, stated.ground, metadata)
    check_grid(level, JsonPath(check_path(path)))
    return level


def read_map(
    path: str | PathLike[str], rules: str = "humble"
) -> tuple[occupancy.Values, Lattice, MapYaml]:
    """Read a map's values on cells along the axes, the lattice of these, and its YAML.

    See `read_nav2` for the arguments and errors.
    """
    check_choice(rules, PIXEL_RULES, "rules")
    stated = read_map_yaml(path)
    if not os.path.exists(stated.image):  # Path.exists raises for names that are too long
        raise FormatError(f"the image that `image` in {path} names isn't there: {stated.image}")
    try:
        check_regular(stated.image)
    except OSError as error:
        message = f"cannot read the image that `image` in {path} names: {error.strerror}"
        raise FormatError(f"{message} at {stated.image}") from error
    values = read_pixel_values(read_pixels(stated.image), stated, rules)
    return *occupancy.align_with_axes(values, stated.origin, stated.resolution), stated


def list_images(path: str | PathLike[str]) -> list[Path]:
    """The image files that `read_nav2` reads for a YAML; raises as `read_map_yaml` does."""
    return [read_map_yaml(path).image]


def read_map_yaml(path: str | PathLike[str]) -> MapYaml:
    """Read a map's YAML; raises a FormatError if nav2's keys are missing."""
    place = JsonPath(check_path(path))
    entries, _ = read_yaml(path, expected="the YAML of a map")
    if not isinstance(entries, dict):
        place.fail("expected a map's keys (image, resolution, origin, …), got none")
    image = entries.get("image", MISSING)
    if not isinstance(image, str) or not image:
        place["image"].refuse("the name of an image", image)
    stated = {
        key: float(check_number(entries.get(key, MISSING), place[key]))
        for key in ("resolution", "occupied_thresh", "free_thresh")
    }
    if not LEAST_EDGE <= stated["resolution"] <= FARTHEST:
        place["resolution"].refuse("a number > 0 [m]", stated["resolution"])
    occupied = stated["occupied_thresh"]
    free = stated["free_thresh"]
    if not 0 <= free < occupied <= 1:
        place["free_thresh"].fail(
            f"expected 0 <= free_thresh < occupied_thresh <= 1, got {free:g} and {occupied:g}"
        )
    mode = entries.get("mode", "trinary")
    if mode not in MODES:
        place["mode"].refuse(" or ".join(MODES), mode)
    negate = entries.get("negate", MISSING)
    if isinstance(negate, str):  # YAML's words for true and false, as yaml-cpp takes them
        words = {"yes": 1, "on": 1, "y": 1, "no": 0, "off": 0, "n": 0}
        negate = words.get(negate.lower(), negate)
    if not isinstance(negate, int):
        place["negate"].refuse("0 or 1", negate)
    own = entries.get("navbake")
    origin = check_vector(entries.get("origin", MISSING), place["origin"])
    ground = own.get("ground", 0.0) if isinstance(own, dict) else 0.0
    ground = float(check_number(ground, place["navbake"]["ground"]))
    if not all(abs(value) <= FARTHEST for value in (*origin[:2], ground)):
        place["origin"].fail(f"expected a map within {FARTHEST:g} m of the origin")
    place_of_image = Path(path).parent / image
    resolution = stated["resolution"]
    return MapYaml(place_of_image, resolution, origin, mode, bool(negate), occupied, free, ground)


def read_pixel_values(pixels: Pixels, stated: MapYaml, rules: str = "humble") -> occupancy.Values:
    """The occupancy values of an image by nav2's rules, row 0 at the top; see the module's head."""
    light = pixels.light
    steps = 3 * pixels.white
    opacity = pixels.opacity
    is_main = rules == "main"
    real: type[np.floating[Any]] = np.float32 if is_main else np.float64
    if is_main:
        light = pixels.luma
        steps = 255
    elif stated.mode == "trinary" and opacity is not None:
        light = light + opacity
        steps = 4 * pixels.white
    # a table of the few greys, or sums of channels
    shade = np.arange(steps + 1, dtype=real) / real(steps)
    occupied = shade if stated.negate else 1 - shade
    most = real(stated.occupied)
    least = real(stated.free)
    if stated.mode == "raw":
        known = np.rint(shade * 255)
        table = np.where(known <= occupancy.OCCUPIED, known, occupancy.UNKNOWN)
    else:
        between: NDArray[Any] = np.full(steps + 1, float(occupancy.UNKNOWN))
        if stated.mode == "scale":
            shares = (occupied - least) / real(stated.occupied - stated.free) * 100
            between = np.floor(shares + real(0.5)) if is_main else np.rint(shares)
        is_free = occupied <= least if is_main else occupied < least
        is_occupied = most <= occupied if is_main else most < occupied
        table = np.where(
            is_free, occupancy.FREE, np.where(is_occupied, occupancy.OCCUPIED, between)
        )
    values: occupancy.Values = table.astype(np.int8)[light]
    if opacity is not None and (stated.mode == "scale" or (is_main and stated.mode == "trinary")):
        values[opacity != 255] = occupancy.UNKNOWN
    return values


def check_choice(value: str, known: tuple[str, ...], name: str) -> None:
    """Raise a FormatError for a value that is none of those known."""
    if value not in known:
        raise FormatError(f"expected {' or '.join(known)} as {name}, got {value!r}")
