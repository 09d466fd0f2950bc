"""Maps of ROS and nav2, and masks of its costmap filters: an image of a level, and its YAML.

A map has its origin at the lower left corner of the image's lower left pixel, and its rows from
the top. Position (x, y) lies in column ``floor((x - origin_x) / resolution)``, and in that row
from the bottom which the same formula gives of y.

A mask is a map on the cells of its level, in mode ``raw``. 0 changes nothing. In a keepout mask,
100 is where no robot may go. In a speed mask, 1 to 100 is the limit in percent of a robot's
speed, which the filter info server takes with ``type: 1``, ``base: 0.0``, ``multiplier: 1.0``.

Source: nav2's documentation of its costmap filters; ``map_io.cpp`` of ``nav2_map_server``, whose
rules for pixels `read_values` follows: the three modes, both thresholds, ``negate`` (which ``raw``
ignores), and transparency, which in mode ``trinary`` counts as a fourth channel and in ``scale``
makes a pixel unknown.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from navbake.config.yaml_text import parse_yaml
from navbake.errors import ConfigError, FormatError
from navbake.formats.allowance import MISSING, JsonPath, number, vector
from navbake.formats.geojson import read_room_outlines
from navbake.formats.images import Pixels, encode_pgm, encode_png, level_paths, read_pixels
from navbake.formats.navgrid import checked_grid
from navbake.formats.occupancy import (
    FREE,
    INSCRIBED,
    OCCUPIED,
    UNKNOWN,
    Values,
    inflated_values,
    level_from_values,
    resample,
    turn,
    values_of,
)
from navbake.formats.source import Files, check_path, path_name, read_bytes
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE
from navbake.navgrid.polygon import cover_cells
from navbake.runtime.inflation import SCALING
from navbake.types import Bool, Json

MODES = ("trinary", "scale", "raw")
IMAGES = ("pgm", "png")
YAMLS = (".yaml", ".yml")
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196  # of map_saver; 0.25 takes 205 for free
DIGITS = 9  # of an origin, after the point: nanometres [m]
GREY = {"occupied": 0, "unknown": 205, "free": 254}  # of mode trinary, as map_saver writes them
RAW_UNKNOWN = 255
QUARTER = math.pi / 2
YAW_SLACK = 1e-9  # [rad]
MAX_LISTED = 20  # names that an error lists


class MapRules(NamedTuple):
    """What a map's YAML says."""

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
    """Make the maps of a grid: for each level an image, and a YAML that names it.

    Cells without a floor are unknown, others free or occupied. Modes ``scale`` and ``raw`` have
    costs, too: 1 to 98 for weights above 1, and 99 for cells that only an inflation closed.

    Args:
        path: ends in ``.yaml`` or ``.yml``. Of several levels, each has its own map, whose
            number follows the stem: ``map_0.yaml``, ``map_1.yaml``.
        level: make this level's map only, under the name itself.
        radius: inflate for a robot of this radius first [m]; see `SceneGrid2D.inflate`.
        mode: ``trinary``, ``scale`` or ``raw``.
        image: ``pgm`` or ``png``; if None, ``pgm``, but ``png`` in mode ``scale``, which needs
            transparency.
        inflation: costs by nav2's formula up to this distance from obstacles, its
            ``inflation_radius`` [m]; not in mode ``trinary``. The radius is the grid's agent's
            unless given.
        scaling: nav2's ``cost_scaling_factor`` [1/m]; 10 if None.

    Raises:
        FormatError: there is no such level, mode or image, or options that don't go together.
        QueryError: a radius, inflation or scaling out of its range.
    """
    image = image or ("png" if mode == "scale" else "pgm")
    _check_choice(mode, MODES, "mode")
    _check_choice(image, IMAGES, "image")
    if mode == "scale" and image == "pgm":
        raise FormatError("mode scale marks unknown cells by transparency: expected image png")
    if inflation is not None and mode == "trinary":
        raise FormatError("mode trinary has no costs: expected mode scale or raw with an inflation")
    if scaling is not None and inflation is None:
        raise FormatError("scaling is how fast the costs of an inflation fall: expected one")
    scaling = SCALING if scaling is None else scaling
    if radius is not None and inflation is None:
        grid = grid.inflate(radius)
    files: Files = {}
    for k, yaml_path in level_paths(grid, path, level, YAMLS).items():
        if inflation is None:
            values = values_of(grid, k)
        else:
            robot = grid.agent_radius if radius is None else radius
            values = inflated_values(grid, k, robot, inflation, scaling)
        files |= encode_map(grid.levels[k], values, yaml_path, mode, image)
    return files


