"""Whether the hull of a mesh may hide room."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from navbake.baker.scene import hull_room
from navbake.baker.scene.hull_room import MAX_LINES, HullRoomTest
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import AgentSettings, FloorSettings, parse_config


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


def bowl(depth):
    """An open mesh of 3 x 3 m: a rim, and ground that lies deeper in its middle."""
    x = np.array([-1.5, -1.2, 1.2, 1.5])
    points = [(a, b, -depth if abs(a) < 1.4 and abs(b) < 1.4 else 0.0) for b in x for a in x]
    faces = []
    for row in range(3):
        for col in range(3):
            first = 4 * row + col
            faces += [(first, first + 1, first + 5), (first, first + 5, first + 4)]
    return points, faces


@pytest.mark.parametrize(
    ("depth", "joint", "modes"),
    [
        (0.3, "", "surface"),  # more than a step
        (0.2, "", "hull"),  # less than one
        (0.3, "<freejoint/>", "hull"),  # what can move is no ground
    ],
)
def test_ground_below_a_hull_counts_by_its_triangles(tmp_path, depth, joint, modes):
    points, faces = bowl(depth)
    numbers = " ".join(f"{value}" for point in points for value in point)
    corners = " ".join(f"{value}" for face in faces for value in face)
    path = tmp_path / "bowl.xml"
    path.write_text(
        f'<mujoco><asset><mesh name="m" inertia="shell" vertex="{numbers}" face="{corners}"/>'
        '</asset><worldbody><geom type="box" size="4 4 .1" pos="0 0 -1"/><body name="bowl">'
        f'{joint}<geom name="bowl" type="mesh" mesh="m"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    scene = load_scene(parse_config({"scene": {"path": str(path)}}))
    assert scene.selections[1].mesh_mode == modes
    assert any("ground" in text for text in scene.warnings) == (modes == "surface")
