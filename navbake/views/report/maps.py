"""What a report shows of a level: pictures of its layers, and what is known of each cell."""

from base64 import b64encode

import numpy as np
import orjson
from numpy.typing import NDArray
from PIL import Image

from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, islands_of
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import NAMES, Shared, UserData, names_in
from navbake.types import Float, Int, Json
from navbake.views.layers import LAYERS, make_panel, paint
from navbake.views.notebook import encode_png
from navbake.views.page.page import pack, to_text

KINDS = (*NAMES, "blockers")  # keys of a cell's user data that list names
MILLIMETRE = 1e-3  # to which floors and clearances are rounded [m]
MOST_STEPS = 2**31  # that a page counts of heights
MAX_SHOWN = 4_000_000  # cells of a level that a page holds; of larger ones only every n-th
NONE = -1  # stands for no value in what is packed
BAR = 64  # colours of the bar beside a layer


def describe_place(name: str, lattice: Lattice) -> Json:
    """Where a map lies in the world, and every which row and column of it a page shows."""
    every = 1
    while -(-lattice.height // every) * -(-lattice.width // every) > MAX_SHOWN:
        every += 1
    place = {"name": name, "width": lattice.width, "height": lattice.height, "every": every}
    return place | {"cellSize": lattice.cell_size, "xMin": lattice.x_min, "yMax": lattice.y_max}


def describe_map(grid: NavGrid, number: int) -> Json:
    """The map of one level: its place, its layers, and its cells.

    Of the cells, packed by `pack`: ``floor`` and ``clearance`` in steps of a millimetre from
    ``floorFrom`` and 0, floors that are far apart in larger ones, ``floorStep`` [m]; ``room``,
    ``island``; ``weight`` and ``names`` as numbers into the lists ``weights`` (None for infinite)
    and ``nameLists``, which is JSON, compressed: the names of what stands in a cell, and of what
    blocks it, by `KINDS`.
    """
    level = grid.levels[number]
    place = describe_place(grid.level_names[number], level.lattice)
    shown = np.s_[:: place["every"], :: place["every"]]
    floor, free = level.floor[shown], level.free[shown]
    finite = floor[np.isfinite(floor)]
    floor_from = float(finite.min()) if finite.size else 0.0
    floor_step = max(MILLIMETRE, float(np.ptp(finite)) / MOST_STEPS if finite.size else 0.0)
    away = clearance(level)[shown].astype(np.float64)
    weights, weight = np.unique(np.where(free, level.weights[shown], np.inf), return_inverse=True)
    names, name_lists = _number_names(level)
    cells = {
        "floor": pack(_to_steps(floor - floor_from, floor_step)),
        "floorFrom": floor_from,
        "floorStep": floor_step,
        "clearance": pack(_to_steps(np.where(free, away, 0), MILLIMETRE)),
        "room": pack(level.room_index[shown].astype(np.int64)),
        "island": pack(islands_of(grid)[number][shown].astype(np.int64)),
        "weight": pack(weight),
        "weights": [value if np.isfinite(value) else None for value in weights.tolist()],
        "names": pack(names[shown]),
        "nameLists": to_text(orjson.dumps(name_lists)),
    }
    layers = [_draw_layer(grid, number, layer, place["every"]) for layer in LAYERS]
    return {**place, "cells": cells, "layers": layers}


def _to_steps(metres: Float, step: float) -> Int:
    """Metres >= 0 as whole steps, `NONE` where they are not finite."""
    return np.nan_to_num(np.round(metres / step), nan=NONE, posinf=NONE).astype(np.int64)


def _number_names(level: SceneGrid2D) -> tuple[Int, list[Json]]:
    """Which entry of the list of names each cell has, -1 for none, shape (height, width)."""
    found: dict[bytes, int] = {}  # by an entry's JSON: most cells have the entry of others
    lists: list[Json] = []

    def number_of(entry: Json) -> int:
        key = orjson.dumps(entry, default=str)
        if key not in found:
            names = {kind: sorted(names_in(entry, kind)) for kind in KINDS}
            names = {kind: some for kind, some in names.items() if some}
            found[key] = len(lists) if names else NONE
            lists.extend([names] if names else [])
        return found[key]

    numbers = np.full(level.height * level.width, NONE, dtype=np.int64)
    source = UserData.of(level.user_data).source
    if isinstance(source, Shared):
        cells, number, entries = source
        numbers[cells] = np.array([number_of(entry) for entry in entries], np.int64)[number]
    else:
        for cell, entry in source.items():
            numbers[cell] = number_of(entry)
    return numbers.reshape(level.shape), lists


def to_url(rgb: NDArray[np.uint8]) -> str:
    """A picture, shape (rows, cols, 3), as the URL of a PNG that holds all of it."""
    return "data:image/png;base64," + b64encode(encode_png(Image.fromarray(rgb))).decode("ascii")


def _draw_layer(grid: NavGrid, number: int, layer: str, every: int) -> Json:
    panel, scale = make_panel(grid, layer, number), None
    if panel.scale is not None:
        scale = {
            "label": panel.scale.label,
            "colors": [f"#{bytes(color).hex()}" for color in panel.scale.bar(BAR)],
            "ticks": [tick._asdict() for tick in panel.scale.ticks],
        }
    return {
        "name": layer,
        "title": panel.title.removeprefix(f"{grid.level_names[number]}: "),
        "png": to_url(paint(panel)[::every, ::every]),
        "legend": panel.legend,
        "scale": scale,
        "labels": [label._asdict() for label in panel.labels],
        "doors": [door._asdict() for door in panel.doors],
    }
