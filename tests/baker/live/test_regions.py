"""Which cells an update looks at, against plain ways to the same answers."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from navbake.baker.core.windows import find_cells_near_boxes
from navbake.navgrid.lattice import Lattice

LATTICE = Lattice(-1.0, 2.0, 0.25, 23, 17)
CELLS = LATTICE.width * LATTICE.height
seeds = st.integers(0, 2**32 - 1)


def inside(boxes, grow):
    """The cells whose centres lie in boxes, one by one."""
    x, y = LATTICE.positions(*np.divmod(np.arange(CELLS), LATTICE.width)).T
    marked = np.zeros(CELLS, dtype=np.bool_)
    for x0, y0, _, x1, y1, _ in boxes:
        marked |= (x >= x0 - grow) & (x <= x1 + grow) & (y >= y0 - grow) & (y <= y1 + grow)
    return np.flatnonzero(marked)


@given(seeds)
def test_cells_near_boxes_hold_those_whose_centres_lie_there(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-4, 6, (int(rng.integers(0, 5)), 3))
    boxes = np.hstack([low, low + rng.uniform(0, 3, low.shape)])
    grow = rng.uniform(0, 1)
    found = find_cells_near_boxes(LATTICE, boxes, grow)
    assert np.isin(inside(boxes, grow), found).all()
    assert np.isin(found, inside(boxes, grow + 0.01 * LATTICE.cell_size)).all()


def test_far_and_endless_boxes_are_cut_off_at_the_lattice():
    endless = np.array([[-np.inf, -np.inf, 0, np.inf, np.inf, 1.0]])
    assert np.array_equal(find_cells_near_boxes(LATTICE, endless, 0.1), np.arange(CELLS))
    far = np.array([[1e30, 1e30, 0, 1e31, 1e31, 1.0], [-1e31, 0, 0, -1e30, 1, 1.0]])
    assert not len(find_cells_near_boxes(LATTICE, far, 0.1))
