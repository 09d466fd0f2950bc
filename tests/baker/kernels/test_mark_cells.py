"""Cells with a chosen entry, against a loop over lists."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.kernels.contents import mark_cells


@settings(deadline=None)  # the kernel may be compiled first
@given(st.lists(st.lists(st.booleans(), max_size=4), max_size=12), st.integers(0, 2**32 - 1))
def test_cells_with_a_chosen_entry_are_marked(entries, seed):
    """Marks that were there before stay."""
    start = np.concatenate([[0], np.cumsum([len(own) for own in entries])]).astype(np.int64)
    chosen = np.array([mark for own in entries for mark in own], dtype=np.bool_)
    marked = np.random.default_rng(seed).random(len(entries)) < 0.2
    expected = [before or any(own) for before, own in zip(marked, entries, strict=True)]
    mark_cells(start, chosen, marked)
    assert marked.tolist() == expected
