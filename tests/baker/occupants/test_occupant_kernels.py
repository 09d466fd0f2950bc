"""Lists of what stands in cells, against loops over them in Python."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.core.constants import BUILDING, OBJECT, WALL
from navbake.baker.occupancy.occupancy import select_list_entries
from navbake.baker.occupancy.volume_kernels import AT_WALL_HEIGHT, BLOCKING, OCCUPYING
from navbake.baker.occupants.occupant_kernels import LevelOccupants, mark_walls
from navbake.navgrid.lattice import Lattice

CELLS, GEOMS = 12, 8
seeds = st.integers(0, 2**32 - 1)


def random_lists(rng: np.random.Generator) -> tuple[LevelOccupants, list[list[tuple[int, int]]]]:
    """Occupants of cells in any order, and the geoms and flags of each cell."""
    lists = []
    for _ in range(CELLS):
        geoms = np.flatnonzero(rng.random(GEOMS) < 0.3).tolist()
        flags = rng.choice(
            [OCCUPYING, BLOCKING, OCCUPYING | BLOCKING, OCCUPYING | BLOCKING | AT_WALL_HEIGHT],
            GEOMS,
        )
        lists.append([(geom, int(flags[geom])) for geom in geoms])
    first, entries = np.zeros(CELLS, dtype=np.int32), [(-1, 0)]
    for cell in rng.permutation(CELLS):
        if lists[cell]:
            first[cell] = len(entries)
            entries += [*lists[cell], (-1, 0)]
    geom, flags = np.array(entries).T
    none = np.full(CELLS, -1, dtype=np.int32), np.zeros(CELLS, dtype=np.uint8)
    line = Lattice(0.0, 0.0, 0.25, CELLS, 1)
    return LevelOccupants(line, first, geom.astype(np.int32), flags.astype(np.uint8), *none), lists


@settings(deadline=None)  # its kernels may be compiled first
@given(seeds)
def test_entries_by_cell(seed):
    rng = np.random.default_rng(seed)
    listed, lists = random_lists(rng)
    cells = np.flatnonzero(rng.random(CELLS) < 0.7)
    entries = select_list_entries(listed.list_start, listed.geom, listed.flags, cells)
    found = list(zip(*(array.tolist() for array in entries), strict=True))
    assert found == [(n, *entry) for n, cell in enumerate(cells) for entry in lists[cell]]


@settings(deadline=None)  # its kernels may be compiled first
@given(seeds)
def test_wall_cells_and_low_ones(seed):
    rng = np.random.default_rng(seed)
    listed, lists = random_lists(rng)
    kinds = rng.choice(np.array([OBJECT, WALL, BUILDING], dtype=np.uint8), GEOMS)
    cells = np.flatnonzero(rng.random(CELLS) < 0.7)
    walls, lows = np.empty((2, len(cells)), dtype=np.bool_)
    mark_walls(listed, kinds, cells, walls, lows, 0, len(cells))
    for n, cell in enumerate(cells.tolist()):
        here = [(kinds[geom], flags) for geom, flags in lists[cell] if flags & OCCUPYING]
        upper = [kind for kind, flags in here if flags & AT_WALL_HEIGHT]
        blocking = [(kind, flags) for kind, flags in here if flags & BLOCKING]
        is_wall = any(
            k == WALL or (k == BUILDING and flags & AT_WALL_HEIGHT) for k, flags in blocking
        )
        assert walls[n] == is_wall
        assert lows[n] == (BUILDING in [k for k, _ in blocking] and BUILDING not in upper)
