"""Navigation grids in memory: what the baker makes, and all that the run time needs.

Arrays are ``[row, col]``, shape (height, width): col along file X, row along file Z. Arrays,
`cell_size`, `min_yup` and `bbox_yup` are as in the file: y up, in file units (which are metres
in every file that navbake writes). Methods that take or give positions use the world: z up,
metres; `SceneGrid2D.lattice` is the bridge.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.lattice import Lattice

Vector3: TypeAlias = tuple[float, float, float]
Json: TypeAlias = dict[str, Any]


class _Described:
    """What one level and several share: metadata that say what the grid is."""

    metadata: Json

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first."""
        raise NotImplementedError

    @property
    def scene_id(self) -> str | None:
        """The scene's name, if the file gives one."""
        name = self.metadata.get("sceneId")
        return name if isinstance(name, str) else None

    @property
    def navbake(self) -> Json:
        """What navbake wrote into the metadata: versions, digests, frame; {} in others' files."""
        own = self.metadata.get("navbake")
        return own if isinstance(own, dict) else {}

    @property
    def rooms(self) -> list[Json]:
        """The table of the rooms, by level and index; see `navbake.rooms_table.describe_rooms`."""
        from navbake.rooms_table import describe_rooms

        return describe_rooms(self)  # type: ignore[arg-type]

    @property
    def doors(self) -> list[Json]:
        """The doors: id, joint, rooms, state, and the cells that each blocks; [] if none."""
        doors = self.navbake.get("doors", [])
        return doors if isinstance(doors, list) else []

    @property
    def cell_attributes(self) -> list[Json]:
        """What the metadata says of each attribute, completed where it says nothing."""
        return describe_attributes(self.metadata, self.levels)