def encode_map(level: SceneGrid2D, values: Values, path: Path, mode: str, image: str) -> Files:
    """The image of a level's values, and the YAML that names it."""
    pixels = _draw(values, mode)
    image_path = path.with_suffix(f".{image}")
    x_min, y_min, _, _ = level.lattice.bounds
    # in mode scale, a pixel between the thresholds is spread over 0 to 100: so that none is lost
    occupied, free = (1.0, 0.0) if mode == "scale" else (OCCUPIED_THRESHOLD, FREE_THRESHOLD)
    entries: Json = {
        "image": image_path.name,
        "mode": mode,
        "resolution": float(level.lattice.cell_size),
        "origin": [round(float(x_min), DIGITS) + 0.0, round(float(y_min), DIGITS) + 0.0, 0.0],
        "negate": 0,
        "occupied_thresh": occupied,
        "free_thresh": free,
        "navbake": {"ground": round(float(level.ground), DIGITS) + 0.0},  # nav2 passes over it
    }
    text = yaml.safe_dump(entries, sort_keys=False, default_flow_style=None, allow_unicode=True)
    picture = encode_pgm(pixels) if image == "pgm" else encode_png(pixels)
    return {image_path: picture, path: text.encode()}


def read_nav2(path: str | PathLike[str]) -> SceneGrid2D:
    """Read a map of ROS 1 or ROS 2 as a grid of one level.

    Free and occupied cells have a flat floor at z = 0 (or where navbake's own key
    ``navbake.ground`` says), unknown ones have none. In modes ``scale`` and ``raw``, values of 1
    to 98 are costs, and weigh what nav2 makes of them; 99 is blocked.

    A map that is turned by quarters (``yaw``) is turned exactly. Otherwise it is laid anew on
    cells along the world's axes: a cell takes the value of the map at its centre, but is occupied
    wherever an occupied cell of the map reaches into it, so that no wall gets a gap.

    What the YAML says is kept as ``nav2`` in the metadata.

    Raises:
        FormatError: the YAML or its image is missing, broken or too large.
    """
    rules = read_rules(path)
    if not os.path.exists(rules.image):  # Path.exists raises for names that are too long
        raise FormatError(f"the image that `image` in {path} names isn't there: {rules.image}")
    values = read_values(read_pixels(rules.image), rules)
    x, y, yaw = rules.origin
    quarters = round(yaw / QUARTER)
    if abs(yaw - quarters * QUARTER) <= YAW_SLACK:
        values, corner = turn(values, (x, y), rules.resolution, quarters)
    else:
        values, corner = resample(values, (x, y), rules.resolution, yaw, occupied=OCCUPIED)
    stated = {**rules._asdict(), "image": rules.image.name, "origin": list(rules.origin)}
    metadata = {"sceneId": Path(path).stem, "nav2": stated}
    level = level_from_values(values, rules.resolution, (*corner, rules.ground), metadata)
    checked_grid(level, JsonPath(check_path(path)))
    return level


def list_images(path: str | PathLike[str]) -> list[Path]:
    """The files beside a map's YAML that `read_nav2` reads; raises as `read_rules` does."""
    return [read_rules(path).image]


