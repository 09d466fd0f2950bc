"""What a voxel grid refuses."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.errors import FormatError
from navbake.voxels.grid import VoxelGrid


@pytest.mark.parametrize("value", [1 / 3, b"7" * 9, "x\n" * 99])
def test_a_corner_of_another_shape_is_told_in_one_short_line(value):
    many = tuple(np.full((5, 10, 3), value).tolist())
    with pytest.raises(FormatError, match="expected a lower corner") as caught:
        VoxelGrid(values=np.zeros((2, 2, 2), dtype=bool), origin=many, res=0.1)
    assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)
