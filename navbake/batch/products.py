"""What a batch makes of each scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError
from navbake.navgrid.grid import NavGrid

GRID = "grid.json.gz"  # of every scene
Maker = Callable[[NavGrid, BakeConfig, Sequence[str]], dict[str, bytes]]


class Product(NamedTuple):
    """One thing to make of each scene, as ``inflated:0.3`` asks for it.

    Attributes:
        kind: one of `KINDS`.
        values: what stands after its name, between colons.
    """

    kind: str
    values: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> Product:
        """Read ``KIND`` or ``KIND:VALUE:…``.

        Raises:
            ConfigError: there is no such kind, or its values are none.
        """
        kind, *values = text.split(":")
        if kind not in KINDS:
            raise ConfigError(f"expected one of {', '.join(KINDS)} to make, got {text!r}")
        maker, least, most, usage = KINDS[kind]
        if not least <= len(values) <= most:
            raise ConfigError(f"expected {usage} to make, got {text!r}")
        for value in values[:least]:
            _number(value, usage, text)
        return cls(kind, tuple(values))

    def make(self, grid: NavGrid, config: BakeConfig) -> dict[str, bytes]:
        """The files, by their names."""
        return KINDS[self.kind][0](grid, config, self.values)

    def __str__(self) -> str:
        return ":".join((self.kind, *self.values))


def _number(value: str, usage: str, text: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise ConfigError(f"expected {usage} to make, got {text!r}") from None


def _make_grid(grid: NavGrid, config: BakeConfig, values: Sequence[str]) -> dict[str, bytes]:
    return {}  # it is made of every scene


def _make_inflated(grid: NavGrid, config: BakeConfig, values: Sequence[str]) -> dict[str, bytes]:
    from navbake.formats.navgrid import dumps_navgrid

    radius, clearance = float(values[0]), float(values[1]) if len(values) > 1 else None
    name = "-".join(("inflated", *values))
    inflated = grid.inflate(radius, clearance)
    return {f"{name}.json.gz": _gzip(dumps_navgrid(inflated))}


def _make_voxels(grid: NavGrid, config: BakeConfig, values: Sequence[str]) -> dict[str, bytes]:
    raise NotImplementedError


def _make_picture(grid: NavGrid, config: BakeConfig, values: Sequence[str]) -> dict[str, bytes]:
    from navbake.views.plot import render_png

    return {"picture.png": render_png(grid, layers=tuple(values) or ("rooms", "floor"))}


def _make_report(grid: NavGrid, config: BakeConfig, values: Sequence[str]) -> dict[str, bytes]:
    from navbake.auditor.audit import audit
    from navbake.views.report.report import render_report

    return {"report.html": render_report(grid, audits=[audit(grid)])}


def _gzip(data: bytes) -> bytes:
    """Packed without a date, so that the same data give the same bytes."""
    import gzip

    return gzip.compress(data, mtime=0)


# by name: what makes it, how many values it takes at least and at most, and how it is spelt
KINDS: dict[str, tuple[Maker, int, int, str]] = {
    "grid": (_make_grid, 0, 0, "grid"),
    "inflated": (_make_inflated, 1, 2, "inflated:RADIUS or inflated:RADIUS:CLEARANCE"),
    "voxels": (_make_voxels, 1, 2, "voxels:RES or voxels:RES:ENDING"),
    "picture": (_make_picture, 0, 8, "picture or picture:LAYER:…"),
    "report": (_make_report, 0, 0, "report"),
}
