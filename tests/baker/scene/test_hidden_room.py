"""Whether the hull of a mesh may hide room."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from navbake.baker.scene.hidden_room import HiddenRoom
from navbake.config.settings import AgentSettings, FloorSettings


@pytest.mark.parametrize(
    ("half", "is_large"),
    [((3, 3, 3), True), ((0.1, 3, 3), False), ((3, 3, 0.1), False), ((1e200, 1e200, 3), True)],
)
def test_boxes_are_large_or_not_however_large(half, is_large):
    """A model from a stranger may have any numbers; an area beyond all floats is large."""
    box = np.array([[0.0, 0.0, 0.0, *half]])
    model, data = SimpleNamespace(geom_aabb=box), SimpleNamespace(geom_xmat=np.eye(3).ravel()[None])
    room = HiddenRoom(model, data, None, AgentSettings(), FloorSettings())
    with np.errstate(all="raise"):
        assert room.is_large(0) == is_large
