"""Summarises what a grid holds: levels, areas, doors, and what made it."""

import numpy as np

from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import find_islands
from navbake.types import Int32, Json

MADE_BY = {
    "version": "navbake",
    "mujoco": "mujoco",
    "sceneDigest": "scene_digest",
    "settingsDigest": "settings_digest",
}
AGENT = {
    "agentHeight": "height",
    "agentRadius": "radius",
    "traversableFloorHeight": "traversable_floor_height",
    "maxSlope": "max_slope",
}
INFLATION = ("radius", "clearance", "mode")


def describe(grid: NavGrid) -> Json:
    """Summarise a grid in values that JSON can hold.

    Returns:
        ``type``; ``scene_id``; ``cell_size`` [m]; ``agent``, ``made_by``: the agent's settings,
        and the versions and digests, as far as the file has them; ``levels``, lowest first, each
        with ``name``, ``width`` and ``height`` [cells], ``ground``, ``floor_min`` and
        ``floor_max`` (world z [m], None without floor), ``floor_area``, ``free_area`` and
        ``largest_island_area`` [m2], ``num_islands``, ``num_rooms``; ``num_islands`` and
        ``num_links`` of all levels together; ``doors``, see `navbake.navgrid.doors.Door.to_json`;
        ``inflated``: radius and clearance [m] and mode of each inflation since the bake;
        ``warnings`` of the bake.
    """
    islands = find_islands(grid)
    stated, noted = {**grid.metadata, **grid.navbake}, grid.metadata.get("inflation")
    return {
        "type": type(grid).__name__,
        "scene_id": grid.scene_id,
        "cell_size": grid.levels[0].lattice.cell_size,
        "agent": {name: stated[key] for key, name in AGENT.items() if key in stated},
        "made_by": {name: stated[key] for key, name in MADE_BY.items() if key in grid.navbake},
        "levels": [
            {"name": name, **_describe_level(level, island)}
            for name, level, island in zip(grid.level_names, grid.levels, islands, strict=True)
        ],
        "num_islands": max(int(island.max(initial=0)) for island in islands),
        "num_links": len(grid.link_array),
        "doors": [door.to_json() for door in grid.doors],
        # what `inflate` noted; a file of another program may have anything there
        "inflated": [
            {key: entry[key] for key in INFLATION}
            for entry in (noted if isinstance(noted, list) else [])
            if isinstance(entry, dict) and entry.keys() >= set(INFLATION)
        ],
        "warnings": list(grid.warnings),
    }


def _describe_level(level: SceneGrid2D, island: Int32) -> Json:
    cell_area = level.lattice.cell_size**2
    floor = level.floor
    floor = floor[np.isfinite(floor)]
    island_sizes = np.bincount(island.ravel())[1:]
    return {
        "width": level.width,
        "height": level.height,
        "ground": _rounded(level.ground),
        "floor_min": _rounded(floor.min()) if floor.size else None,
        "floor_max": _rounded(floor.max()) if floor.size else None,
        "floor_area": _rounded(floor.size * cell_area),
        "free_area": _rounded(np.count_nonzero(level.free) * cell_area),
        "num_islands": int(np.count_nonzero(island_sizes)),
        "largest_island_area": _rounded(island_sizes.max(initial=0) * cell_area),
        "num_rooms": int(np.count_nonzero(np.unique(level.room_index))),
    }


def _rounded(value: float) -> float:
    """To a millionth, finer than float32 heights are, so that 2.8 is not 2.799999952."""
    return round(float(value), 6) + 0.0  # + 0.0 turns -0.0 into 0.0
