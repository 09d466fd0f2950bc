"""Union-find against sets that are merged by hand."""

from __future__ import annotations

import numpy as np

from kernel_parts import callable_part
from navbake.baker.core.union_find import find_root, unite

# parts of kernels as functions that Python can call
find_root = callable_part(find_root)
unite = callable_part(unite)


def test_roots_are_the_lowest_members_whatever_the_order():
    rng = np.random.default_rng(0)
    for _ in range(50):
        pairs = rng.integers(0, 30, (20, 2))
        sets = {item: {item} for item in range(30)}
        for one, other in pairs:
            merged = sets[int(one)] | sets[int(other)]
            sets.update(dict.fromkeys(merged, merged))
        for order in (pairs, pairs[::-1], pairs[:, ::-1]):
            parent = np.arange(30)
            for one, other in order:
                unite(parent, one, other)
            assert [find_root(parent, item) for item in range(30)] == [
                min(sets[item]) for item in range(30)
            ]
