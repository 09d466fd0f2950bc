"""Whether the hull of a mesh may hide room."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import trimesh

from navbake.baker.bake.arguments import parse_arguments
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


# boxes: lower and upper corner
THINGS = {
    "couch": [((0, 0, 0.1), (2.4, 0.9, 0.45)), ((0, 0.7, 0.1), (2.4, 0.9, 0.9))],
    "couch with arms and a corner": [
        ((0, 0, 0), (3, 1, 0.4)),
        ((0, 0.8, 0), (3, 1, 0.8)),
        ((0, 0, 0), (0.2, 1, 0.6)),
        ((2, -0.9, 0), (3, 0, 0.4)),
    ],
    "bed": [((0, 0, 0), (1.8, 2.1, 0.5)), ((0, 2.1, 0), (1.8, 2.2, 1.1))],
    "bed between boards": [
        ((0, 0, 0), (1.6, 2.1, 0.5)),
        ((0, 2.1, 0), (1.6, 2.2, 1.1)),
        ((0, -0.1, 0), (1.6, 0, 0.9)),
    ],
    "car": [((0, 0, 0.3), (4.5, 1.8, 0.9)), ((1.3, 0, 0.9), (3.3, 1.8, 1.5))],
}
GROUNDS = {
    "angled stair": [((0.28 * k, 0, 0), (0.28 * (k + 1), 1.2, 0.17 * (k + 1))) for k in range(8)]
    + [((2.24, 0.28 * k, 0), (3.44, 0.28 * (k + 1), 1.36 + 0.17 * k)) for k in range(1, 8)],
    "stage before a wall": [((0, 0, 0), (4, 4, 0.5)), ((0, 4, 0), (4, 4.2, 2.5))],
    "low platform": [((0, 0, 0), (2, 2, 0.2)), ((0, 2, 0), (2, 2.1, 1.0))],
}


@pytest.mark.parametrize("name", [*THINGS, *GROUNDS])
@pytest.mark.parametrize("yaw", [0.0, 30.0])
def test_seats_and_mattresses_are_no_ground_that_a_hull_hides(name, yaw):
    parts = [trimesh.creation.box(bounds=bounds) for bounds in (THINGS | GROUNDS)[name]]
    mesh = trimesh.util.concatenate(parts)
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(5, 5, 0.1), pos=(0, 0, -0.1))
    added = spec.add_mesh(name="m", uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel())
    added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    half_yaw = np.radians(yaw) / 2
    geom = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m")
    geom.quat = (np.cos(half_yaw), 0, 0, np.sin(half_yaw))
    config, scene_model = parse_arguments(spec, None, {})
    scene = load_scene(config, scene_model=scene_model)
    assert scene.selections[1].mesh_mode == ("hull" if name in THINGS else "surface")
    assert any("hull hides" in text for text in scene.warnings) == (name in GROUNDS)
