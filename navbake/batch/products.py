"""What a batch makes of each scene besides its grid."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from navbake.auditor.audit import audit
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError, MissingDependencyError
from navbake.formats.convert import OCTREES, VOXELS
from navbake.formats.navgrid import write_navgrid
from navbake.formats.source import write_bytes
from navbake.formats.voxels import write_voxels
from navbake.navgrid.grid import NavGrid
from navbake.views.layers import LAYERS

GRID = "grid.json.gz"  # of every scene, written last: where it is, all is there
PICTURE, REPORT = "picture.png", "report.html"
THUMBNAIL = "thumbnail.png"  # no product: it can be made of the grid at any time
RECORD = ".navbake-made"  # of a scene's folder: what was made, and the key, see `job.py`
PICTURE_LAYERS = ("rooms", "floor")
# all names that a product has ever had
OWN = re.compile(
    r"grid\.json\.gz|inflated-[\d.e+-]+\.json\.gz|nav2[\d._e+-]*\.(?:yaml|pgm)"
    r"|voxels-[\d.e+-]+\.\w+|picture\.png|report\.html|thumbnail\.png"
)


def parse_products(texts: Sequence[str]) -> tuple[str, ...]:
    """Check ``KIND`` or ``KIND:VALUE:…``; each once, numbers in their shortest form, sorted.

    So the same products in another order are known to be made already.

    Raises:
        ConfigError: there is no such kind, or its values are wrong.
        MissingDependencyError: what it needs is not installed.
    """
    products = set()
    for text in texts:
        name, *values = text.split(":")
        kind = KINDS.get(name)
        if kind is None or not kind.least <= len(values) <= kind.most:
            wanted = kind.usage if kind else f"one of {', '.join(k.usage for k in KINDS.values())}"
            raise ConfigError(f"expected {wanted} to make, got {text!r}")
        products.add(":".join((name, *kind.check(values, text))))
    pictures = sorted(product for product in products if product.startswith("picture"))
    if len(pictures) > 1:
        asked = ", ".join(pictures)
        raise ConfigError(f"expected one picture, with all its layers, to make, got {asked}")
    return tuple(sorted(products))


def make_product(product: str, grid: NavGrid, config: BakeConfig, folder: Path) -> None:
    """Write the files of a product, each whole or not at all."""
    name, *values = product.split(":")
    KINDS[name].make(grid, config, values, folder)


def write_thumbnail(grid: NavGrid, folder: Path) -> None:
    """Write a small picture of a grid into its scene's folder, for the batch's page."""
    from navbake.views.notebook import draw_thumbnail  # loads Pillow

    write_bytes(draw_thumbnail(grid), folder / THUMBNAIL)


def _numbers(values: Sequence[str], text: str) -> tuple[str, ...]:
    numbers = []
    for value in values:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (math.isfinite(number) and number >= 0):
            raise ConfigError(f"expected numbers >= 0 [m] after the colons, got {text!r} to make")
        numbers.append(f"{number:.12g}")
    return tuple(numbers)


def _check_voxels(values: Sequence[str], text: str) -> tuple[str, ...]:
    edge = _numbers(values[:1], text)
    if float(edge[0]) == 0:
        raise ConfigError(f"expected an edge of voxels > 0 [m], got {text!r} to make")
    ending = values[1] if len(values) > 1 else "binvox"
    if f".{ending}" not in VOXELS:
        known = ", ".join(suffix[1:] for suffix in VOXELS)
        raise ConfigError(f"expected an ending of {known}, got {text!r} to make")
    return (*edge, ending)


def _check_picture(values: Sequence[str], text: str) -> tuple[str, ...]:
    for layer in values:
        if layer not in LAYERS:
            raise ConfigError(f"expected layers of {', '.join(LAYERS)}, got {text!r} to make")
    if find_spec("matplotlib") is None:
        raise MissingDependencyError('pictures need matplotlib: pip install "navbake[plot]"')
    return tuple(values)


def _make_inflated(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    clearance = float(values[1]) if len(values) > 1 else None
    inflated = grid.inflate(float(values[0]), clearance)
    write_navgrid(inflated, folder / f"inflated-{'-'.join(values)}.json.gz")


def _make_nav2(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    from navbake.formats.nav2 import encode_nav2  # only who wants maps loads it

    path = folder / f"{'-'.join(('nav2', *values))}.yaml"
    radius = float(values[0]) if values else None
    for file, content in encode_nav2(grid, path, radius=radius).items():
        write_bytes(content, file)


def _make_voxels(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    from navbake.baker.voxelize.voxelizer import Voxelizer  # loads more of the baker than a bake

    edge, ending = values
    voxels = Voxelizer(config).create(res=float(edge), align=f".{ending}" in OCTREES)
    write_voxels(voxels, folder / f"voxels-{'.'.join(values)}")


def _make_picture(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    from navbake.views.plot import plot_grid  # loads Pillow

    plot_grid(grid, folder / PICTURE, layers=tuple(values) or PICTURE_LAYERS)


def _make_report(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    from navbake.views.report.report import write_report  # only who wants a report loads it

    write_report(grid, folder / REPORT, audits=[audit(grid)])


class Kind(NamedTuple):
    """A kind of product.

    Attributes:
        make: writes it.
        check: checks the values and gives them their shortest form.
        least, most: how many values it takes.
        usage: how it is asked for.
    """

    make: Callable[[NavGrid, BakeConfig, Sequence[str], Path], None]
    check: Callable[[Sequence[str], str], tuple[str, ...]]
    least: int
    most: int
    usage: str


KINDS: dict[str, Kind] = {
    "inflated": Kind(_make_inflated, _numbers, 1, 2, "inflated:RADIUS[:CLEARANCE]"),
    "nav2": Kind(_make_nav2, _numbers, 0, 1, "nav2[:RADIUS]"),
    "voxels": Kind(_make_voxels, _check_voxels, 1, 2, "voxels:EDGE[:ENDING]"),
    "picture": Kind(_make_picture, _check_picture, 0, len(LAYERS), "picture[:LAYER…]"),
    "report": Kind(_make_report, lambda *_: (), 0, 0, "report"),
}
