"""Maps of ROS and nav2: an image of a level, and its YAML.

A map has its origin at the lower left corner of the image's lower left pixel. Position (x, y) lies
in column ``floor((x - origin_x) / resolution)`` and in row ``floor((y - origin_y) / resolution)``,
counted from the bottom.

Source: ``map_io.cpp`` of ``nav2_map_server``. `read_pixel_values` follows its rules for pixels: the
three modes, both thresholds, ``negate`` (which ``raw`` ignores), and transparency. They differ
between nav2's versions:

- ``humble``, to Jazzy: a grey is the mean of its channels, a value on a threshold is neither free
  nor occupied, and transparency counts as a fourth channel in mode ``trinary`` and makes a pixel
  unknown in ``scale``.
- ``main``: a grey is the pixel's luma, of 8 bits; a value on a threshold is free or occupied; a
  transparent pixel is unknown in both modes.

Files that `encode_nav2` writes mean the same in both versions.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError, count_of
from navbake.files import check_regular, readable_stem
from navbake.formats import occupancy
from navbake.formats.allowance import ABSENT, JsonPath, check_number, check_vector
from navbake.formats.level_paths import list_level_paths
from navbake.formats.navgrid import check_grid
from navbake.formats.source import (
    Files,
    Pixels,
    check_name_encoding,
    check_path,
    encode_image,
    read_pixels,
    read_yaml_source,
)
from navbake.known_names import check_choice
from navbake.navgrid.grid import MAX_RADIUS, NavGrid, SceneGrid2D
from navbake.navgrid.lattice import LEAST_EDGE, MAX_COORDINATE, Lattice, rounded
from navbake.runtime.inflation import NAV2_SCALING
from navbake.types import Bool, Json
from navbake.yaml_text import encode_yaml

LOG = logging.getLogger(__name__)
MODES = ("trinary", "scale", "raw")
PIXEL_RULES = ("humble", "main")
IMAGE_SUFFIXES = ("pgm", "png")
YAML_SUFFIXES = (".yaml", ".yml")
# map_saver's thresholds; with a free threshold of 0.25, a grey of 205 would be free
OCCUPIED_THRESHOLD = 0.65
FREE_THRESHOLD = 0.196
DECIMALS = 9  # of an origin: nanometres [m]
# greys of mode trinary, as map_saver writes them
OCCUPIED_GREY = 0
UNKNOWN_GREY = 205
FREE_GREY = 254


class MapYaml(NamedTuple):
    """The content of a map's YAML.

    Attributes:
        image: the path of the image.
        resolution: the edge of a cell [m].
        origin: the outer corner of the lower left cell, world x, y [m], and the map's yaw [rad].
        mode: ``trinary``, ``scale`` or ``raw``.
        negate: whether dark pixels are free.
        occupied: the threshold, 0 to 1: pixels that are darker are occupied.
        free: the threshold, 0 to 1: pixels that are less dark are free.
        ground: world z of the floor [m], from navbake's own keys in the YAML.
        radius: radius of the agent for which cells are blocked [m], from there, too; 0 for none.
    """

    image: Path
    resolution: float
    origin: tuple[float, float, float]
    mode: str
    negate: bool
    occupied: float
    free: float
    ground: float = 0.0
    radius: float = 0.0


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
    closed_cell_masks: Sequence[Bool] | None = None,
) -> Files:
    """Encode the maps of a grid: for each level an image, and a YAML that names it.

    Cells without a floor are unknown, all others free or occupied. Modes ``scale`` and ``raw`` also
    have costs: 1 to 98 for weights above 1, and 99 for cells that only an inflation blocks.

    Args:
        grid: the grid.
        path: the YAML, which ends in ``.yaml`` or ``.yml``; those of several levels have numbers
            after the stem: ``map_0.yaml``, ``map_1.yaml``.
        level: the number of the only level to write, None for all.
        radius: inflate for a robot of this radius first [m]; see `SceneGrid2D.inflate`.
        mode: ``trinary``, ``scale`` or ``raw``.
        image: ``pgm`` or ``png``; ``png`` in mode ``scale``, else ``pgm``, if None.
        inflation: nav2's ``inflation_radius`` [m]: cells up to this distance from obstacles get
            costs by nav2's formula; not in mode ``trinary``. With it, `radius` is the radius of the
            grid's agent by default.
        scaling: nav2's ``cost_scaling_factor`` [1/m]; 10 if None.
        closed_cell_masks: for each level, the free cells that the map must show as occupied
            (stairs, and areas that bar the robot, see `navbake.formats.map_losses.ClosedCells`),
            shape (height, width), bool. They are not inflated. None for no such cells.

    Returns:
        The content of each file by its path.

    Raises:
        FormatError: there is no such level, mode or kind of image, or options exclude each other.
        QueryError: a radius, inflation or scaling is out of its range.
    """
    if not image:
        image = "png" if mode == "scale" else "pgm"
    check_choice(mode, MODES, "mode", FormatError)
    check_choice(image, IMAGE_SUFFIXES, "image", FormatError)
    if mode == "scale" and image == "pgm":
        raise FormatError("mode scale marks unknown cells by transparency: expected image png")
    if inflation is not None and mode == "trinary":
        raise FormatError("mode trinary has no costs: expected mode scale or raw with an inflation")
    if scaling is not None and inflation is None:
        raise FormatError("scaling is how fast the costs of an inflation fall: expected one")
    if scaling is None:
        scaling = NAV2_SCALING
    if radius is not None and inflation is None:
        grid = grid.inflate(radius)
    map_radius = grid.radius if inflation is None or radius is None else radius
    files: Files = {}
    for level_number, yaml_path in list_level_paths(grid, path, level, YAML_SUFFIXES).items():
        if inflation is None:
            values = occupancy.compute_occupancy_values(grid, level_number)
        else:
            robot_radius = grid.agent_radius if radius is None else radius
            values = occupancy.compute_costmap_values(
                grid, level_number, robot_radius, inflation, scaling
            )
        if closed_cell_masks is not None:
            values[closed_cell_masks[level_number]] = occupancy.OCCUPIED
        files |= encode_map(
            grid.levels[level_number], values, yaml_path, mode, image, radius=map_radius
        )
    return files


def encode_map(
    level: SceneGrid2D,
    values: occupancy.OccupancyValues,
    path: Path,
    mode: str,
    image: str,
    *,
    radius: float = 0.0,
) -> Files:
    """Encode a map of a level: the image of its occupancy values, and the YAML that names it.

    Args:
        level: the level.
        values: the values of its cells, shape (height, width), int8.
        path: the YAML; the image has the same name with another ending.
        mode: ``trinary``, ``scale`` or ``raw``.
        image: ``pgm`` or ``png``.
        radius: radius of the agent for which the values block cells [m]; 0 for none.

    Returns:
        The content of the image and of the YAML, each by its path.

    Raises:
        FormatError: the name of the image isn't UTF-8, so that a YAML can't hold it.
    """
    is_unknown = values == occupancy.UNKNOWN
    if mode == "raw":
        pixels = np.where(is_unknown, 255, values)
    elif mode == "trinary":
        pixels = np.where(values >= occupancy.INSCRIBED, OCCUPIED_GREY, FREE_GREY)
        pixels = np.where(is_unknown, UNKNOWN_GREY, pixels)
    else:  # colours with opacity
        grey = np.where(is_unknown, 127, np.rint((100 - values.astype(float)) * 2.55))
        opacity = np.where(is_unknown, 0, 255)
        pixels = np.stack([grey, grey, grey, opacity], axis=-1)
    image_path = path.with_suffix(f".{image}")
    check_name_encoding(image_path)
    x_min, y_min, _, _ = level.lattice.bounds
    occupied_threshold = OCCUPIED_THRESHOLD
    free_threshold = FREE_THRESHOLD
    # mode scale maps what is between the thresholds to 0 to 100: with these, all values differ
    if mode == "scale":
        occupied_threshold = 1.0
        free_threshold = 0.0
    map_yaml: Json = {
        "image": image_path.name,
        "mode": mode,
        "resolution": float(level.lattice.cell_size),
        "origin": [rounded(x_min, DECIMALS), rounded(y_min, DECIMALS), 0.0],
        "negate": 0,
        "occupied_thresh": occupied_threshold,
        "free_thresh": free_threshold,
        "navbake": {"ground": rounded(level.ground, DECIMALS)},  # ignored by nav2
    }
    if radius:
        map_yaml["navbake"]["radius"] = rounded(radius, DECIMALS)
    image_format = {"pgm": "PPM", "png": "PNG"}[image]
    return {
        image_path: encode_image(pixels.astype(np.uint8), image_format),
        path: encode_yaml(map_yaml),
    }


def read_nav2(path: str | PathLike[str], *, rules: str = "humble") -> SceneGrid2D:
    """Read a map of ROS 1 or ROS 2 as a grid of one level.

    Free and occupied cells have a flat floor at z = 0 (or at navbake's own key
    ``navbake.ground``), unknown ones have none. In modes ``scale`` and ``raw``, values of 1
    to 98 become weights of nav2's costs; 99 is blocked. A map with navbake's own key
    ``navbake.radius`` is read as a grid that was inflated for this radius: cells stay blocked as
    they are for an agent of this size.

    If the map's yaw is a whole number of quarter turns, the cells are only rearranged. That is also
    done for a yaw so near to one that no corner of the map is off by more than a tenth of a cell.
    Any other map is resampled on cells along the world's axes: a cell has the value of the map at
    its centre, but is occupied if occupied cells of the map cover 1 % of it, so that no wall gets a
    gap. The content of the YAML is kept as ``nav2`` in the metadata.

    Args:
        path: the YAML.
        rules: the version of nav2's rules for pixels: ``humble`` (up to Jazzy), or ``main`` (nav2's
            branch of that name); see `navbake.formats.nav2`.

    Returns:
        The level.

    Raises:
        FormatError: the YAML or its image is missing, broken or too large, or there are no such
            rules.

    Example:
        >>> grid = navbake.from_nav2("map.yaml")
        >>> path = navbake.PathFinder(grid).find_path((-4, 2, 0), (4, -3, 0))
    """
    values, lattice, map_yaml = read_map(path, rules)
    yaml_content = {
        **map_yaml._asdict(),
        "image": map_yaml.image.name,
        "origin": list(map_yaml.origin),
    }
    metadata: Json = {"sceneId": readable_stem(path), "nav2": yaml_content}
    radius = map_yaml.radius
    if radius:
        metadata["inflation"] = [{"radius": radius, "mode": "exact", "ledges": "avoid"}]
    level = occupancy.level_from_values(values, lattice, map_yaml.ground, metadata)
    if radius and map_yaml.mode == "trinary":  # other modes tell the blocked from the occupied
        is_obstacle = occupancy.find_obstacles(~level.free, radius / lattice.cell_size)
        is_unknown = values == occupancy.UNKNOWN
        level.attributes["occupancy"] = (is_obstacle | is_unknown).astype(np.uint8)
    check_grid(level, JsonPath(check_path(path)))
    return level


def read_map(
    path: str | PathLike[str], rules: str = "humble"
) -> tuple[occupancy.OccupancyValues, Lattice, MapYaml]:
    """Read a map, and resample it on cells along the world's axes.

    Args:
        path: the YAML.
        rules: the version of the rules for pixels, see `read_nav2`.

    Returns:
        The values of the cells, their lattice, and the content of the YAML.

    Raises:
        FormatError: the YAML or its image is missing, broken or too large, or there are no such
            rules.
    """
    check_choice(rules, PIXEL_RULES, "rules", FormatError)
    map_yaml = read_map_yaml(path)
    image = map_yaml.image
    if not os.path.exists(image):  # Path.exists raises for names that are too long
        message = f"the image that `image` in {path} names isn't there: {image}"
        raise FormatError(message, path=str(path), key="image", value=str(image))
    try:
        check_regular(image)
    except OSError as error:
        message = f"cannot read the image that `image` in {path} names: {error.strerror}"
        raise FormatError(
            f"{message} at {image}", path=str(path), key="image", value=str(image)
        ) from error
    pixels = read_pixels(image)
    values = read_pixel_values(pixels, map_yaml, rules)
    is_unknown_grey = pixels.channel_sum == 3 * UNKNOWN_GREY * (pixels.max_channel / 255)
    num_freed = int(np.count_nonzero(is_unknown_grey & (values == occupancy.FREE)))
    if map_yaml.mode == "trinary" and num_freed:
        LOG.warning(
            "%s: %s of grey %d, which map savers write for unknown, are free by `free_thresh: %g`; "
            "%g leaves them unknown",
            path,
            count_of(num_freed, "pixel"),
            UNKNOWN_GREY,
            map_yaml.free,
            FREE_THRESHOLD,
        )
    yaw = map_yaml.origin[2]
    if not occupancy.is_quarter_turn(yaw, values.shape):
        LOG.warning(
            "%s is turned by %g rad: it is laid on cells along the world's axes, and what is "
            "occupied grows by up to a cell",
            path,
            yaw,
        )
    values, lattice = occupancy.align_with_axes(values, map_yaml.origin, map_yaml.resolution)
    return values, lattice, map_yaml


def list_images(path: str | PathLike[str]) -> list[Path]:
    """List the image files that `read_nav2` reads besides a map's YAML.

    Args:
        path: the YAML.

    Raises:
        FormatError: the YAML can't be read, or nav2's keys are missing or broken.
    """
    return [read_map_yaml(path).image]


def read_map_yaml(path: str | PathLike[str]) -> MapYaml:
    """Read a map's YAML.

    Raises:
        FormatError: the file can't be read, or nav2's keys are missing or broken.
    """
    place = JsonPath(check_path(path))
    entries, _ = read_yaml_source(path, expected="the YAML of a map")
    if not isinstance(entries, dict):
        place.fail("expected a map's keys (image, resolution, origin, …), got none")
    image = entries.get("image", ABSENT)
    if not isinstance(image, str) or not image:
        place["image"].refuse("the name of an image", image)

    def read_float(key: str) -> float:
        return float(check_number(entries.get(key, ABSENT), place[key]))

    resolution = read_float("resolution")
    occupied_threshold = read_float("occupied_thresh")
    free_threshold = read_float("free_thresh")
    if not LEAST_EDGE <= resolution <= MAX_COORDINATE:
        place["resolution"].refuse("a number > 0 [m]", resolution)
    if not 0 <= free_threshold < occupied_threshold <= 1:
        place["free_thresh"].fail(
            "expected 0 <= free_thresh < occupied_thresh <= 1, "
            f"got {free_threshold:g} and {occupied_threshold:g}"
        )
    mode = entries.get("mode", "trinary")
    if mode not in MODES:
        place["mode"].refuse(" or ".join(MODES), mode)
    negate = entries.get("negate", ABSENT)
    if isinstance(negate, str):  # YAML's words for true and false, as yaml-cpp takes them
        number_of_word = {"yes": 1, "on": 1, "y": 1, "no": 0, "off": 0, "n": 0}
        negate = number_of_word.get(negate.lower(), negate)
    if not isinstance(negate, int):
        place["negate"].refuse("0 or 1", negate)
    origin = check_vector(entries.get("origin", ABSENT), place["origin"])
    navbake_entry = entries.get("navbake")
    navbake_keys = navbake_entry if isinstance(navbake_entry, dict) else {}
    ground = float(check_number(navbake_keys.get("ground", 0.0), place["navbake"]["ground"]))
    radius = float(check_number(navbake_keys.get("radius", 0.0), place["navbake"]["radius"]))
    if not 0 <= radius <= MAX_RADIUS:
        place["navbake"]["radius"].refuse(f"0 to {MAX_RADIUS:,.0f} m", radius)
    if not all(abs(value) <= MAX_COORDINATE for value in (*origin[:2], ground)):
        place["origin"].fail(f"expected a map within {MAX_COORDINATE:g} m of the origin")
    return MapYaml(
        image=Path(path).parent / image,
        resolution=resolution,
        origin=origin,
        mode=mode,
        negate=bool(negate),
        occupied=occupied_threshold,
        free=free_threshold,
        ground=ground,
        radius=radius,
    )


def read_pixel_values(
    pixels: Pixels, map_yaml: MapYaml, rules: str = "humble"
) -> occupancy.OccupancyValues:
    """Convert the pixels of a map to occupancy values by nav2's rules.

    Args:
        pixels: the pixels of the image.
        map_yaml: the content of the map's YAML.
        rules: the version of the rules, ``humble`` or ``main``; the module's docstring has both.

    Returns:
        The values, shape (height, width), int8, row 0 at the top.
    """
    brightness = pixels.channel_sum
    max_brightness = 3 * pixels.max_channel
    opacity = pixels.opacity
    follows_main = rules == "main"
    # nav2 computes in float or in double
    float_type: type[np.floating[Any]] = np.float32 if follows_main else np.float64
    if follows_main:
        brightness = pixels.luma
        max_brightness = 255
    elif map_yaml.mode == "trinary" and opacity is not None:
        brightness = brightness + opacity
        max_brightness = 4 * pixels.max_channel

    # make a table first: there are few different greys, or sums of channels
    lightness = np.arange(max_brightness + 1, dtype=float_type) / float_type(max_brightness)
    darkness = lightness if map_yaml.negate else 1 - lightness
    occupied_threshold = float_type(map_yaml.occupied)
    free_threshold = float_type(map_yaml.free)
    if map_yaml.mode == "raw":
        raw_values = np.rint(lightness * 255)
        value_of_brightness = np.where(
            raw_values <= occupancy.OCCUPIED, raw_values, occupancy.UNKNOWN
        )
    else:
        values_between_thresholds: NDArray[Any] = np.full(
            max_brightness + 1, float(occupancy.UNKNOWN)
        )
        if map_yaml.mode == "scale":
            percent = (
                (darkness - free_threshold) / float_type(map_yaml.occupied - map_yaml.free) * 100
            )
            values_between_thresholds = (
                np.floor(percent + float_type(0.5)) if follows_main else np.rint(percent)
            )
        is_free = darkness <= free_threshold if follows_main else darkness < free_threshold
        is_occupied = (
            occupied_threshold <= darkness if follows_main else occupied_threshold < darkness
        )
        value_of_brightness = np.where(
            is_free,
            occupancy.FREE,
            np.where(is_occupied, occupancy.OCCUPIED, values_between_thresholds),
        )
    values: occupancy.OccupancyValues = value_of_brightness.astype(np.int8)[brightness]

    is_transparent_unknown = map_yaml.mode == "scale" or (
        follows_main and map_yaml.mode == "trinary"
    )
    if opacity is not None and is_transparent_unknown:
        values[opacity != 255] = occupancy.UNKNOWN
    return values
