"""The products of a batch besides grids."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from navbake.auditor.audit import audit
from navbake.config.settings import BakeConfig
from navbake.episodes.episode import EpisodeSet, Header
from navbake.episodes.files import write_episodes
from navbake.episodes.formats import decode
from navbake.episodes.sampler import EDGES, make_episodes, make_rules, make_task
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, QueryError
from navbake.formats.convert import OCTREES, VOXELS
from navbake.formats.navgrid import write_navgrid
from navbake.formats.source import write_bytes
from navbake.formats.voxels import write_voxels
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.layers import LAYERS

# loaded by the products that need them
voxelizer = lazy("navbake.baker.voxelize")
notebook = lazy("navbake.views.notebook")
plot = lazy("navbake.views.plot")
report = lazy("navbake.views.report.report")

GRID = "grid.json.gz"  # of every scene, written last
PICTURE, REPORT = "picture.png", "report.html"
THUMBNAIL = "thumbnail.png"  # no product, as it can be made of the grid later
RECORD = ".navbake-made"  # of a scene's folder: its files and key, see `job.py`; of all: shards
PICTURE_LAYERS = ("rooms", "floor")
# all names that a product has ever had
OWN = re.compile(
    r"grid\.json\.gz|inflated-[\d.e+-]+\.json\.gz|nav2[\d._e+-]*\.(?:yaml|pgm)"
    r"|voxels-[\d.e+-]+\.\w+|picture\.png|report\.html|thumbnail\.png|episodes-[\w-]+\.jsonl"
)
CLASSES = {measure: EDGES[measure] for measure in ("distance", "ratio", "levels")}
"""Measures of episodes that a scene's row counts, and the lower edges of their classes."""


def parse_products(texts: Sequence[str]) -> tuple[str, ...]:
    """Check ``KIND`` or ``KIND:VALUE:…``; unique, sorted, numbers in their shortest form.

    So equal products have equal keys in any order. Raises a ConfigError for an unknown kind or
    wrong values, and a MissingDependencyError without an extra.
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


def make_product(product: str, grid: NavGrid, config: BakeConfig, folder: Path) -> Json:
    """Write the files of a product, each whole or not at all; returns its values for the row."""
    name, *values = product.split(":")
    return KINDS[name].make(grid, config, values, folder) or {}


def write_thumbnail(grid: NavGrid, folder: Path) -> None:
    """Write a small picture of a grid for the batch's page."""
    write_bytes(notebook.draw_thumbnail(grid), folder / THUMBNAIL)


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
    radius = float(values[0]) if values else None
    grid.to_nav2(folder / f"{'-'.join(('nav2', *values))}.yaml", radius=radius)


