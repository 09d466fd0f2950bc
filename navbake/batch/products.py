"""The products that a batch makes of each scene besides its grid."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

import msgspec
import numpy as np

from navbake.config.settings import BakeConfig
from navbake.episodes.episode import CLASS_EDGES, EpisodeSet, Header
from navbake.episodes.files import write_episodes
from navbake.episodes.formats import decode
from navbake.episodes.sampler import make_episodes, make_rules, make_task
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, QueryError
from navbake.formats.format_table import OCTREE_SUFFIXES, VOXEL_SUFFIXES
from navbake.formats.navgrid import write_navgrid
from navbake.formats.source import write_bytes
from navbake.formats.voxels import write_voxels
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.runtime.path_finder import PathFinder
from navbake.types import Json
from navbake.views.layers import LAYERS

# loaded by the products that need them
audit = lazy("navbake.auditor.audit")
voxelize = lazy("navbake.baker.voxels.voxelize")
plot = lazy("navbake.views.plot")
report = lazy("navbake.views.report")

GRID_NAME = "grid.json.gz"  # of every scene, written last
PICTURE_NAME = "picture.png"
REPORT_NAME = "report.html"
THUMBNAIL_NAME = "thumbnail.png"  # no product, as it can be made of the grid later
# In a scene's folder: its files and key, see `job.read_record`. In the output folder: the shards.
RECORD_NAME = ".navbake-made"
PICTURE_LAYERS = ("rooms", "floor")
STAND_REACH = [0.3, 0.8]  # least and greatest distance to an object [m]
# all names that a product has ever had
PRODUCT_FILE_PATTERN = re.compile(
    r"grid\.json\.gz|inflated-[\d.e+-]+\.json\.gz|nav2[\d._e+-]*\.(?:yaml|pgm)"
    r"|voxels-[\d.e+-]+\.\w+|picture\.png|report\.html|thumbnail\.png|episodes-[\w-]+\.jsonl"
    r"|stand-[\d.e+-]+\.json"
)
MEASURE_CLASSES = {measure: CLASS_EDGES[measure] for measure in ("distance", "ratio", "levels")}
"""Measure of episodes -> the lower edges of its classes; a scene's row counts each class."""


PRODUCT_KINDS = {
    "inflated": (1, 2, "inflated:RADIUS[:CLEARANCE]"),
    "nav2": (0, 1, "nav2[:RADIUS]"),
    "voxels": (1, 2, "voxels:EDGE[:ENDING]"),
    "picture": (0, len(LAYERS), "picture[:LAYER…]"),
    "episodes": (1, 4, "episodes:TASK[:SAMPLER[:COUNT[:SEED]]]"),
    "stand": (1, 3, "stand:RADIUS[:LEAST[:GREATEST]]"),
    "report": (0, 0, "report"),
}
"""For each kind of product: the smallest and the largest number of values, and its form."""


def parse_products(texts: Sequence[str]) -> tuple[str, ...]:
    """Parse products, and return them normalized, each once and sorted.

    In normalized products, numbers have their shortest form, and values that were left out have
    their defaults. Thus equal products give equal keys of scenes, whatever their order.

    Args:
        texts: the products as a user wrote them: ``KIND`` or ``KIND:VALUE:…``.

    Raises:
        ConfigError: a kind is unknown, or its values are wrong.
        MissingDependencyError: an extra that a product needs isn't installed.
    """
    unknown_kind_rule = (
        0,
        -1,
        f"one of {', '.join(product_form for *_, product_form in PRODUCT_KINDS.values())}",
    )
    products = set()
    for text in texts:
        kind, *values = text.split(":")
        min_values, max_values, product_form = PRODUCT_KINDS.get(kind, unknown_kind_rule)
        if not min_values <= len(values) <= max_values:
            raise ConfigError(f"expected {product_form} to make, got {text!r}")
        products.add(":".join((kind, *_check_values(kind, values, text))))
    picture_products = sorted(product for product in products if product.startswith("picture"))
    if len(picture_products) > 1:
        picture_texts = ", ".join(picture_products)
        raise ConfigError(
            f"expected one picture, with all its layers, to make, got {picture_texts}"
        )
    return tuple(sorted(products))


