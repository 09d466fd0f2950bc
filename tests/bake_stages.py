"""Runs the bake's stages up to what stands in the cells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, TiledShapes, cast_columns, tile_shapes
from navbake.baker.contents.contents import Contents, find_contents
from navbake.baker.floors.levels import Floors, find_floors
from navbake.baker.occupancy.occupancy import Footprint, check_occupancy
from navbake.baker.pipeline import lay_lattice
from navbake.baker.scene.scene import Scene, load_scene
from navbake.config.settings import BakeConfig, parse_config
from navbake.navgrid.lattice import Lattice


@dataclass
class Stages:
    """What each stage made."""

    config: BakeConfig
    scene: Scene
    lattice: Lattice
    footprint: Footprint
    tiled: TiledShapes
    columns: Columns
    floors: Floors
    occupied: list[NDArray[np.bool_]]

    def contents(self) -> Contents:
        return find_contents(
            self.scene,
            self.columns,
            self.tiled,
            self.floors,
            self.occupied,
            self.config.agent,
            self.config.names,
        )


def run_stages(config: BakeConfig) -> Stages:
    scene = load_scene(config.scene)
    lattice = lay_lattice(scene, config)
    footprint = Footprint.of(config.agent, lattice.cell_size)
    tiled = tile_shapes(scene.shapes, lattice, footprint.reach)
    columns = cast_columns(tiled)

    def ask(cells: Any, floors: Any) -> Any:
        return check_occupancy(columns, tiled, footprint, cells, floors).occupied

    given = None if config.levels == "auto" else list(config.levels)
    floors = find_floors(columns, scene.shapes, config.agent, config.floors, given, ask)
    occupied = []
    for level in floors.levels:
        cells = np.flatnonzero(~np.isnan(level.floor))
        mask = np.ones(level.floor.size, dtype=np.bool_)
        mask[cells] = ask(cells, level.floor.ravel()[cells])
        occupied.append(mask.reshape(level.floor.shape))
    return Stages(config, scene, lattice, footprint, tiled, columns, floors, occupied)


def stages_of_xml(folder: Path, xml: str, **settings: Any) -> Stages:
    """The stages of an MJCF text."""
    path = folder / "scene.xml"
    path.write_text(xml, encoding="utf-8")
    scene = {"path": str(path), **settings.pop("scene", {})}
    return run_stages(parse_config({"scene": scene, **settings}))
