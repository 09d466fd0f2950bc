"""Navigation grids in memory: what the baker makes, and all that the run time needs.

Arrays are ``[row, col]``, shape (height, width): col along file X, row along file Z. Arrays,
`cell_size`, `min_yup` and `bbox_yup` are as in the file: y up, in file units (which are metres
in every file that navbake writes). Methods that take or give positions use the world: z up,
metres; `SceneGrid2D.lattice` is the bridge.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.block_state import BLOCKED, CHANGING, BlockState
from navbake.navgrid.grid_base import GridBase
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.metadata import cut_metadata
from navbake.navgrid.user_data import UserData
from navbake.types import Bool, Float, Int, Json, Vector3

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(eq=False, kw_only=True)
class SceneGrid2D(GridBase):
    """The navigation grid of one level.

    Attributes:
        width: number of columns, >= 1.
        height: number of rows, >= 1.
        min_yup: lower corner of cell 0, file frame [file units]; Y is the level's ground.
        bbox_yup: lower and upper corner of what the level covers, file frame [file units], or
            None where the file says nothing.
        weights: shape (height, width), float32 or float64: the cost of a cell, inf where an
            agent can't stand.
        attributes: further values of each cell under the names they have in the file
            (``floorHeight``, ``roomIndex``, ``occupancy``, …), each of shape (height, width)
            and of its own dtype.
        user_data: what a file keeps for single cells, by cell id (col + row * width); in a large
            file it is read and checked when it is first asked for.
        block_state: who blocks its cells, None until somebody does.
        cell_size, unit, metadata, timings, extra: see `GridBase`.
    """

    width: int
    height: int
    min_yup: Vector3
    bbox_yup: tuple[Vector3, Vector3] | None = None
    weights: NDArray[Any] = field(repr=False)
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    user_data: MutableMapping[int, Json] = field(default_factory=UserData, repr=False)
    block_state: BlockState | None = field(default=None, init=False, repr=False)

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
        return [self]

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        (level,) = levels
        derived: Any = level if metadata is None else level.with_layers(metadata=metadata)
        own: Self = derived
        return own

    def with_layers(
        self,
        *,
        weights: NDArray[Any] | None = None,
        attributes: Mapping[str, NDArray[Any]] | None = None,
        user_data: MutableMapping[int, Json] | None = None,
        metadata: Json | None = None,
    ) -> Self:
        """The same level with other layers; what isn't given is as it is now.

        `attributes` are added or replaced one by one. The new level shares arrays with this one,
        except those that `block` changes in place once it was called here.
        """
        kept = dict(self.attributes)
        if self.block_state is not None:
            kept |= {name: kept[name].copy() for name in CHANGING & kept.keys()}
            weights = self.weights.copy() if weights is None else weights
        return replace(
            self,
            weights=self.weights if weights is None else weights,
            attributes={**kept, **(attributes or {})},
            user_data=self.user_data if user_data is None else user_data,
            metadata=self.metadata if metadata is None else metadata,
        )

    @property
    def uses_cell_floors(self) -> bool:
        """Whether cells have floors of their own: there are some, and the metadata don't deny it.

        ``useCellFloorHeight: false`` says that an agent stays at the ground height.
        """
        stated = self.metadata.get("useCellFloorHeight")
        return "floorHeight" in self.attributes and stated is not False

    @property
    def lattice(self) -> Lattice:
        """Where the cells lie in the world [m]."""
        # 0.0 - z, because -z would turn 0.0 into -0.0
        x_min, y_max = self.min_yup[0] * self.unit, 0.0 - self.min_yup[2] * self.unit
        return Lattice(x_min, y_max, self.cell_size * self.unit, self.width, self.height)

    @property
    def ground(self) -> float:
        """World z of the level's ground [m]."""
        return self.min_yup[1] * self.unit

    @property
    def free(self) -> Bool:
        """Where an agent can stand: the weight is finite. Shape (height, width), bool."""
        return np.asarray(np.isfinite(self.weights))

    @property
    def floor_height(self) -> NDArray[np.float32]:
        """The floor's Y [file units], shape (height, width), float32, NaN for no floor.

        A file without ``floorHeight`` has its floor at the ground height, where weights are
        finite. So has one that says ``useCellFloorHeight: false``, and also where it knows of a
        floor. The array is read-only unless it is the attribute itself.
        """
        stored = self.attributes.get("floorHeight")
        if stored is None or not self.uses_cell_floors:
            has_floor = self.free if stored is None else self.free | ~np.isnan(stored)
            return _derived(np.where(has_floor, np.float32(self.min_yup[1]), np.float32(np.nan)))
        with np.errstate(over="ignore"):  # what float32 can't hold is infinite
            return stored if stored.dtype == np.float32 else _derived(stored.astype(np.float32))

    @property
    def floor(self) -> Float:
        """World z of the floor [m], shape (height, width), float64, NaN for no floor."""
        return self.floor_of(slice(None), slice(None))

    def floor_of(self, rows: Int | slice, cols: Int | slice) -> Float:
        """World z of the floor of some cells [m], float64, NaN for no floor; see `floor_height`."""
        return self.floor_height[rows, cols].astype(np.float64) * self.unit

    @property
    def occupancy(self) -> NDArray[np.uint8]:
        """1 where something stands in the agent's way, shape (height, width), uint8.

        A file without ``occupancy`` is occupied where weights are infinite; one that keeps it
        in another dtype, where it is not 0. Read-only unless it is the attribute itself.
        """
        stored = self.attributes.get("occupancy")
        if stored is None:
            return _derived((~self.free).astype(np.uint8))
        return stored if stored.dtype == np.uint8 else _derived((stored != 0).astype(np.uint8))

    @property
    def solid(self) -> NDArray[np.uint8]:
        """1 where a geom meets the cell's square or there is no floor, uint8 as `occupancy`.

        A bake stores it where the disc of its `agentRadius` reaches beyond the square; everywhere
        else it is `occupancy`. What depends on the size of another agent is measured from it.
        Read-only unless it is the attribute itself.
        """
        stored = self.attributes.get("solid")
        if stored is None or not self.navbake:  # other programs may call anything so
            return self.occupancy
        return stored if stored.dtype == np.uint8 else _derived((stored != 0).astype(np.uint8))

    @property
    def free_for_point(self) -> Bool:
        """Where an agent without a radius can stand, as far as the grid tells; bool.

        These are the free cells and, with a layer ``solid``, those that only the disc of the baked
        radius closed, or the margin of a block. What an inflation closed stays closed.
        """
        free = self.free
        if "solid" not in self.attributes or not self.navbake or "inflation" in self.metadata:
            return free
        by_radius = self.occupancy != 0
        if self.block_state is not None:
            by_radius |= self.block_state.held(self, BLOCKED)
        return np.asarray(free | (by_radius & (self.solid == 0)))

    @property
    def room_index(self) -> NDArray[np.uint16]:
        """The room of each cell from 1, 0 for none, shape (height, width), uint16.

        A file without ``roomIndex`` has no rooms; in one that keeps it in another dtype, values
        beyond uint16 are no room. Read-only unless it is the attribute itself.
        """
        stored = self.attributes.get("roomIndex")
        if stored is None:
            return _derived(np.zeros(self.shape, dtype=np.uint16))
        if stored.dtype == np.uint16:
            return stored
        return _derived(np.where((stored >= 0) & (stored < 65536), stored, 0).astype(np.uint16))