def read_rules(path: str | PathLike[str]) -> MapRules:
    """Read a map's YAML.

    Raises:
        FormatError: it is missing, no YAML, or lacks what nav2 needs.
    """
    place = JsonPath(check_path(path))
    data, name = read_bytes(path)
    try:
        entries = parse_yaml(data.decode("utf-8-sig"), name)
    except UnicodeDecodeError as error:
        raise FormatError(
            f"{path_name(name)} is no YAML: byte {error.start} is not UTF-8"
        ) from error
    except ConfigError as error:
        raise FormatError(f"expected the YAML of a map: {error}") from error
    if not isinstance(entries, dict):
        place.fail("expected a map's keys (image, resolution, origin, …), got none")
    image = entries.get("image", MISSING)
    if not isinstance(image, str) or not image:
        place["image"].refuse("the name of an image", image)
    stated = {
        key: float(number(entries.get(key, MISSING), place[key]))
        for key in ("resolution", "occupied_thresh", "free_thresh")
    }
    if not LEAST_EDGE <= stated["resolution"] <= FARTHEST:
        place["resolution"].refuse("a number > 0 [m]", stated["resolution"])
    occupied, free = stated["occupied_thresh"], stated["free_thresh"]
    if not 0 <= free < occupied <= 1:
        place["free_thresh"].fail(
            f"expected 0 <= free_thresh < occupied_thresh <= 1, got {free:g} and {occupied:g}"
        )
    mode = entries.get("mode", "trinary")
    if mode not in MODES:
        place["mode"].refuse(" or ".join(MODES), mode)
    own, origin = entries.get("navbake"), vector(entries.get("origin", MISSING), place["origin"])
    ground = own.get("ground", 0.0) if isinstance(own, dict) else 0.0
    ground = float(number(ground, place["navbake"]["ground"]))
    if not all(abs(value) <= FARTHEST for value in (*origin[:2], ground)):
        place["origin"].fail(f"expected a map within {FARTHEST:g} m of the origin")
    return MapRules(
        image=Path(path).parent / image,
        resolution=stated["resolution"],
        origin=origin,
        mode=mode,
        negate=_flag(entries.get("negate", MISSING), place["negate"]),
        occupied=occupied,
        free=free,
        ground=ground,
    )


def read_values(pixels: Pixels, rules: MapRules) -> Values:
    """What nav2's map server makes of an image, row 0 at the top; see the module's head."""
    light, steps, opacity = pixels.light, 3 * pixels.white, pixels.opacity
    if rules.mode == "trinary" and opacity is not None:
        light, steps = light + opacity, 4 * pixels.white
    # there are few sums of channels, so each is judged once and looked up
    shade = np.arange(steps + 1) / steps
    occupied = shade if rules.negate else 1.0 - shade
    if rules.mode == "raw":
        known = np.rint(shade * 255)
        table = np.where(known <= OCCUPIED, known, UNKNOWN)
    else:
        between: NDArray[Any] = np.full(steps + 1, float(UNKNOWN))
        if rules.mode == "scale":
            between = np.rint((occupied - rules.free) / (rules.occupied - rules.free) * 100.0)
        table = np.where(occupied < rules.free, FREE, between)
        table = np.where(rules.occupied < occupied, OCCUPIED, table)
    values: Values = table.astype(np.int8)[light]
    if rules.mode == "scale" and opacity is not None:
        values[opacity != 255] = UNKNOWN
    return values


def _draw(values: Values, mode: str) -> NDArray[np.uint8]:
    """The pixels from which a mode reads these values; colours with opacity in mode scale."""
    if mode == "raw":
        return np.where(values == UNKNOWN, RAW_UNKNOWN, values).astype(np.uint8)
    if mode == "trinary":
        grey = np.where(values >= INSCRIBED, GREY["occupied"], GREY["free"])
        return np.where(values == UNKNOWN, GREY["unknown"], grey).astype(np.uint8)
    grey = np.where(values == UNKNOWN, 127, np.rint((100 - values.astype(float)) * 2.55))
    opacity = np.where(values == UNKNOWN, 0, 255)
    return np.stack([grey, grey, grey, opacity], axis=-1).astype(np.uint8)


def _flag(value: object, place: JsonPath) -> bool:
    """YAML's words for true and false, and numbers, as yaml-cpp takes them."""
    if isinstance(value, bool | int):
        return bool(value)
    word = value.lower() if isinstance(value, str) else ""
    if word not in ("yes", "on", "y", "no", "off", "n"):
        place.refuse("0 or 1", value)
    return word in ("yes", "on", "y")


def _check_choice(value: str, known: tuple[str, ...], name: str) -> None:
    if value not in known:
        raise FormatError(f"expected {' or '.join(known)} as {name}, got {value!r}")


# ---------------------------------------------------------------- masks


class Zone(NamedTuple):
    """A part of a level."""

    names: tuple[str, ...]  # that it can be called by
    level: int
    cells: int | Bool  # the index of a room, or the mask of a polygon