def _check_values(kind: str, values: list[str], text: str) -> list[str]:
    """Check what follows the kind of a product after colons, and return it normalized.

    Args:
        kind: the kind of product, such as ``picture``.
        values: the texts between the colons, such as names of layers.
        text: the whole product as the user wrote it, for errors.
    """
    if kind == "picture":
        if not set(values) <= LAYERS.keys():
            raise ConfigError(f"expected layers of {', '.join(LAYERS)}, got {text!r} to make")
        if find_spec("matplotlib") is None:
            raise MissingDependencyError('pictures need matplotlib: pip install "navbake[plot]"')
        return values
    if kind == "episodes":
        task, sampler, *count_and_seed = [*values, *("point", "uniform", "100", "0")[len(values) :]]
        make_task(task), make_rules(sampler)
        if not all(number.isdecimal() for number in count_and_seed) or int(count_and_seed[0]) < 1:
            raise ConfigError(f"expected a count >= 1 and a seed >= 0, got {text!r} to make")
        return [task, sampler, *(str(int(number)) for number in count_and_seed)]
    voxel_ending = (values[1:] or ["binvox"]) if kind == "voxels" else []
    try:
        lengths = [float(value) for value in (values[:1] if voxel_ending else values)]
    except ValueError:
        lengths = [math.nan]
    if not all(math.isfinite(length) and length >= 0 for length in lengths):
        raise ConfigError(f"expected numbers >= 0 [m] after the colons, got {text!r} to make")
    if kind == "stand":
        lengths += STAND_REACH[len(lengths) - 1 :]
        if lengths[1] > lengths[2]:
            raise ConfigError(f"expected a reach LEAST <= GREATEST [m], got {text!r} to make")
    if voxel_ending and lengths[0] == 0:
        raise ConfigError(f"expected an edge of voxels > 0 [m], got {text!r} to make")
    if voxel_ending and f".{voxel_ending[0]}" not in VOXEL_SUFFIXES:
        suffixes = ", ".join(suffix[1:] for suffix in VOXEL_SUFFIXES)
        raise ConfigError(f"expected an ending of {suffixes}, got {text!r} to make")
    return [*(f"{length:.12g}" for length in lengths), *voxel_ending]


def make_product(product: str, grid: NavGrid, config: BakeConfig, folder: Path) -> Json:
    """Write the files of a product, each whole or not at all.

    Args:
        product: the product, as `parse_products` returns it.
        grid: the scene's grid.
        config: the scene's settings.
        folder: the folder to write into.

    Returns:
        Fields for the scene's row: `warnings` or `episodes`, see `SceneRow`; mostly {}.
    """
    kind, *values = product.split(":")
    if kind == "inflated":
        clearance = float(values[1]) if len(values) > 1 else None
        inflated_grid = grid.inflate(float(values[0]), clearance)
        write_navgrid(inflated_grid, folder / f"inflated-{'-'.join(values)}.json.gz")
    elif kind == "nav2":
        radius = float(values[0]) if values else None
        grid.to_nav2(folder / f"{'-'.join(('nav2', *values))}.yaml", radius=radius)
    elif kind == "voxels":
        voxel_edge, ending = values
        voxel_grid = voxelize.Voxelizer(config).create(
            res=float(voxel_edge), align=f".{ending}" in OCTREE_SUFFIXES
        )
        write_voxels(voxel_grid, folder / f"voxels-{voxel_edge}.{ending}")
    elif kind == "picture":
        plot.plot_grid(grid, folder / PICTURE_NAME, layers=tuple(values) or PICTURE_LAYERS)
    elif kind == "stand":
        radius, *reach = map(float, values)
        _write_stands(grid, radius, (reach[0], reach[1]), folder / f"stand-{'-'.join(values)}.json")
    elif kind == "report":
        report.write_report(grid, folder / REPORT_NAME, audits=[audit.audit(grid)])
    else:
        return _make_episodes(grid, values, folder)
    return {}


def _write_stands(grid: NavGrid, radius: float, reach: tuple[float, float], path: Path) -> None:
    """Write where a robot's base can stand to reach the objects of a scene.

    Args:
        grid: the scene's grid.
        radius: the base's radius [m].
        reach: least and greatest distance from the base's axis to an object [m].
        path: the JSON file, of the form that `navbake stand` writes.
    """
    finder = PathFinder(grid.inflate(radius))
    facts: Json = {"scene_id": grid.scene_id, "poses": [], "why_not": {}}
    targets = [f"object:{name}" for name in finder.search.names.list_objects()]
    if targets:
        poses = finder.stand_poses(targets, reach=reach)
        facts |= {"poses": poses.to_records(), "why_not": poses.why_not}
    write_bytes(msgspec.json.format(msgspec.json.encode(facts)), path)