@dataclass(eq=False, kw_only=True)
class SceneGrid2D(_Described):
    """The navigation grid of one level.

    Attributes:
        width: number of columns, >= 1.
        height: number of rows, >= 1.
        cell_size: edge of a cell [file units], > 0.
        min_yup: lower corner of cell 0, file frame [file units]; Y is the level's ground.
        bbox_yup: lower and upper corner of what the level covers, file frame [file units], or
            None where the file says nothing.
        unit: metres per file unit, > 0.
        weights: shape (height, width), float32 or float64: the cost of a cell, inf where an
            agent can't stand.
        attributes: further values of each cell under the names they have in the file
            (``floorHeight``, ``roomIndex``, ``occupancy``, …), each of shape (height, width)
            and of its own dtype.
        user_data: what a file keeps for single cells, by cell id (col + row * width).
        metadata: as in the file.
        timings: as in the file; two grids that differ in it only are the same grid.
        extra: fields of the file that are not the format's own; they are written back.
    """

    width: int
    height: int
    cell_size: float
    min_yup: Vector3
    bbox_yup: tuple[Vector3, Vector3] | None = None
    unit: float = 1.0
    weights: NDArray[Any] = field(repr=False)
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    user_data: dict[int, Json] = field(default_factory=dict, repr=False)
    metadata: Json = field(default_factory=dict, repr=False)
    timings: Json = field(default_factory=dict, repr=False)
    extra: Json = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        for name, array in {"weights": self.weights, **self.attributes}.items():
            if array.shape != self.shape:
                raise FormatError(
                    f"{name} has shape {array.shape}, expected (height, width) = {self.shape}"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), the shape of every array."""
        return self.height, self.width

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first: this one."""
        return [self]

    @property
    def links(self) -> NDArray[np.int64]:
        """Steps from level to level, shape (0, 4): one level has none."""
        return np.zeros((0, 4), dtype=np.int64)

    @property
    def lattice(self) -> Lattice:
        """Where the cells lie in the world [m]."""
        return Lattice(
            x_min=self.min_yup[0] * self.unit,
            y_max=0.0 - self.min_yup[2] * self.unit,
            cell_size=self.cell_size * self.unit,
            width=self.width,
            height=self.height,
        )

    @property
    def ground(self) -> float:
        """World z of the level's ground [m]."""
        return self.min_yup[1] * self.unit

    @property
    def free(self) -> NDArray[np.bool_]:
        """Where an agent can stand: the weight is finite. Shape (height, width), bool."""
        return np.asarray(np.isfinite(self.weights))

    @property
    def floor_height(self) -> NDArray[np.float32]:
        """The floor's Y [file units], shape (height, width), float32, NaN for no floor.

        A file without ``floorHeight`` has its floor at the ground height, where weights are
        finite. What is not the attribute's own array is read-only.
        """
        stored = self.attributes.get("floorHeight")
        if stored is None:
            return _derived(np.where(self.free, np.float32(self.min_yup[1]), np.float32(np.nan)))
        return stored if stored.dtype == np.float32 else _derived(stored.astype(np.float32))

    @property
    def occupancy(self) -> NDArray[np.uint8]:
        """1 where something stands in the agent's way, shape (height, width), uint8.

        A file without ``occupancy`` is occupied where weights are infinite; one that keeps it
        in another dtype, where it is not 0. What is not the attribute's own array is read-only.
        """
        stored = self.attributes.get("occupancy")
        if stored is None:
            return _derived((~self.free).astype(np.uint8))
        return stored if stored.dtype == np.uint8 else _derived((stored != 0).astype(np.uint8))

    @property
    def room_index(self) -> NDArray[np.uint16]:
        """The room of each cell from 1, 0 for none, shape (height, width), uint16.

        A file without ``roomIndex`` has no rooms; in one that keeps it in another dtype, what
        uint16 can't hold is no room. What is not the attribute's own array is read-only.
        """
        stored = self.attributes.get("roomIndex")
        if stored is None:
            return _derived(np.zeros(self.shape, dtype=np.uint16))
        if stored.dtype == np.uint16:
            return stored
        return _derived(np.where((stored >= 0) & (stored < 65536), stored, 0).astype(np.uint16))

    def with_doors(self, states: Mapping[str, str] | str) -> SceneGrid2D:
        """The same grid with doors in other states, as a bake in these states would have it.

        Args:
            states: ``modelled``, ``open``, ``closed`` or ``removed``, by a door's id or for all.

        Raises:
            QueryError: there is no such door, or no such state.
        """
        from navbake.doors import with_doors

        return with_doors(self, states)

    def describe_cell(self, x: float, y: float, level: int = 0) -> Json:
        """What the grid knows of a place: floor, room, island, doors, and what occupies it.

        Args:
            x, y: world position [m].
            level: which level, 0 is the lowest.

        Returns:
            See `navbake.why.describe_cell`.

        Raises:
            QueryError: there is no such level, or the position is no number or beside the grid.
        """
        from navbake.why import describe_cell

        return describe_cell(self, x, y, level)

    def blockers(self, x: float, y: float, level: int = 0) -> list[str]:
        """The names of what blocks the cell at a place, sorted; [] where nothing does.

        Args:
            x, y: world position [m].
            level: which level, 0 is the lowest.

        Raises:
            QueryError: there is no such level, or the position is no number or beside the grid.
        """
        blockers: list[str] = self.describe_cell(x, y, level)["blockers"]
        return blockers

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a NavGrid file, gzipped if its name ends in ``.gz``."""
        from navbake.formats.navgrid import write_navgrid

        write_navgrid(self, path)


@dataclass(eq=False, kw_only=True)
class MultiLevelGrid(_Described):
    """The navigation grids of a scene with several levels.

    A level without metadata of its own takes over those of the whole.

    Attributes:
        grids: the levels, lowest first, at least one.
        cell_size: edge of a cell [file units], > 0.
        unit: metres per file unit, > 0.
        metadata: as in the file.
        timings: as in the file; two grids that differ in it only are the same grid.
        extra: fields of the file that are not the format's own; they are written back.
    """

    grids: list[SceneGrid2D]
    cell_size: float
    unit: float = 1.0
    metadata: Json = field(default_factory=dict, repr=False)
    timings: Json = field(default_factory=dict, repr=False)
    extra: Json = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if not self.grids:
            raise FormatError("a MultiLevelGrid has at least one level, got none")
        for grid in self.grids:
            if not grid.metadata:
                grid.metadata = self.metadata

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first."""
        return self.grids

    @property
    def links(self) -> NDArray[np.int64]:
        """Where a step leads from one level to another.

        Returns:
            Shape (n, 4), int64: level, cell id on it, other level, cell id on that.

        Raises:
            FormatError: the metadata names a level or a cell that there is not.
        """
        num_cells = [grid.width * grid.height for grid in self.grids]
        return _read_links(self.navbake.get("links"), num_cells)

    def with_doors(self, states: Mapping[str, str] | str) -> MultiLevelGrid:
        """The same grid with doors in other states, as a bake in these states would have it.

        Args:
            states: ``modelled``, ``open``, ``closed`` or ``removed``, by a door's id or for all.

        Raises:
            QueryError: there is no such door, or no such state.
        """
        from navbake.doors import with_doors

        return with_doors(self, states)

    def describe_cell(self, x: float, y: float, level: int = 0) -> Json:
        """What the grid knows of a place: floor, room, island, doors, and what occupies it.

        Args:
            x, y: world position [m].
            level: which level, 0 is the lowest.

        Returns:
            See `navbake.why.describe_cell`.

        Raises:
            QueryError: there is no such level, or the position is no number or beside the grid.
        """
        from navbake.why import describe_cell

        return describe_cell(self, x, y, level)

    def blockers(self, x: float, y: float, level: int = 0) -> list[str]:
        """The names of what blocks the cell at a place, sorted; [] where nothing does.

        Args:
            x, y: world position [m].
            level: which level, 0 is the lowest.

        Raises:
            QueryError: there is no such level, or the position is no number or beside the grid.
        """
        blockers: list[str] = self.describe_cell(x, y, level)["blockers"]
        return blockers

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a NavGrid file, gzipped if its name ends in ``.gz``."""
        from navbake.formats.navgrid import write_navgrid

        write_navgrid(self, path)


NavGrid: TypeAlias = SceneGrid2D | MultiLevelGrid


def datatype_name(stated: str) -> str:
    """Name the datatype of an array type: "uint8" for "Uint8Array" or "Uint8ClampedArray"."""
    name = stated.lower().removesuffix("array")
    return "uint8" if name == "uint8clamped" else name


def describe_attributes(metadata: Json, levels: Sequence[SceneGrid2D]) -> list[Json]:
    """List the attributes that levels have, as ``metadata.cellAttributes`` does.

    Args:
        metadata: an entry that it has for an attribute is kept, but for a ``type`` that is not
            that of the array.
        levels: whose attributes; where two differ in dtype, the first counts.

    Returns:
        ``{"name", "type", "dataType", …}`` of each, in the order of the levels' attributes.
    """
    entries = metadata.get("cellAttributes")
    stated = {
        entry["name"]: entry
        for entry in (entries if isinstance(entries, list) else [])
        if isinstance(entry, dict) and isinstance(entry.get("name"), str)
    }
    described: dict[str, Json] = {}
    for grid in levels:
        for name, array in grid.attributes.items():
            described.setdefault(name, _describe(name, array.dtype, stated.get(name, {})))
    return list(described.values())


def _describe(name: str, dtype: np.dtype[Any], stated: Json) -> Json:
    kind = stated.get("type")
    if not isinstance(kind, str) or datatype_name(kind) != dtype.name:
        kind = f"{dtype.name.capitalize()}Array"
    data_type = "continuous" if dtype.kind == "f" else "categorical"
    return {"name": name, "type": kind, "dataType": data_type} | stated | {"type": kind}


def _derived(array: NDArray[Any]) -> NDArray[Any]:
    """Lock an array that is no part of the grid, so that nobody writes to it in vain."""
    array.flags.writeable = False
    return array


def _read_links(stated: Any, num_cells: Sequence[int]) -> NDArray[np.int64]:
    """Check links: a flat list of whole numbers, four a link, or a list of lists of four."""
    where = "at `metadata.navbake.links`"
    numbers = [] if stated is None else stated
    if isinstance(numbers, list) and any(isinstance(link, list | tuple) for link in numbers):
        if any(not isinstance(link, list | tuple) or len(link) != 4 for link in numbers):
            raise FormatError(f"expected links of 4 numbers each {where}")
        numbers = [number for link in numbers for number in link]
    if not isinstance(numbers, list) or len(numbers) % 4 or not set(map(type, numbers)) <= {int}:
        raise FormatError(f"expected a list of whole numbers, 4 a link, {where}")
    links = np.array(numbers, dtype=np.float64).reshape(-1, 4)  # float64: nothing overflows
    for column, name in ((0, "level"), (2, "level"), (1, "cell"), (3, "cell")):
        limit = len(num_cells) if name == "level" else _pick(num_cells, links[:, column - 1])
        bad = (links[:, column] < 0) | (links[:, column] >= limit)
        if bad.any():
            number = int(np.argmax(bad))
            raise FormatError(
                f"expected a {name} that there is, got {links[number, column]:.0f} "
                f"in link {number} {where}"
            )
    return links.astype(np.int64)


def _pick(num_cells: Sequence[int], levels: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.array(num_cells, dtype=np.int64)[levels.astype(np.int64)]


def first_difference(a: NavGrid, b: NavGrid) -> str | None:
    """Compare two grids in everything but timings.

    NaN equals NaN. Weights count by value, because a file has no dtype for them; of
    ``cellAttributes``, the completed form counts (`describe_attributes`).

    Returns:
        None if they are the same grid, else one line that says where they are not: level,
        field, and for arrays how many cells differ, the first of them, and both its values.
    """
    if type(a) is not type(b):
        return f"types: {type(a).__name__} and {type(b).__name__}"
    if len(a.levels) != len(b.levels):
        return f"number of levels: {len(a.levels)} and {len(b.levels)}"
    for compare in (_cells_difference, _facts_difference):
        for number, (x, y) in enumerate(zip(a.levels, b.levels, strict=True)):
            found = compare(x, y)
            if found:
                return f"level {number}: {found}" if isinstance(a, MultiLevelGrid) else found
    return _facts_difference(a, b)


def _cells_difference(a: SceneGrid2D, b: SceneGrid2D) -> str | None:
    if a.shape != b.shape:
        return f"shape (height, width): {a.shape} and {b.shape}"
    pairs = [("weights", a.weights.astype(np.float64), b.weights.astype(np.float64))]
    for name in a.attributes | b.attributes:
        if name not in a.attributes or name not in b.attributes:
            return f"{name}: only in the {'first' if name in a.attributes else 'second'}"
        pairs.append((name, a.attributes[name], b.attributes[name]))
    for name, x, y in pairs:
        if x.dtype != y.dtype:
            return f"dtype of {name}: {x.dtype} and {y.dtype}"
        differs = _differing(x, y)
        if differs.any():
            row, col = divmod(int(np.argmax(differs)), a.width)
            return (
                f"{name}: {np.count_nonzero(differs)} of {differs.size} cells differ, "
                f"the first at row {row}, col {col}: {x[row, col]!s} and {y[row, col]!s}"
            )
    return _json_difference(a.user_data, b.user_data, "user_data")


def _facts_difference(a: NavGrid, b: NavGrid) -> str | None:
    """Compare what is neither of a cell nor of a level below."""
    for name in ("cell_size", "min_yup", "bbox_yup", "unit", "extra"):
        found = _json_difference(getattr(a, name, None), getattr(b, name, None), name)
        if found:
            return found
    x, y = (
        grid.metadata | {"cellAttributes": {entry["name"]: entry for entry in grid.cell_attributes}}
        for grid in (a, b)
    )
    return _json_difference(x, y, "metadata")


def _differing(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray((a != b) & ~((a != a) & (b != b)))  # only NaN is not itself


def _json_difference(a: Any, b: Any, path: str) -> str | None:
    if a == b:
        return None
    if isinstance(a, dict) and isinstance(b, dict):
        for key in a | b:
            inner = f"{path}[{key}]" if isinstance(key, int) else f"{path}.{key}"
            if key not in a or key not in b:
                return f"{inner}: only in the {'first' if key in a else 'second'}"
            found = _json_difference(a[key], b[key], inner)
            if found:
                return found
        return None
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        if len(a) != len(b):
            return f"length of {path}: {len(a)} and {len(b)}"
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            found = _json_difference(x, y, f"{path}[{i}]")
            if found:
                return found
        return None
    return f"{path}: {_shortened(a)} and {_shortened(b)}"


def _shortened(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "…"


def difference_map(a: SceneGrid2D, b: SceneGrid2D, max_size: int = 80) -> str:
    """Draw where two levels differ in weights, attributes or user data.

    Row 0 is at the top, as in the arrays (the world's y points up, its x to the right). A grid
    of more than `max_size` rows or columns is drawn in squares of k × k cells, each as the
    first of x, #, ., space that one of its cells is.

    Args:
        a: a level.
        b: another. An attribute that only one of them has is not compared.
        max_size: rows and columns that the picture may have, >= 1.

    Returns:
        A line a row and a legend; one sentence if the shapes differ.
    """
    if a.shape != b.shape:
        return (
            f"no picture: the first grid has {a.width} × {a.height} cells (width × height), "
            f"the second {b.width} × {b.height}"
        )
    differs = _differing(a.weights, b.weights)
    for name in a.attributes.keys() & b.attributes.keys():
        differs = differs | _differing(a.attributes[name], b.attributes[name])
    for cell_id in a.user_data.keys() | b.user_data.keys():
        if a.user_data.get(cell_id) != b.user_data.get(cell_id):
            differs[divmod(cell_id, a.width)] = True
    rank = np.where(np.isnan(a.floor_height), 0, 2)
    rank = np.where(a.free, 1, rank)
    rank = np.where(differs, 3, rank)
    k = math.ceil(max(a.shape) / max_size)
    starts = [np.arange(0, size, k) for size in a.shape]
    rank = np.maximum.reduceat(np.maximum.reduceat(rank, starts[0], axis=0), starts[1], axis=1)
    rows = ["".join(row) for row in np.array(list(" .#x"))[rank]]
    scale = f", a character is {k} × {k} cells" if k > 1 else ""
    count = np.count_nonzero(differs)
    legend = f". free, # blocked, space no floor, x differs ({count} of {differs.size} cells)"
    return "\n".join([*rows, legend + scale])
