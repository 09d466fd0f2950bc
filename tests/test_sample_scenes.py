"""The sample scenes are sound: doors, stairs, furniture; so is the house for measuring."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from make_house import make_house
from navbake.config.settings import load_config
from project_paths import ROOT

SCENES = ROOT / "configs" / "scenes"
MJCF = ("apartment", "house", "warehouse", "terrain")
KEYFRAMES = ("doors_closed", "doors_open")
PLANE, HFIELD = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)
BOX, MESH = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH)
CLOSE = 0.002  # [m] what may overlap, or stand off the floor


class Posed:
    """A sample scene in a pose, with the bounds of its geoms."""

    def __init__(self, name: str, keyframe: str | None = None, probe: str = "") -> None:
        spec = mujoco.MjSpec.from_file(str(SCENES / f"{name}.xml"))
        if probe:  # a cylinder that tests move about, 0.5 m wide
            size = [0.25, 0.44, 0]
            body = spec.worldbody.add_body(name=probe)
            body.add_geom(name=probe, type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        if keyframe:
            mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key(keyframe).id)
        mujoco.mj_forward(self.model, self.data)
        rotation = self.data.geom_xmat.reshape(-1, 3, 3)
        box = self.model.geom_aabb
        middle = self.data.geom_xpos + np.einsum("nij,nj->ni", rotation, box[:, :3])
        extent = np.einsum("nij,nj->ni", abs(rotation), box[:, 3:])
        self.low, self.high = middle - extent, middle + extent
        for g in np.flatnonzero(self.model.geom_type == MESH):  # its box is turned with its frame
            mesh = self.model.mesh(self.model.geom_dataid[g])
            vertices = self.model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
            points = vertices @ rotation[g].T + self.data.geom_xpos[g]
            self.low[g], self.high[g] = points.min(axis=0), points.max(axis=0)
        self.names = [self.model.geom(g).name for g in range(self.model.ngeom)]
        self.roots = self.model.body_rootid[self.model.geom_bodyid]

    def root(self, geom: int) -> str:
        """The name of the body that stands in the world; the geom's own where it does."""
        root = self.roots[geom]
        return str(self.model.body(root).name) if root else self.names[geom]

    def distance(self, a: int, b: int) -> float:
        """Distance of two geoms [m], negative where they overlap, 0.1 at most."""
        return float(mujoco.mj_geomDistance(self.model, self.data, a, b, 0.1, None))

    def near(self, geom: int, low: NDArray[np.float64], high: NDArray[np.float64]) -> list[int]:
        """All other solid geoms whose bounds meet a box."""
        meets = (self.low < high).all(axis=1) & (self.high > low).all(axis=1)
        meets &= ~np.isin(self.model.geom_type, (PLANE, HFIELD))
        return [int(g) for g in np.flatnonzero(meets) if g != geom]

    def ray(self, origin: NDArray[np.float64], up: int, without: int = -1) -> float:
        """Distance to the next face straight up or down, without a body [m]; inf if none."""
        geom = np.zeros(1, np.int32)
        to = np.array([0.0, 0.0, up])
        d = mujoco.mj_ray(self.model, self.data, origin, to, None, 1, without, geom, None)
        return np.inf if d < 0 else d


@pytest.mark.parametrize("name", [*MJCF, "clutter", "tower"])
def test_each_scene_has_its_settings(name: str) -> None:
    settings = load_config(ROOT / "configs" / f"{name}.yaml")
    assert settings.scene.id == name
    assert settings.scene.path.resolve().is_file()
    assert str(settings.output) == f"{name}.grid.json"


@pytest.mark.parametrize("name", [*MJCF, "tower"])
def test_everything_is_named(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(SCENES / f"{name}.xml"))
    kinds = [(model.geom, model.ngeom), (model.body, model.nbody), (model.joint, model.njnt)]
    assert all(kind(i).name for kind, count in kinds for i in range(count))


def test_the_apartment_has_geoms_of_all_types() -> None:
    model = mujoco.MjModel.from_xml_path(str(SCENES / "apartment.xml"))
    assert set(model.geom_type) == set(range(PLANE, int(mujoco.mjtGeom.mjGEOM_SDF) + 1))


