"""What a bake finds: what follows from what stands, and what follows from the pose, too."""

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
    """The lattice on which floors are judged, and the window of it that is baked."""

    lattice: Lattice
    window: Window


class StructureLayers(NamedTuple):
    """Layers of a level as they are written, of its own rectangle.

    Attributes:
        floor: the floor [m], float32.
        room_index: the room of each cell, uint16.
        unseen: the cells that no surface was seen in, uint8; None where none is told apart.
    """

    floor: NDArray[np.float32]
    room_index: NDArray[np.uint16]
    unseen: NDArray[np.uint8] | None


@dataclass(frozen=True)
class BakedStructure:
    """What follows from what stands, and from closed leaves: nothing that moves changes it.

    Attributes:
        lattice: the cells.
        floors: the storeys.
        layers: the layers of each level that nothing which moves changes.
        occupants: what stands in the cells; None where neither names nor rooms need it.
        rooms: the room of each cell.
        boxes: the rectangle and the box of each level.
        link_geometry: what an agent on a link may collide with; None where there are none.
        settings_metadata: the settings and their digest, as a file states them.
        steps: the steps of the floors, with cells counted on each level's own rectangle.
        warnings: what the user should know of it, one line each.
    """

    lattice: Lattice
    floors: Floors
    layers: list[StructureLayers]
    occupants: StandingOccupants | None
    rooms: Rooms
    boxes: LevelBoxes
    link_geometry: CollisionGeometry | None
    settings_metadata: Json
    steps: list[list[int]]
    warnings: list[str]


class GridDoor(NamedTuple):
    """A door as the grid has it.

    Attributes:
        door: with its cells that nothing else occupies.
        entry: the door as the file states it.
        is_stuck: whether its open state blocks most of what its closed one does.
    """

    door: Door
    entry: Json
    is_stuck: bool


@dataclass(frozen=True)
class BakedPose:
    """What depends on the pose of a scene: what can move, doors, areas, links.

    Attributes:
        scene: the scene in its pose.
        doors: what each leaf is, and what it blocks in each state.
        in_the_way: by geom id, whether it is only ever in the way, see `mark_in_the_way`.
        occupants: what can move, and leaves that are no doors; and all cells that are occupied,
            but by doors.
        lost_floors: by body id, how much floor there would be on what can move [m²].
        grid_doors: the doors as the grid has them.
        room_table: the table of rooms as a file states it, with the doors between them.
        areas: the areas of the settings, painted on the levels.
        links: the named links.
    """

    scene: Scene
    doors: list[ClassifiedLeaf]
    in_the_way: Bool
    occupants: MovableOccupants
    lost_floors: dict[int, float]
    grid_doors: list[GridDoor]
    room_table: list[Json]
    areas: PaintedAreas
    links: BakedLinks

    @property
    def placed_doors(self) -> list[ClassifiedLeaf]:
        """The leaves that are doors."""
        return select_doors(self.doors)