@dataclass(eq=False, kw_only=True)
class MultiLevelGrid(GridBase):
    """The navigation grids of a scene with several levels.

    A level without metadata of its own takes over those of the whole when the grid is made, as
    far as they are about it (see `navbake.navgrid.metadata`). So each level is a grid by
    itself.

    Attributes:
        grids: the levels, lowest first, at least one.
        cell_size, unit, metadata, timings, extra: see `GridBase`.
    """

    grids: list[SceneGrid2D]
    _handed_down: list[Json] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.grids:
            raise FormatError("a MultiLevelGrid has at least one level, got none")
        for number, grid in enumerate(self.grids):
            if not grid.metadata or grid.metadata == self.metadata:
                grid.metadata = cut_metadata(self.metadata, number)
            # to be compared with what a level has later: metadata can be written to
            self._handed_down.append(cut_metadata(self.metadata, number))

    @property
    def levels(self) -> list[SceneGrid2D]:
        return self.grids

    def takes_over(self, number: int, level: SceneGrid2D) -> bool:
        """Whether a level still has the metadata that level `number` of this grid took over."""
        return level.metadata == self._handed_down[number]

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        grids = [
            level.with_layers(metadata={}) if self.takes_over(number, level) else level
            for number, level in enumerate(levels)
        ]
        return replace(self, grids=grids, metadata=self.metadata if metadata is None else metadata)


def _derived(array: NDArray[Any]) -> NDArray[Any]:
    """Make a computed array read-only: writing to it would not change the grid."""
    array.flags.writeable = False
    return array


NavGrid: TypeAlias = SceneGrid2D | MultiLevelGrid