def _make_episodes(grid: NavGrid, values: Sequence[str], folder: Path) -> Json:
    """Draw and write a set of episodes; return fields for the scene's row, see `make_product`.

    Args:
        grid: the scene's grid.
        values: the task, the sampler, the number of episodes and the seed.
        folder: the folder to write into.
    """
    task, sampler, episode_count, seed = values
    try:
        episode_set = make_episodes(
            grid, task, sampler, count=int(episode_count), seed=int(seed), files=[GRID_NAME]
        )
    except QueryError as error:  # no such object, or no valid episode
        return {"warnings": [f"no episodes of {task}: {error}"]}
    # ids must be unique in the set into which the sets of all scenes are merged
    episodes = tuple(
        msgspec.structs.replace(episode, id=f"{episode.scene}/{episode.id}")
        for episode in episode_set.episodes
    )
    path = folder / f"episodes-{'-'.join(values)}.jsonl"
    write_episodes(EpisodeSet(episode_set.header, episodes), path)
    class_counts = {}
    for measure, class_edges in MEASURE_CLASSES.items():
        episode_values = [episode.measures[measure] for episode in episodes]
        measured_values = [value for value in episode_values if value is not None]
        class_counts[measure] = np.histogram(measured_values, [*class_edges, np.inf])[0].tolist()
    return {"episodes": class_counts}


def describe_sizes(id_of_size: Mapping[tuple[float, float], str]) -> str:
    """Say that agents differ in size, so that their episodes make no common set.

    Args:
        id_of_size: radius and height of an agent [m] -> the id of a scene with it; two at least.
    """
    size_texts = [
        f"{radius:g} x {height:g} m in {id!r}" for (radius, height), id in id_of_size.items()
    ]
    remedy = "`--set agent.radius=… --set agent.height=…` gives all scenes one, or"
    return f"agents differ in size ({' and '.join(size_texts[:2])}): {remedy}"


def merge_episode_sets(encoded_sets: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """Merge the sets of episodes of several scenes into one set, in order.

    Args:
        encoded_sets: for each set, the id of its scene and the content of its file.

    Returns:
        The content of the merged file, in pieces.

    Raises:
        NavbakeError: the sets are for agents of different sizes, or two scenes have the same id.
    """
    headers = list[Header]()
    encoded_episodes = list[bytes]()
    for id, content in encoded_sets:
        encoded_header, _, episodes = content.partition(b"\n")
        header = decode(encoded_header, Header, f"the episodes of {id}")
        grids = [msgspec.structs.replace(grid, file=f"{id}/{GRID_NAME}") for grid in header.grids]
        headers.append(msgspec.structs.replace(header, grids=tuple(grids)))
        encoded_episodes.append(episodes)
    grids = [grid for header in headers for grid in header.grids]
    count_of_scene = Counter(grid.scene for grid in grids)
    repeated_scenes = [scene for scene, count in count_of_scene.items() if count > 1]
    id_of_agent = {header.agent: id for header, (id, _) in zip(headers, encoded_sets, strict=True)}
    reason = f"two scenes are called {repeated_scenes[0]!r}:" if repeated_scenes else ""
    if len(id_of_agent) > 1:
        id_of_size = {
            (agent.radius, agent.height): id for agent, id in id_of_agent.items() if agent
        }
        reason = reason or describe_sizes(id_of_size)
    if reason:
        raise NavbakeError(
            f"no common set of episodes was written, as {reason} use those of each scene"
        )
    rejected_counts = sum((Counter(header.rejected) for header in headers), Counter[str]())
    merged_header = msgspec.structs.replace(
        headers[0],
        grids=tuple(grids),
        sampler=headers[0].sampler | {"count": sum(header.sampler["count"] for header in headers)},
        rejected=dict(sorted(rejected_counts.items())),
    )
    return [msgspec.json.encode(merged_header), b"\n", *encoded_episodes]
