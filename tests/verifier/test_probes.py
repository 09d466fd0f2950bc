"""What touches a column by MuJoCo and FCL, against solids in exact geometry."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from navbake.baker.scene.scene import load_scene
from navbake.config.settings import parse_config
from navbake.verifier.mesh_parts import CAVITY, OPEN_SURFACE, SOLID, split_mesh_parts
from navbake.verifier.obstacles import Obstacles
from navbake.verifier.probes import DISPUTED, NO_CONTACT, TOUCHES, ObstacleProbe, UprightPrism
from oracles.prisms import FREE, OCCUPIED, Prisms, body_meets_prisms
from oracles.scene import Thing, part_of, scene_xml

SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


def random_things(rng, kind, count):
    things = []
    for _ in range(count):
        turn = rng.normal(size=4)
        size = tuple(rng.uniform(0.02, 0.6, SIZES[kind]).tolist())
        pos = tuple(rng.uniform(-1, 1, 3).tolist())
        things.append(Thing(kind, size, pos, tuple((turn / np.linalg.norm(turn)).tolist())))
    return things


def obstacles_of(folder, xml, **scene):
    path = folder / "scene.xml"
    path.write_text(xml, encoding="utf-8")
    config = parse_config({"scene": {"path": str(path), "geoms": "all", **scene}})
    loaded = load_scene(config)
    return Obstacles(loaded, loaded.data)


@pytest.mark.parametrize("is_round", [False, True])
@pytest.mark.parametrize("kind", SIZES)
def test_touches_what_exact_geometry_touches(tmp_path, kind, is_round):
    rng = np.random.default_rng(SIZES[kind] + is_round)
    things = random_things(rng, kind, 25)
    obstacles = obstacles_of(tmp_path, scene_xml(things))
    probes, seen = ObstacleProbe(obstacles), set()
    half, half_z = 0.1, 0.445
    column = UprightPrism(half, half, half_z, is_round)
    for number, thing in enumerate(things):
        at = np.array(thing.pos) + rng.uniform(-0.7, 0.7, (60, 3))
        prisms = Prisms(at[:, 0], at[:, 1], at[:, 2] - half_z, at[:, 2] + half_z, half, is_round)
        exact = body_meets_prisms(part_of(thing), prisms)
        for center, state in zip(at, exact, strict=True):
            answer = probes.find_contact(number, column, center)
            seen.add(answer)
            assert answer != DISPUTED
            assert state != FREE or answer == NO_CONTACT
            assert state != OCCUPIED or answer == TOUCHES
    assert seen == {NO_CONTACT, TOUCHES}


def test_a_plane_that_separates_settles_what_the_libraries_dispute(tmp_path, monkeypatch):
    """MuJoCo's distance is made to be wrong, as it is in rare poses of capsules."""
    thing = Thing("capsule", (0.1, 0.4), (0.0, 0.0, 1.0))
    probes = ObstacleProbe(obstacles := obstacles_of(tmp_path, scene_xml([thing])))
    column, near = UprightPrism(0.1, 0.1, 0.4, False), np.array([0.3, 0.0, 1.0])
    assert probes.find_contact(0, column, near) == NO_CONTACT
    monkeypatch.setattr(mujoco, "mj_geomDistance", lambda *_: -0.01)
    assert probes.find_contact(0, column, near) == NO_CONTACT  # proved
    monkeypatch.setattr(mujoco, "mj_geomDistance", lambda *_: 0.01)
    # nothing separates them
    assert probes.find_contact(0, column, np.array([0.1, 0.0, 1.0])) == TOUCHES
    way = np.array([1.0, 0.0, 0.0])
    assert obstacles.support(0, way) == pytest.approx(0.1)


def test_depth_is_how_far_a_column_has_to_shrink(tmp_path):
    obstacles = obstacles_of(tmp_path, scene_xml([Thing("box", (0.5, 0.5, 0.5), (0.0, 0.0, 0.5))]))
    column, center = UprightPrism(0.1, 0.1, 0.4, False), np.array([0.58, 0.0, 0.5])
    depth = ObstacleProbe(obstacles).measure_depth(column, center, 0)
    assert depth == pytest.approx(0.02, abs=1e-4)


def test_lines_cross_what_exact_geometry_crosses(tmp_path):
    rng = np.random.default_rng(5)
    things = [thing for kind in SIZES for thing in random_things(rng, kind, 5)]
    probes = ObstacleProbe(obstacles_of(tmp_path, scene_xml(things)))
    for x, y in rng.uniform(-1, 1, (200, 2)):
        ends = []
        for thing in things:
            line = part_of(thing).cross(np.array([x]), np.array([y]))
            ends += [] if np.isnan(line.low[0]) else [line.low[0], line.high[0]]
        found = [hit.z for hit in probes.cast_line(x, y).hits]
        np.testing.assert_allclose(found, sorted(ends), atol=1e-6)


def test_transparent_geoms_planes_and_hulls_count_as_in_the_bake(tmp_path):
    """Rays see what is transparent, and the hull of a mesh; planes from both sides of nothing."""
    vertices = "0 0 0  1 0 0  0 1 0  0 0 1  0.2 0.2 0.2"
    xml = f"""<mujoco><asset><mesh name="m" vertex="{vertices}"/></asset><worldbody>
    <geom name="ground" type="plane" size="0 0 1"/>
    <geom name="glass" type="box" size="0.5 0.5 0.1" pos="3 0 1" rgba="1 1 1 0"/>
    <geom name="hull" type="mesh" mesh="m" pos="6 0 1"/></worldbody></mujoco>"""
    obstacles = obstacles_of(tmp_path, xml)
    probes = ObstacleProbe(obstacles)
    names = [obstacles.geom_name(hit.obstacle) for hit in probes.cast_line(3.0, 0.0).hits]
    assert names == ["ground", "glass", "glass"]
    heights = [hit.z for hit in probes.cast_line(6.2, 0.2).hits[1:]]
    assert heights == pytest.approx([1.0, 1.6], abs=1e-5)
    line = probes.cast_line(6.2, 0.2)
    assert line.is_inside(1.3) and not line.is_inside(1.7)
    for z, expected in ((0.39, TOUCHES), (0.41, NO_CONTACT)):
        column, at = UprightPrism(0.1, 0.1, 0.4, False), np.array([-3.0, 0.0, z])
        assert probes.find_contact(0, column, at) == expected


# ---------------------------------------------------------------- meshes

BOX = [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4), (1, 3, 7), (1, 7, 5)]
BOX += [(3, 2, 6), (3, 6, 7), (2, 0, 4), (2, 4, 6), (4, 5, 7), (4, 7, 6)]
CORNERS = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)


@pytest.mark.parametrize(
    ("faces", "kinds"),
    [
        (BOX, [SOLID]),
        ([face[::-1] for face in BOX], [OPEN_SURFACE]),  # a room that is drawn from inside
        (BOX[:-2], [OPEN_SURFACE]),
        ([BOX[0][::-1], *BOX[1:]], [SOLID]),  # one triangle is turned
        ([*BOX, *(tuple(v + 8 for v in face[::-1]) for face in BOX)], [CAVITY, SOLID]),
        ([*BOX, *(tuple(v + 8 for v in face) for face in BOX[:3])], [OPEN_SURFACE, SOLID]),
    ],
)
def test_parts_of_meshes_by_what_they_enclose(faces, kinds):
    points = np.concatenate([CORNERS, CORNERS / 2 + 0.25])
    parts = split_mesh_parts(points, np.array(faces))
    assert sorted(kind for kind, _ in parts) == kinds
    assert sum(len(own) for _, own in parts) == len(faces)