@pytest.mark.parametrize("name", [*MJCF, "tower"])
def test_no_upright_face_lies_where_cells_meet(name: str) -> None:
    """The scene's own outline aside, so that no cell hangs on the last bit of a number."""
    scene = Posed(name)
    finite = ~((scene.model.geom_type == PLANE) & (scene.model.geom_size[:, 0] == 0))
    outline = scene.low[finite, :2].min(axis=0), scene.high[finite, :2].max(axis=0)
    if name == "apartment":  # MuJoCo's bounds of a finite plane are endless
        outline = np.array([-5.0, -4.0]), np.array([5.0, 4.0])
    if name == "house":  # its outer walls stand on whole metres, like the roof's edge
        outline = tuple(np.sign(o) * np.array([[5.0, 4.0], [5.3, 4.3]]) for o in outline)
    on_line = []
    for g in np.flatnonzero(scene.model.geom_type == BOX):
        rotation = abs(scene.data.geom_xmat[g])
        if not np.isin(np.round(rotation, 6), (0, 1)).all():
            continue
        for corner in (scene.low[g, :2], scene.high[g, :2]):
            off = abs(corner / 0.05 - np.round(corner / 0.05)) * 0.05 < 1e-3
            at_edge = np.any([np.isclose(corner, o).reshape(-1, 2).any(0) for o in outline], 0)
            if (off & ~at_edge).any():
                on_line.append(scene.names[g])
    assert on_line == []


# --- doors ---------------------------------------------------------------------------------


def door_joints(scene: Posed) -> Iterator[int]:
    for joint in range(scene.model.njnt):
        if scene.model.joint(joint).name.startswith("door_"):
            yield joint


@pytest.mark.parametrize("name", MJCF)
def test_doors_close_at_zero_and_open_at_the_end_of_their_range(name: str) -> None:
    closed, opened = (Posed(name, keyframe) for keyframe in KEYFRAMES)
    doors = list(door_joints(closed))
    assert doors
    for joint in doors:
        low, high = closed.model.jnt_range[joint]
        address = closed.model.jnt_qposadr[joint]
        assert closed.data.qpos[address] == low == 0
        assert opened.data.qpos[address] == pytest.approx(high, abs=1e-6)
        assert (
            closed.model.body(closed.model.jnt_bodyid[joint]).name == closed.model.joint(joint).name
        )


def test_the_apartment_has_a_door_for_each_way() -> None:
    scene = Posed("apartment")
    names = {scene.model.joint(joint).name for joint in door_joints(scene)}
    hinged = {"bedroom", "bathroom", "kitchen", "living_room", "entrance"}
    assert names == {f"door_{room}" for room in (*hinged, "terrace_room")}


@pytest.mark.parametrize("part", [0.0, 0.3, 0.6, 0.9, 1.0])
@pytest.mark.parametrize("name", MJCF)
def test_doors_touch_nothing_on_their_way(name: str, part: float) -> None:
    scene = Posed(name, "doors_closed")
    for joint in door_joints(scene):
        scene.data.qpos[scene.model.jnt_qposadr[joint]] = part * scene.model.jnt_range[joint, 1]
    mujoco.mj_kinematics(scene.model, scene.data)
    touching = []
    for joint in door_joints(scene):
        body = scene.model.jnt_bodyid[joint]
        for g in np.flatnonzero(scene.model.geom_bodyid == body):
            around = scene.data.geom_xpos[g]
            reach = scene.model.geom_rbound[g]
            for other in scene.near(int(g), around - reach, around + reach):
                if scene.roots[other] != body and scene.distance(int(g), other) < 0:
                    touching.append((scene.names[g], scene.names[other]))
    assert touching == []


