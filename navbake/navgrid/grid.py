"""Navigation grids in memory: what the baker makes, and all that the run time needs.

Arrays are ``[row, col]``, shape (height, width): col along file X, row along file Z. Arrays,
`cell_size`, `min_yup` and `bbox_yup` are as in the file: y up, in file units (which are metres
in every file that navbake writes). Methods that take or give positions use the world: z up,
metres; `SceneGrid2D.lattice` is the bridge.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.grid_base import GridBase, Json
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import read_links
from navbake.navgrid.user_data import UserDataField

Vector3: TypeAlias = tuple[float, float, float]


@dataclass(eq=False, kw_only=True)
class SceneGrid2D(GridBase):
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
        user_data: what a file keeps for single cells, by cell id (col + row * width); in a large
            file it is read and checked when it is first asked for.
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


# after the fact: a descriptor in the class's body would be the field's default
setattr(SceneGrid2D, "user_data", UserDataField())  # noqa: B010


@dataclass(eq=False, kw_only=True)
class MultiLevelGrid(GridBase):
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
        return read_links(self.navbake.get("links"), num_cells)


def _derived(array: NDArray[Any]) -> NDArray[Any]:
    """Lock an array that is no part of the grid, so that nobody writes to it in vain."""
    array.flags.writeable = False
    return array


NavGrid: TypeAlias = SceneGrid2D | MultiLevelGrid
