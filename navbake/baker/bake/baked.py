"""The values that a bake computes from structure, and those that also depend on the pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.bake.boxes import LevelBoxes
from navbake.baker.core.windows import Window
from navbake.baker.doors.doors import ClassifiedLeaf, select_doors
from navbake.baker.floors.levels import Floors
from navbake.baker.links.areas import PaintedAreas
from navbake.baker.links.links import BakedLinks
from navbake.baker.links.search import CollisionGeometry
from navbake.baker.occupants.movable import MovableOccupants
from navbake.baker.occupants.standing import StandingOccupants
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.scene.scene import Scene
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Door
from navbake.types import Bool, Json


class FloorLattice(NamedTuple):
    """The lattice on which floors are found, and the part of it that is baked.

    Attributes:
        lattice: the lattice of the whole scene, or of as much as `grid.max_cells` allows.
        window: the rows and columns of `lattice` that are baked.
    """

    lattice: Lattice
    window: Window


class StructureLayers(NamedTuple):
    """The layers of a level that follow from structure alone, on the level's own rectangle.

    Attributes:
        floor: the height of the floor in each cell [m], NaN where there is none, float32.
        room_index: the index of each cell's room in the table of rooms, uint16.
        unseen: 1 where a hole of a mesh was closed, uint8; None where holes are not closed.
    """

    floor: NDArray[np.float32]
    room_index: NDArray[np.uint16]
    unseen: NDArray[np.uint8] | None


@dataclass(frozen=True)
class BakedStructure:
    """The values that a bake computes from structure and closed leaves; no movement changes them.

    Attributes:
        lattice: the cells that are baked.
        floors: the levels with their floors.
        layers: for each level, the layers that follow from structure alone.
        named_occupants: the structure in each cell, and the names of all geoms, by which a grid
            lists what is in its cells; None if the settings ask for no names in cells.
        rooms: the room of each cell.
        boxes: the rectangle of cells, and the bounding box, of each level.
        link_geometry: the structure that an agent on a link may collide with; None without links.
        settings_metadata: the settings and their digest, as written to a file.
        steps: the steps between levels, with cells counted on each level's own rectangle.
        warnings: the warnings that concern structure, one line each.
    """

    lattice: Lattice
    floors: Floors
    layers: list[StructureLayers]
    named_occupants: StandingOccupants | None
    rooms: Rooms
    boxes: LevelBoxes
    link_geometry: CollisionGeometry | None
    settings_metadata: Json
    steps: list[list[int]]
    warnings: list[str]


class GridDoor(NamedTuple):
    """A door of the grid, and its entry in the grid's file.

    Attributes:
        door: the door, with the cells that nothing else occupies.
        entry: the same door as it is written to a file.
        is_stuck: whether its open state blocks most of the cells that its closed one blocks.
    """

    door: Door
    entry: Json
    is_stuck: bool


@dataclass(frozen=True)
class BakedPose:
    """The values that a bake computes from a scene's pose: movables, doors, areas and links.

    Attributes:
        scene: the scene in its pose.
        leaves: all classified leaves, doors or not, each with the cells that it blocks in each
            state; `door_leaves` are the doors among them.
        is_obstacle_geom: for each geom, whether it belongs to a movable or to a leaf that is no
            door, (ngeom,). Such geoms only block cells; see `mark_obstacle_geoms`.
        occupants: the geoms of `is_obstacle_geom` in each cell; and the cells that these geoms or
            structure block.
        lost_floor_areas: id of a movable body -> the area [m²] of its top that would be floor if
            the body could not move.
        grid_doors: the doors of the grid, with their entries in its file.
        room_table: the table of rooms as written to a file, with the doors between them.
        areas: the areas of the settings, painted on the levels.
        links: the named links.
        name_boxes: name -> the box round all geoms of that name, see `measure_names`; empty if the
            settings ask for no names in cells.
        uncounted_warnings: the warnings of `warn_uncounted`: drawn geoms on the floor that don't
            count.
    """

    scene: Scene
    leaves: list[ClassifiedLeaf]
    is_obstacle_geom: Bool
    occupants: MovableOccupants
    lost_floor_areas: dict[int, float]
    grid_doors: list[GridDoor]
    room_table: list[Json]
    areas: PaintedAreas
    links: BakedLinks
    name_boxes: dict[str, list[float]]
    uncounted_warnings: list[str]

    @property
    def door_leaves(self) -> list[ClassifiedLeaf]:
        """The leaves that are doors."""
        return select_doors(self.leaves)
