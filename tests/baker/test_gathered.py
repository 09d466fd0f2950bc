"""Arrays that come in parts become one, whatever the parts' sizes and what was expected of them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from navbake.baker.gathered import Gathered


@given(
    sizes=st.lists(st.integers(0, 40), min_size=1, max_size=8), even=st.booleans(), data=st.data()
)
def test_parts_become_one(sizes, even, data):
    """Shares may promise too much or too little: no part is lost, and dtypes stay."""
    heights, vectors = np.empty(0), np.empty((0, 3), dtype=np.float32)
    gathered, number = Gathered(heights, vectors), np.arange(sum(sizes))
    first = 0
    for k, size in enumerate(sizes):
        part = number[first : first + size]
        first += size
        known = (k + 1) / len(sizes)
        share = known if even else data.draw(st.floats(0.01, 1.0))
        gathered.add(part, np.repeat(part, 3).reshape(-1, 3), share=share)
        assert len(gathered) == first
    z, xyz = gathered.take()
    np.testing.assert_array_equal(z, number)
    np.testing.assert_array_equal(xyz, np.repeat(number, 3).reshape(-1, 3))
    assert z.dtype == np.float64 and xyz.dtype == np.float32


def test_a_part_that_is_all_is_not_copied():
    """One block of columns is most scenes: its surfaces are there already."""
    gathered, part = Gathered(np.empty(0)), np.arange(5.0)
    gathered.add(part, share=1.0)
    assert gathered.take()[0].base is part
    gathered.add(part, share=1.0)  # though more was said not to come
    np.testing.assert_array_equal(gathered.take()[0], [*part, *part])
    np.testing.assert_array_equal(part, np.arange(5.0))
