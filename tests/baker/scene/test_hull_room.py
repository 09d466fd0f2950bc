"""Whether the hull of a mesh may hide room."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from navbake.baker.scene import hull_room
from navbake.baker.scene.hull_room import MAX_LINES, HullRoomTest
from navbake.config.settings import AgentSettings, FloorSettings


@pytest.mark.parametrize(
    ("half", "is_large"),
    [((3, 3, 3), True), ((0.1, 3, 3), False), ((3, 3, 0.1), False), ((1e200, 1e200, 3), True)],
)
def test_boxes_are_large_or_not_however_large(half, is_large):
    """A model from a stranger may have any numbers; an area beyond all floats is large."""
    box = np.array([[0.0, 0.0, 0.0, *half]])
    model, data = SimpleNamespace(geom_aabb=box), SimpleNamespace(geom_xmat=np.eye(3).ravel()[None])
    room = HullRoomTest(model, data, None, AgentSettings(), FloorSettings())
    with np.errstate(all="raise"):
        assert room.is_large(0) == is_large


@pytest.mark.parametrize(
    ("width", "depth"), [(1e7, 1e-6), (1e9, 1.0), (1.0, 1e6), (3000.0, 2000.0)]
)
def test_no_shape_is_looked_at_along_too_many_lines(monkeypatch, width, depth):
    """A mesh may be as long and as thin as it likes."""
    seen = []

    def tile(shapes, lattice, half):
        seen.append(lattice)
        raise InterruptedError

    bounds = np.array([[0.0, 0.0, 0.0], [width, depth, 3.0]])
    found = SimpleNamespace(bounds=bounds), {}, []
    monkeypatch.setattr(hull_room, "collect_shapes", lambda *arguments, **keywords: found)
    monkeypatch.setattr(hull_room, "tile_shapes", tile)
    box = np.array([[0.0, 0.0, 0.0, 3.0, 3.0, 3.0]])
    model = SimpleNamespace(geom_aabb=box, geom_dataid=[0])
    data = SimpleNamespace(geom_xmat=np.eye(3).ravel()[None])
    room = HullRoomTest(model, data, None, AgentSettings(), FloorSettings())
    with pytest.raises(InterruptedError):
        room.find_hidden(0)
    assert seen[0].width * seen[0].height <= 3 * MAX_LINES
