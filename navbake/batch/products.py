"""The products of a batch besides grids."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import msgspec
import numpy as np

from navbake.auditor.audit import audit
from navbake.config.settings import BakeConfig
from navbake.episodes.episode import CLASS_EDGES, EpisodeSet, Header
from navbake.episodes.files import write_episodes
from navbake.episodes.formats import decode
from navbake.episodes.sampler import make_episodes, make_rules, make_task
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, QueryError
from navbake.formats.convert import OCTREE_SUFFIXES, VOXEL_SUFFIXES
from navbake.formats.navgrid import write_navgrid
from navbake.formats.voxels import write_voxels
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.layers import LAYERS

# loaded by the products that need them
voxelizer = lazy("navbake.baker.voxels.voxelize")
plot = lazy("navbake.views.plot")
report = lazy("navbake.views.report")

GRID_NAME = "grid.json.gz"  # of every scene, written last
PICTURE_NAME = "picture.png"
REPORT_NAME = "report.html"
THUMBNAIL_NAME = "thumbnail.png"  # no product, as it can be made of the grid later
# Of a scene's folder: its files and key, see `job.py`; of all: shards
RECORD_NAME = ".navbake-made"
PICTURE_LAYERS = ("rooms", "floor")
# all names that a product has ever had
PRODUCT_FILE_PATTERN = re.compile(
    r"grid\.json\.gz|inflated-[\d.e+-]+\.json\.gz|nav2[\d._e+-]*\.(?:yaml|pgm)"
    r"|voxels-[\d.e+-]+\.\w+|picture\.png|report\.html|thumbnail\.png|episodes-[\w-]+\.jsonl"
)
MEASURE_CLASSES = {measure: CLASS_EDGES[measure] for measure in ("distance", "ratio", "levels")}
"""Measures of episodes that a scene's row counts, and the lower edges of their classes."""


PRODUCT_KINDS = {
    "inflated": (1, 2, "inflated:RADIUS[:CLEARANCE]"),
    "nav2": (0, 1, "nav2[:RADIUS]"),
    "voxels": (1, 2, "voxels:EDGE[:ENDING]"),
    "picture": (0, len(LAYERS), "picture[:LAYER…]"),
    "episodes": (1, 4, "episodes:TASK[:SAMPLER[:COUNT[:SEED]]]"),
    "report": (0, 0, "report"),
}
"""Kinds of products: the smallest and the largest number of their values, and how they look."""


def parse_products(texts: Sequence[str]) -> tuple[str, ...]:
    """Parse products written as ``KIND`` or ``KIND:VALUE:…``, and return them normalized.

    They are unique and sorted, and numbers have their shortest form, so that equal products give
    equal keys in any order. Raises a ConfigError for an unknown kind or wrong values, and a
    MissingDependencyError if an extra isn't installed.
    """
    unknown = (0, -1, f"one of {', '.join(usage for *_, usage in PRODUCT_KINDS.values())}")
    products = set()
    for text in texts:
        name, *values = text.split(":")
        least, most, usage = PRODUCT_KINDS.get(name, unknown)
        if not least <= len(values) <= most:
            raise ConfigError(f"expected {usage} to make, got {text!r}")
        products.add(":".join((name, *_check_values(name, values, text))))
    pictures = sorted(product for product in products if product.startswith("picture"))
    if len(pictures) > 1:
        layer_names = ", ".join(pictures)
        raise ConfigError(f"expected one picture, with all its layers, to make, got {layer_names}")
    return tuple(sorted(products))