# --- stairs --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "stair", "end"),
    [
        ("house", "stair_closed", 3.0),
        ("house", "stair_open", 3.0),
        ("warehouse", "mezzanine_stair", 3.0),
        ("warehouse", "dock", 1.2),
    ],
)
def test_stairs_are_not_too_steep_and_have_headroom(name: str, stair: str, end: float) -> None:
    scene = Posed(name)
    kinds = (f"{stair}_step", f"{stair}_tread", f"{stair}_landing")
    steps = [g for g, geom in enumerate(scene.names) if geom.startswith(kinds)]
    tops = sorted(scene.high[g, 2] for g in steps)
    assert max(np.diff([0, *tops, end])) <= 0.2 + 1e-9
    for g in steps:
        inner = 0.02  # [m] off the step's edges
        low, high = scene.low[g] + inner, scene.high[g] - inner
        for x, y in itertools.product((low[0], high[0]), (low[1], high[1])):
            start = np.array([x, y, scene.high[g, 2] + 1e-3])
            following = 0.22  # [m] a nosing of the next tread may be over this one
            headroom = scene.ray(start, up=1)
            assert headroom >= 2.0 or headroom < following, scene.names[g]


# --- furniture -----------------------------------------------------------------------------

BY_DESIGN = {  # what runs into each other: sunk into the ground, or meeting at a corner
    frozenset(("slab_1", "dock")),
    frozenset(("railing_closed_south", "railing_closed_west")),
    frozenset(("railing_open_west", "railing_open_south")),
    frozenset(("mezzanine_railing_south", "mezzanine_railing_east")),
}


@pytest.mark.parametrize(
    ("name", "keyframe"), [*itertools.product(MJCF, [None, *KEYFRAMES]), ("tower", None)]
)
def test_nothing_stands_in_something_else(name: str, keyframe: str | None) -> None:
    scene = Posed(name, keyframe)
    overlaps = set()
    for a in range(scene.model.ngeom):
        if scene.model.geom_type[a] in (PLANE, HFIELD):
            continue
        for b in scene.near(a, scene.low[a], scene.high[a]):
            if b > a and scene.roots[a] != scene.roots[b] and scene.distance(a, b) < -CLOSE:
                overlaps.add(frozenset((scene.root(a), scene.root(b))))
    assert overlaps - BY_DESIGN == set()


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse"])
def test_furniture_stands_on_a_floor(name: str) -> None:
    scene = Posed(name)
    built_in = ("door_", "rail", "wall_cabinet", "mezzanine", "stair_", "dock")
    afloat = []
    for body in range(1, scene.model.nbody):
        label = scene.model.body(body).name
        geoms = np.flatnonzero(scene.roots == body)
        hanging = any(scene.names[g].endswith("_cord") for g in geoms)
        if hanging or any(part in label for part in built_in):
            continue
        lowest = geoms[scene.low[geoms, 2].argmin()]
        foot = scene.data.geom_xpos[lowest].copy()
        foot[2] = scene.low[lowest, 2] + 0.01
        if not 0.005 <= scene.ray(foot, up=-1, without=body) <= 0.01 + CLOSE:
            afloat.append(label)
    assert afloat == []