def _make_voxels(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    edge, ending = values
    voxels = voxelizer.Voxelizer(config).create(res=float(edge), align=f".{ending}" in OCTREES)
    write_voxels(voxels, folder / f"voxels-{'.'.join(values)}")


def _check_episodes(values: Sequence[str], text: str) -> tuple[str, ...]:
    task, sampler, *numbers = [*values, *("point", "uniform", "100", "0")[len(values) :]]
    make_task(task), make_rules(sampler)
    if not all(number.isdecimal() for number in numbers) or int(numbers[0]) < 1:
        raise ConfigError(f"expected a count >= 1 and a seed >= 0, got {text!r} to make")
    return (task, sampler, *(str(int(number)) for number in numbers))


def _make_episodes(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> Json:
    task, sampler, count, seed = values
    try:
        drawn = make_episodes(grid, task, sampler, count=int(count), seed=int(seed), files=[GRID])
    except QueryError as error:  # no such object, or no valid episode
        return {"warnings": [f"no episodes of {task}: {error}"]}
    # all scenes' are merged into one set
    episodes = tuple(
        msgspec.structs.replace(episode, id=f"{episode.scene}/{episode.id}")
        for episode in drawn.episodes
    )
    file = folder / f"episodes-{'-'.join(values)}.jsonl"
    write_episodes(EpisodeSet(drawn.header, episodes), file)
    measured: dict[str, list[float | None]] = {
        "distance": [episode.distance for episode in episodes],
        "ratio": [episode.ratio for episode in episodes],
        "levels": [abs(episode.levels[0] - episode.levels[-1]) for episode in episodes],
    }
    counts = {}
    for measure, edges in CLASSES.items():
        known = [value for value in measured[measure] if value is not None]
        counts[measure] = np.histogram(known, [*edges, np.inf])[0].tolist()
    return {"episodes": counts}


def merge_sets(sets: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """Merge several scenes' sets of episodes in order; returns pieces of a file.

    `sets` are the scenes' ids and files. Raises a NavbakeError if the agents differ, or two scenes
    have one id.
    """
    headers, pieces = list[Header](), list[bytes]()
    for id, content in sets:
        head, _, episodes = content.partition(b"\n")
        header = decode(head, Header, f"the episodes of {id}")
        grids = [msgspec.structs.replace(grid, file=f"{id}/{GRID}") for grid in header.grids]
        headers.append(msgspec.structs.replace(header, grids=tuple(grids)))
        pieces.append(episodes)
    grids = [grid for header in headers for grid in header.grids]
    again = [scene for scene, count in Counter(grid.scene for grid in grids).items() if count > 1]
    by_agent = {header.agent: id for header, (id, _) in zip(headers, sets, strict=True)}
    why = f"two scenes are called {again[0]!r}:" if again else ""
    if len(by_agent) > 1:
        sizes = [f"{a.radius:g} x {a.height:g} m in {id!r}" for a, id in by_agent.items() if a]
        remedy = "`--set agent.radius=… --set agent.height=…` gives all scenes one, or"
        why = why or f"agents differ in size ({' and '.join(sizes[:2])}): {remedy}"
    if why:
        raise NavbakeError(f"the scenes' episodes are no set, as {why} use those of each scene")
    rejected = sum((Counter(header.rejected) for header in headers), Counter[str]())
    merged = msgspec.structs.replace(
        headers[0],
        grids=tuple(grids),
        sampler=headers[0].sampler | {"count": sum(h.sampler["count"] for h in headers)},
        rejected=dict(sorted(rejected.items())),
    )
    return [msgspec.json.encode(merged), b"\n", *pieces]


def _make_picture(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    plot.plot_grid(grid, folder / PICTURE, layers=tuple(values) or PICTURE_LAYERS)


def _make_report(grid: NavGrid, config: BakeConfig, values: Sequence[str], folder: Path) -> None:
    report.write_report(grid, folder / REPORT, audits=[audit(grid)])


class Kind(NamedTuple):
    """A kind of product."""

    #: Writes it; returns its values for the scene's row.
    make: Callable[[NavGrid, BakeConfig, Sequence[str], Path], Json | None]
    #: Checks the values and returns their shortest form.
    check: Callable[[Sequence[str], str], tuple[str, ...]]
    least: int  #: Smallest number of values.
    most: int  #: Largest number of values.
    usage: str  #: Its form, for messages.


KINDS: dict[str, Kind] = {
    "inflated": Kind(_make_inflated, _numbers, 1, 2, "inflated:RADIUS[:CLEARANCE]"),
    "nav2": Kind(_make_nav2, _numbers, 0, 1, "nav2[:RADIUS]"),
    "voxels": Kind(_make_voxels, _check_voxels, 1, 2, "voxels:EDGE[:ENDING]"),
    "picture": Kind(_make_picture, _check_picture, 0, len(LAYERS), "picture[:LAYER…]"),
    "episodes": Kind(
        _make_episodes, _check_episodes, 1, 4, "episodes:TASK[:SAMPLER[:COUNT[:SEED]]]"
    ),
    "report": Kind(_make_report, lambda *_: (), 0, 0, "report"),
}