def _check_values(kind: str, values: list[str], text: str) -> list[str]:
    """Check the values of a product; returns them in their shortest form, with their defaults."""
    if kind == "picture":
        if not set(values) <= LAYERS.keys():
            raise ConfigError(f"expected layers of {', '.join(LAYERS)}, got {text!r} to make")
        if find_spec("matplotlib") is None:
            raise MissingDependencyError('pictures need matplotlib: pip install "navbake[plot]"')
        return values
    if kind == "episodes":
        task, sampler, *numbers = [*values, *("point", "uniform", "100", "0")[len(values) :]]
        make_task(task), make_rules(sampler)
        if not all(number.isdecimal() for number in numbers) or int(numbers[0]) < 1:
            raise ConfigError(f"expected a count >= 1 and a seed >= 0, got {text!r} to make")
        return [task, sampler, *(str(int(number)) for number in numbers)]
    ending = (values[1:] or ["binvox"]) if kind == "voxels" else []
    try:
        metres = [float(value) for value in (values[:1] if ending else values)]
    except ValueError:
        metres = [math.nan]
    if not all(math.isfinite(number) and number >= 0 for number in metres):
        raise ConfigError(f"expected numbers >= 0 [m] after the colons, got {text!r} to make")
    if ending and metres[0] == 0:
        raise ConfigError(f"expected an edge of voxels > 0 [m], got {text!r} to make")
    if ending and f".{ending[0]}" not in VOXEL_SUFFIXES:
        suffixes = ", ".join(suffix[1:] for suffix in VOXEL_SUFFIXES)
        raise ConfigError(f"expected an ending of {suffixes}, got {text!r} to make")
    return [*(f"{number:.12g}" for number in metres), *ending]


def make_product(product: str, grid: NavGrid, config: BakeConfig, folder: Path) -> Json:
    """Write the files of a product, each whole or not at all; return fields for the scene's row."""
    kind, *values = product.split(":")
    if kind == "inflated":
        clearance = float(values[1]) if len(values) > 1 else None
        inflated = grid.inflate(float(values[0]), clearance)
        write_navgrid(inflated, folder / f"inflated-{'-'.join(values)}.json.gz")
    elif kind == "nav2":
        radius = float(values[0]) if values else None
        grid.to_nav2(folder / f"{'-'.join(('nav2', *values))}.yaml", radius=radius)
    elif kind == "voxels":
        edge, ending = values
        made = voxelizer.Voxelizer(config).create(
            res=float(edge), align=f".{ending}" in OCTREE_SUFFIXES
        )
        write_voxels(made, folder / f"voxels-{edge}.{ending}")
    elif kind == "picture":
        plot.plot_grid(grid, folder / PICTURE_NAME, layers=tuple(values) or PICTURE_LAYERS)
    elif kind == "report":
        report.write_report(grid, folder / REPORT_NAME, audits=[audit(grid)])
    else:
        return _make_episodes(grid, values, folder)
    return {}


def _make_episodes(grid: NavGrid, values: Sequence[str], folder: Path) -> Json:
    task, sampler, count, seed = values
    try:
        drawn = make_episodes(
            grid, task, sampler, count=int(count), seed=int(seed), files=[GRID_NAME]
        )
    except QueryError as error:  # no such object, or no valid episode
        return {"warnings": [f"no episodes of {task}: {error}"]}
    # all scenes' are merged into one set
    episodes = tuple(
        msgspec.structs.replace(episode, id=f"{episode.scene}/{episode.id}")
        for episode in drawn.episodes
    )
    file = folder / f"episodes-{'-'.join(values)}.jsonl"
    write_episodes(EpisodeSet(drawn.header, episodes), file)
    measured = [episode.measures for episode in episodes]
    counts = {}
    for measure, edges in MEASURE_CLASSES.items():
        numbers = [value for measures in measured if (value := measures[measure]) is not None]
        counts[measure] = np.histogram(numbers, [*edges, np.inf])[0].tolist()
    return {"episodes": counts}


def merge_sets(sets: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """Merge several scenes' sets of episodes in order; return the pieces of the merged file.

    `sets` has a scene's id and file for each set. Raises a NavbakeError if the agents differ, or
    two scenes have one id.
    """
    headers = list[Header]()
    pieces = list[bytes]()
    for id, content in sets:
        head, _, episodes = content.partition(b"\n")
        header = decode(head, Header, f"the episodes of {id}")
        grids = [msgspec.structs.replace(grid, file=f"{id}/{GRID_NAME}") for grid in header.grids]
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