@pytest.mark.parametrize(
    ("name", "z", "start", "rooms"),
    [
        (
            "apartment",
            0.0,
            (0.5, -2.5),
            {
                "bedroom": (-2.1, 0.4),
                "bathroom": (0.0, 1.9),
                "hall": (3.0, 0.6),
                "kitchen": (2.7, 2.8),
            },
        ),
        (
            "house",
            0.0,
            (1.4, -3.0),
            {"kitchen": (-2.0, -2.4), "stair hall": (-3.0, 2.0), "alcove": (4.0, 2.9)},
        ),
        (
            "house",
            3.0,
            (3.0, 2.2),
            {"bedroom 1": (-2.5, -0.5), "bedroom 2": (0.9, -1.5), "balcony": (3.5, -2.5)},
        ),
        (
            "warehouse",
            0.0,
            (3.5, -1.9),
            {"aisle": (-5.0, -4.0), "below the mezzanine": (-8.0, 3.0), "door": (-9.0, -4.1)},
        ),
    ],
)
def test_an_agent_half_a_metre_wide_gets_into_each_room(
    name: str, z: float, start: tuple[float, float], rooms: dict[str, tuple[float, float]]
) -> None:
    """By a plain flood fill of free places 0.1 m apart, doors open."""
    scene = Posed(name, "doors_open", probe="agent")
    agent = scene.model.geom("agent").id
    half = np.array([0.25, 0.25, 0.44])
    outline = (10, 6) if name == "warehouse" else (5, 4)

    def is_free(place: tuple[int, int]) -> bool:
        middle = np.array([place[0] / 10, place[1] / 10, z + 0.26 + 0.44])
        scene.data.geom_xpos[agent] = middle
        others = scene.near(agent, middle - half, middle + half)
        inside = bool((abs(middle[:2]) < outline).all())
        standing = scene.ray(middle, up=-1, without=scene.roots[agent]) < 0.75
        return inside and standing and all(scene.distance(agent, g) > 0 for g in others)

    first = round(start[0] * 10), round(start[1] * 10)
    assert is_free(first)
    reached, front = {first}, [first]
    while front:
        x, y = front.pop()
        for place in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if place not in reached and is_free(place):
                reached.add(place)
                front.append(place)
    missed = [
        room for room, (x, y) in rooms.items() if (round(x * 10), round(y * 10)) not in reached
    ]
    assert missed == []


# --- the house for measuring ---------------------------------------------------------------


def test_a_hundred_rooms_have_3402_geoms_on_50_m() -> None:
    model = mujoco.MjModel.from_xml_string(make_house(100))
    assert model.ngeom == 3402
    assert model.geom_size[model.geom("floor").id, :2].tolist() == [25, 25]
    assert len(set(model.geom_type)) == 6


def test_a_house_with_doors_has_one_in_each_doorway() -> None:
    plain, document = make_house(9), make_house(9, with_doors=True)
    model = mujoco.MjModel.from_xml_string(document)
    assert model.njnt == 2 * 2 * 3
    assert document.startswith(plain[: plain.index("  </worldbody>")])
    leaves = model.body_geomadr[model.jnt_bodyid]
    for angle in (0.0, np.pi / 2):
        data = mujoco.MjData(model)
        data.qpos[:] = angle
        mujoco.mj_forward(model, data)
        walls = [g for g in range(model.ngeom) if model.geom(g).name.startswith("wall_")]
        assert all(
            mujoco.mj_geomDistance(model, data, leaf, wall, 1.0, None) > 0.005
            for leaf in leaves
            for wall in walls
        )
        if angle == 0.0:  # gaps of 3 cm on both sides: nobody passes
            sides = [
                sorted(mujoco.mj_geomDistance(model, data, leaf, wall, 1.0, None) for wall in walls)
                for leaf in leaves
            ]
            assert all(near[1] < 0.031 for near in sides)


def test_a_house_is_the_same_for_the_same_seed() -> None:
    assert make_house(4, seed=1) == make_house(4, seed=1) != make_house(4, seed=2)


@pytest.mark.parametrize("rooms", [-4, 0, 8])
def test_rooms_that_make_no_square_are_refused(rooms: int) -> None:
    with pytest.raises(ValueError, match=f"square number of rooms >= 1, got {rooms}"):
        make_house(rooms)


@pytest.mark.parametrize("triangles", [4, 20, 300])
def test_meshes_of_a_house_have_as_many_triangles_as_asked_for(triangles):
    model = mujoco.MjModel.from_xml_string(make_house(1, triangles=triangles))
    assert model.nmesh == 12
    # a hull's record in the graph begins with the numbers of its corners and of its triangles
    corners = model.mesh_graph[model.mesh_graphadr]
    assert set(model.mesh_graph[model.mesh_graphadr + 1]) == {triangles}
    assert set(corners) == {triangles // 2 + 2}


@pytest.mark.parametrize("triangles", [-2, 2, 5])
def test_a_house_of_other_numbers_of_triangles_is_refused(triangles):
    with pytest.raises(ValueError, match=f"even number of triangles >= 4, got {triangles}"):
        make_house(1, triangles=triangles)