def encode_keepout(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    image: str | None = None,
    zone: Sequence[str] | None = None,
    zones: str | PathLike[str] | None = None,
) -> Files:
    """Make the masks of the keepout filter, one for each level.

    Args:
        path, level: as of `encode_nav2`.
        image: ``pgm`` or ``png``; ``pgm`` if None.
        zone: names, ids or numbers of rooms, and names of polygons.
        zones: a GeoJSON file of polygons, see `navbake.formats.geojson.read_room_outlines`. All
            of them count if `zone` is None.

    Raises:
        FormatError: nothing has such a name, or a polygon holds no cell's centre of its level.
    """
    known = _find_zones(grid, zones)
    chosen = [one for one in known if not isinstance(one.cells, int)]
    if zone is not None:
        chosen = [one for name in zone for one in _named(name, known)]
    return _encode_mask(grid, path, level, image, [(one, OCCUPIED) for one in chosen])


def encode_speed(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    image: str | None = None,
    zone: Sequence[str] | None = None,
    zones: str | PathLike[str] | None = None,
) -> Files:
    """Make the masks of the speed filter, one for each level.

    Args:
        path, level, image, zones: as of `encode_keepout`.
        zone: ``NAME=PERCENT`` each, from 1 to 100; where several overlap, the least counts.

    Raises:
        FormatError: as of `encode_keepout`, or a limit is none.
    """
    known = _find_zones(grid, zones)
    chosen = []
    for entry in zone or []:
        name, _, text = entry.rpartition("=")
        if not name or not text.isdecimal() or len(text) > 3 or not 1 <= int(text) <= 100:
            raise FormatError(f"expected NAME=PERCENT, 1 to 100, as zone, got {entry!r}")
        chosen += [(one, int(text)) for one in _named(name, known)]
    return _encode_mask(grid, path, level, image, sorted(chosen, key=lambda pair: -pair[1]))


def _encode_mask(
    grid: NavGrid,
    path: Path,
    level: int | None,
    image: str | None,
    chosen: list[tuple[Zone, int]],
) -> Files:
    image = image or "pgm"
    _check_choice(image, IMAGES, "image")
    if not chosen:
        raise FormatError("a mask needs zones: rooms by name, id or number, or polygons (GeoJSON)")
    files: Files = {}
    for k, yaml_path in level_paths(grid, path, level, YAMLS).items():
        own = grid.levels[k]
        values: Values = np.full(own.shape, FREE, dtype=np.int8)
        for zone, value in chosen:
            if zone.level == k:
                is_room = isinstance(zone.cells, int)
                values[own.room_index == zone.cells if is_room else zone.cells] = value
        files |= encode_map(own, values, yaml_path, "raw", image)
    return files


def _find_zones(grid: NavGrid, path: str | PathLike[str] | None) -> list[Zone]:
    """The rooms of a grid, and the polygons of a file."""
    found = []
    for room in grid.rooms:
        names = (str(room.index), room.id, *([room.name] if room.name else []))
        found.append(Zone(names, room.level, room.index))
    for k, outline in enumerate([] if path is None else read_room_outlines(path)):
        name = outline["name"] or f"feature {k}"
        where = _level_of(grid, outline["level"], f"{name!r} in {path}")
        rings = [outline["points"], *outline["rings"]]
        mask = cover_cells(rings, grid.levels[where].lattice)
        if not mask.any():
            raise FormatError(f"{name!r} in {path} lies outside of level {where}: it holds no cell")
        found.append(Zone((name,), where, mask))
    return found


def _level_of(grid: NavGrid, stated: Json, whose: str) -> int:
    names = grid.level_names
    if isinstance(stated, str) and stated in names:
        return names.index(stated)
    if isinstance(stated, int) and stated < len(names):
        return stated
    raise FormatError(f"no level {stated!r}, which {whose} is on: the grid has {', '.join(names)}")


def _named(name: str, known: list[Zone]) -> list[Zone]:
    """The zones of a name; one that several levels have is on all of them."""
    found = [zone for zone in known if name in zone.names]
    if not found:
        names = list(dict.fromkeys(zone.names[-1] for zone in known))
        listed = ", ".join(names[:MAX_LISTED]) + (", …" if len(names) > MAX_LISTED else "")
        raise FormatError(f"no room or polygon is called {name!r}; there are: {listed or 'none'}")
    return found
