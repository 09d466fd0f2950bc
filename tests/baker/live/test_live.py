"""A Baker's grid is a fresh bake's, bit for bit, whatever moved."""

from __future__ import annotations

import gc
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

import navbake
from differences import first_difference, fresh
from navbake.baker.live import baker as baker_module
from navbake.baker.live import update as module
from project_paths import CONFIGS

sys.path.insert(0, str(Path(__file__).parents[3] / "scripts"))

from sweep_moves import ROOM, make_model, sweep

pytestmark = pytest.mark.filterwarnings("ignore::navbake.BakeWarning")

OPEN_ROOM = """
<mujoco><worldbody>
  <geom name="floor" type="box" pos="2 2 -0.1" size="2 2 0.1"/>
  <geom name="pillar" type="box" pos="0.2 0.2 1.25" size="0.2 0.2 1.25"/>
  <body name="chair" pos="1 1 0.45">
    <freejoint/><geom name="seat" type="box" size="0.2 0.2 0.45"/>
  </body>
  <body name="fixed" pos="3 3 0.3"><geom name="box" type="box" size="0.2 0.2 0.3"/></body>
  <body name="person" mocap="true" pos="3 1 0.6"><geom type="cylinder" size="0.2 0.6"/></body>
</worldbody></mujoco>
"""


def open_room(**settings) -> navbake.Baker:
    return navbake.Baker(mujoco.MjModel.from_xml_string(OPEN_ROOM), **settings)


@pytest.mark.parametrize(
    ("scene", "moves"),
    [("room", 25), ("bridge", 6), ("apartment", 4), ("house", 2), ("random", 15)],
)
def test_updates_equal_fresh_bakes(scene, moves):
    found, reasons = sweep(scene, moves, seed=3)
    assert found is None
    assert scene != "room" or reasons[""] >= moves // 3


def test_only_what_is_near_is_looked_at(monkeypatch):
    baker = open_room()
    looked_at = []
    find_again = module.update_movable_occupants

    def spy(occupants, inputs, **more):
        looked_at.append(len(more["cells"]))
        return find_again(occupants, inputs, **more)

    monkeypatch.setattr(module, "update_movable_occupants", spy)
    changes = baker.update(bodies={"chair": [1.5, 1.2, 0.45]})
    assert changes.reason == ""
    assert len(looked_at) == 1
    assert 0 < looked_at[0] < 400  # of 1,600 cells
    assert first_difference(changes.grid, fresh(baker)) is None


def test_what_moves_indoors_above_heads_leaves_rooms_as_they_are(monkeypatch):
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(ROOM.format(bodies="")))
    with monkeypatch.context() as patch:
        patch.setattr("navbake.baker.bake.stages.find_rooms", None)  # would raise
        for x in (1.0, 1.5):
            changes = baker.update(bodies={"mocap": [x, 1.0, 1.5]})
    assert changes.reason == ""
    assert first_difference(changes.grid, fresh(baker)) is None


def test_changes_list_the_cells_that_differ():
    baker = open_room()
    before = baker.grid
    changes = baker.update(bodies={"chair": [1.5, 1.2, 0.45]})
    assert changes.grid is baker.grid
    assert changes.grid is not before
    differs = before.occupancy != changes.grid.occupancy
    assert np.array_equal(changes.cells[0], np.flatnonzero(differs))
    assert differs.any()
    assert not changes.is_new
    nothing = baker.update()
    assert nothing.cells[0].size == 0


@pytest.mark.parametrize("attributes", [[], ["island"], ["clearance"]])
def test_changes_list_cells_far_from_what_moved(attributes):
    """Doors, layers that follow from the whole grid, and levels that begin in a later row."""
    bodies = """
      <body name="chair" pos="1 1 0.4"><freejoint/><geom type="box" size="0.2 0.2 0.4"/></body>
      <geom name="deck" type="box" pos="4.5 1.5 2.9" size="1.4 1.2 0.1"/>
      <body name="lamp" pos="4 1 3.6"><freejoint/><geom type="box" size="0.2 0.2 0.6"/></body>"""
    model = mujoco.MjModel.from_xml_string(ROOM.format(bodies=bodies))
    settings = {"attributes": attributes, "levels": [{"ground": 0.0}, {"ground": 3.0}]}
    baker = navbake.Baker(model, **settings)
    assert baker.grid.levels[1].height < baker.grid.levels[0].height
    moves = [
        {"bodies": {"chair": [1.3, 1.0, 0.4]}},
        {"bodies": {"lamp": [5.0, 1.2, 3.6]}},
        {"bodies": {"chair": [1.3, 1.4, 0.4]}, "joints": {"hinge": 1.2}},
        {"bodies": {"chair": [2.8, 2.2, 0.4]}},  # into the doorway
        {"bodies": {"chair": [1.0, 4.0, 0.4]}},
    ]
    for move in moves:
        before = baker.grid
        changes = baker.update(**move)
        assert changes.reason == ""
        for cells, old, new in zip(changes.cells, before.levels, changes.grid.levels, strict=True):
            assert cells.tolist() == np.flatnonzero(differing_cells(old, new)).tolist()
        assert first_difference(changes.grid, fresh(baker, **settings)) is None


def differing_cells(old, new):
    """The cells in which any layer of two levels differs."""
    differs = np.zeros(old.shape, dtype=np.bool_)
    for name, layer in old.attributes.items():
        other = new.attributes[name]
        differs |= (layer != other) & ~((layer != layer) & (other != other))
    return differs


def test_garbage_is_collected_while_an_update_bakes_the_whole_scene(monkeypatch):
    """That may take long; an update near what moved waits with it."""
    baker = open_room()
    is_enabled = []

    def watch(owner, name):
        function = getattr(owner, name)

        def spy(*args, **more):
            is_enabled.append((name, gc.isenabled()))
            return function(*args, **more)

        monkeypatch.setattr(owner, name, spy)

    for name in ("update_baked_scene", "open_stages", "build_grid"):
        watch(baker_module, name)
    assert gc.isenabled()
    assert baker.update(bodies={"chair": [1.5, 1.2, 0.45]}).reason == ""
    assert is_enabled == [("update_baked_scene", False), ("build_grid", False)]
    is_enabled.clear()
    baker.model.body("fixed").pos[0] -= 0.3
    assert baker.update().reason
    assert is_enabled == [
        ("update_baked_scene", False), ("open_stages", True), ("build_grid", False),
    ]  # fmt: skip
    assert gc.isenabled()


def test_boxes_of_names_are_measured_where_things_moved(monkeypatch):
    baker = open_room()
    measured = []
    measure_again = module.measure_names

    def spy(shapes, geoms, names):
        measured.append(set(names))
        return measure_again(shapes, geoms, names)

    monkeypatch.setattr(module, "measure_names", spy)
    changes = baker.update(bodies={"chair": [1.5, 1.2, 0.45]})
    assert measured == [{"chair"}]
    boxes = changes.grid.navbake["boxes"]
    assert (
        boxes["chair"][:2]
        != baker.update(bodies={"chair": [1.6, 1.2, 0.45]}).grid.navbake["boxes"]["chair"][:2]
    )
    assert list(boxes.items()) == sorted(boxes.items())
    assert baker.grid.navbake["boxes"] == fresh(baker).navbake["boxes"]


def test_a_snapshot_stays_as_it_was():
    baker = open_room()
    first = baker.grid
    weights = first.weights.copy()
    names = fresh(baker).user_data
    for x in (1.4, 1.8, 2.2):
        baker.update(bodies={"chair": [x, 1.2, 0.45]})
    assert np.array_equal(first.weights, weights)
    # names are made when someone looks at them, of what stood there then
    assert dict(first.user_data) == dict(names)


def test_changes_of_a_snapshot_do_not_reach_the_next_one():
    areas = [{"name": "slow", "cost": 2.0, "polygon": [[1, 1], [2, 1], [2, 2]]}]
    baker = open_room(areas=areas)
    navbake_metadata = baker.grid.navbake
    for box in navbake_metadata["boxes"].values():
        box.append("mine")
    navbake_metadata["rooms"][0]["name"] = "mine"
    navbake_metadata["areas"][0]["name"] = "mine"
    navbake_metadata["settings"]["scene"]["id"] = "mine"
    changes = baker.update(bodies={"person": [2.5, 1.0, 0.6]})
    assert changes.reason == ""
    assert "mine" not in str(changes.grid.navbake)
    assert changes.grid.navbake == fresh(baker, areas=areas).navbake


def test_readers_see_whole_grids_while_one_writes():
    baker = open_room()
    known = [baker.grid]
    broken, stop = [], threading.Event()

    def read():
        while not stop.is_set():
            grid = baker.grid
            if not np.array_equal(np.isinf(grid.weights), grid.occupancy != 0):
                broken.append(grid)

    with ThreadPoolExecutor(1) as pool:
        reader = pool.submit(read)
        try:
            for step in range(20):
                known.append(baker.update(bodies={"chair": [1 + step * 0.05, 1.2, 0.45]}).grid)
        finally:
            stop.set()
    reader.result()  # or what it raised
    assert not broken
    assert len({id(grid) for grid in known}) == len(known)


@pytest.mark.parametrize("name", ["box", "seat"])
def test_a_geom_vanishes_and_appears(name):
    baker = open_room()
    geom = baker.model.geom(name).id
    occupied = int(baker.grid.occupancy.sum())
    for shown in (0, 1):
        baker.model.geom_contype[geom] = shown
        baker.model.geom_conaffinity[geom] = shown
        changes = baker.update()
        # `box` stands, `seat` can move
        assert changes.reason == ("'box', which stands, has changed" if name == "box" else "")
        assert first_difference(changes.grid, fresh(baker)) is None
        assert list(changes.grid.navbake["boxes"]) == sorted(changes.grid.navbake["boxes"])
        assert (int(changes.grid.occupancy.sum()) == occupied) == bool(shown)


def test_a_body_leaves_the_grid_and_comes_back():
    settings = {"grid": {"bounds": [0, 0, 4, 4]}}
    baker = open_room(**settings)
    for place in ([30.0, 1.0, 0.45], [1.0, 2.0, 0.45]):
        changes = baker.update(bodies={"chair": place})
        assert first_difference(changes.grid, fresh(baker, **settings)) is None


def test_a_mocap_body_and_a_door_follow():
    bodies = (
        '<body name="thing" pos="1 1 0.4"><freejoint/><geom type="box" size="0.2 0.2 0.4"/></body>'
    )
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(ROOM.format(bodies=bodies)))
    for update in ({"bodies": {"mocap": [2, 2, 0.6]}}, {"joints": {"hinge": 1.2}}):
        changes = baker.update(**update)
        assert first_difference(changes.grid, fresh(baker)) is None
        assert changes.cells[0].size > 0
    assert [door.id for door in baker.grid.doors] == ["door"]


def test_a_data_is_followed():
    baker = open_room()
    data = mujoco.MjData(baker.model)
    data.qpos[0] += 0.5
    changes = baker.update(data)
    assert first_difference(changes.grid, fresh(baker)) is None
    assert changes.cells[0].size > 0


def test_a_finder_moves_to_the_new_grid():
    baker = open_room()
    finder = navbake.PathFinder(baker.grid)
    assert finder.is_navigable([2.0, 2.0, 0.0])
    grid = baker.update(bodies={"chair": [2.0, 2.0, 0.45]}).grid
    assert finder.is_navigable([2.0, 2.0, 0.0])
    finder.use(grid)
    assert not finder.is_navigable([2.0, 2.0, 0.0])
    assert finder.find_path([1.0, 2.0, 0.0], [3.5, 2.0, 0.0]) is not None


@pytest.mark.parametrize("agent", [None, navbake.Agent("robot", radius=0.2)])
def test_a_follower_drives_round_what_an_update_has_moved(agent):
    baker = open_room()
    finder = navbake.PathFinder(baker.grid, agent=agent)
    start, goal = [1.0, 2.0, 0.0], [3.5, 2.0, 0.0]
    follower = finder.follow(finder.find_path(start, goal))
    assert follower.command(start, 0.0).forward > 0.0
    finder.use(baker.update(bodies={"chair": [2.0, 2.0, 0.45]}).grid)
    follower.command(start, 0.0)
    assert follower.num_replans == 1
    assert finder.is_navigable(follower.path.at(np.linspace(0.0, 4.0, 99))).all()


def test_rugs_that_cover_the_floor_leave_the_ground_where_it_is():
    rugs = "".join(
        f'<body name="rug_{k}" pos="{x} {y} 0.5" quat="1 1 0 0"><freejoint/>'
        '<geom type="box" size="0.5 0.5 0.02"/></body>'
        for k, (x, y) in enumerate((x, y) for x in (0.9, 2, 3.1) for y in (0.9, 2, 3.1))
    )
    xml = OPEN_ROOM.replace("</worldbody>", f"{rugs}</worldbody>")
    settings = {"grid": {"bounds": [0, 0, 4, 4]}}
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(xml), **settings)
    for k in range(9):
        x, y = 0.9 + 1.1 * (k // 3), 0.9 + 1.1 * (k % 3)
        changes = baker.update(bodies={f"rug_{k}": [x, y, 0.02, 1, 0, 0, 0]})
        assert first_difference(changes.grid, fresh(baker, **settings)) is None
        assert changes.reason == ""
    assert baker.grid.navbake["levels"][0]["ground"] == 0.0


def test_a_row_of_boxes_cuts_off_a_part_and_is_no_wall():
    boxes = "".join(
        f'<body name="box_{k}" pos="{0.2 + 0.4 * k} 30 0.5"><freejoint/>'
        '<geom type="box" size="0.2 0.2 0.5"/></body>'
        for k in range(10)
    )
    xml = OPEN_ROOM.replace("</worldbody>", f"{boxes}</worldbody>")
    settings = {"grid": {"bounds": [0, 0, 4, 4]}}
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(xml), **settings)
    rooms = baker.grid.rooms
    for rows in ((3.6, 30), (2.6, 1.4), (3.2, 3.5)):
        for y in rows:
            places = {f"box_{k}": [0.2 + 0.4 * k, y, 0.5] for k in range(10)}
            changes = baker.update(bodies=places)
            assert changes.reason == ""
            assert first_difference(changes.grid, fresh(baker, **settings)) is None
            assert baker.grid.rooms == rooms


def test_a_result_is_one_line():
    baker = open_room()
    changes = baker.update(bodies={"chair": [2.0, 2.0, 0.45]})
    num_cells = len(changes.cells[0])
    text = f"Changes('scene', {num_cells} changed cells, update in {changes.seconds:.3f} s)"
    assert str(changes) == repr(changes) == text
    baker.model.geom_size[baker.model.geom("pillar").id, 0] += 0.3
    text = repr(baker.update())
    assert "whole bake in " in text and text.endswith(" s, 'pillar', which stands, has changed)")
    assert "\n" not in text


HINGES = """
<mujoco><worldbody>
  <geom name="floor" type="box" pos="2 2 -0.1" size="2 2 0.1"/>
  <body name="flap" pos="1 1 0.5"><joint type="hinge" axis="0 0 1"/><geom size="0.1"/></body>
  <body name="lid" pos="2 1 0.5">
    <joint name="hinge_lid" type="hinge" axis="0 0 1"/><geom size="0.1"/>
  </body>
  <body name="ball" pos="3 1 0.5"><freejoint/><geom size="0.1"/></body>
  <body name="arm" pos="3 3 0.5">
    <joint name="lift" type="slide" axis="0 0 1"/><joint name="turn" type="hinge" axis="0 0 1"/>
    <geom size="0.1"/>
  </body>
</worldbody></mujoco>
"""


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("lid", "'lid' is moved by its joint 'hinge_lid'; it has hinge_lid, lift, turn, joint 0, "),
        ("flap", "'flap' is moved by its joint 'joint 0'; it has joint 0, hinge_lid, lift, turn, "),
        ("ball", "'ball' is a body with a free joint, write bodies={'ball': [x, y, z]}"),
        ("arm", "it has hinge_lid, lift, turn, joint 0, joint 2"),
        ("hinge_lad", "did you mean 'hinge_lid'? it has hinge_lid, lift, turn, joint 0, joint 2"),
    ],
)
def test_a_joint_that_is_not_there_is_told_with_that_of_its_body(name, hint):
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(HINGES))
    with pytest.raises(navbake.QueryError) as caught:
        baker.update(joints={name: 0.1})
    assert f"no joint {name!r} in the scene: {hint}" in str(caught.value)
    assert (caught.value.key, caught.value.value) == ("joints", name)


BAD = {
    "no body 'chiar'.*did you mean 'chair'": {"bodies": {"chiar": [0, 0, 0]}},
    "pose of body 'chair', got NaN": {"bodies": {"chair": [0, np.nan, 0]}},
    "expected x, y, z .* of body 'chair'": {"bodies": {"chair": [0, 0]}},
    "quaternion of body 'chair' that is not 0": {"bodies": {"chair": [0, 0, 0, 0, 0, 0, 0]}},
    "body 'fixed' can't be placed: it has no free joint": {"bodies": {"fixed": [0, 0, 0]}},
    "no joint 'hinge' in the scene": {"joints": {"hinge": 0.1}},
}


@pytest.mark.parametrize("message", BAD)
def test_wrong_poses_are_refused(message):
    baker = open_room()
    before = baker.grid
    with pytest.raises(navbake.QueryError, match=message):
        baker.update(**BAD[message])
    assert baker.grid is before
    assert first_difference(baker.update().grid, before) is None


def test_a_data_of_another_model_is_refused():
    baker = open_room()
    more = OPEN_ROOM.replace('<body name="fixed"', '<geom size="0.1"/><body name="fixed"')
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(more))
    with pytest.raises(navbake.ConfigError, match=r"ngeom = 5.*got 6"):
        baker.update(data)
    data = mujoco.MjData(baker.model)
    data.qpos[1] = np.nan
    with pytest.raises(navbake.QueryError, match="pose of body 'chair', got NaN"):
        baker.update(data)


def test_after_a_pose_without_a_floor_all_is_baked_again():
    model, _ = make_model("bridge")
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="floor"><freejoint/>'
        '<geom type="box" size="2 2 0.1"/></body></worldbody></mujoco>'
    )
    baker = navbake.Baker(model)
    before = baker.grid
    with pytest.raises(navbake.SceneError, match="no floor"):
        baker.update(bodies={"floor": [0, 0, 0, 0.7071, 0.7071, 0, 0]})
    assert baker.grid is before
    changes = baker.update(bodies={"floor": [0, 0, 0, 1, 0, 0, 0]})
    assert changes.reason
    assert first_difference(changes.grid, fresh(baker)) is None


def test_who_writes_to_a_grids_weights_changes_no_other_grid():
    baker = open_room()
    baker.grid.weights[:] = -1.0
    for x in (1.5, 1.8, 1.5):
        changes = baker.update(bodies={"chair": [x, 1.2, 0.45]})
        assert changes.reason == ""
        assert first_difference(changes.grid, fresh(baker)) is None
        changes.grid.weights[:] = -1.0


def test_links_and_areas_follow_what_moves():
    model = mujoco.MjModel.from_xml_path(str(CONFIGS / "scenes" / "tower.xml"))
    config = yaml.safe_load((CONFIGS / "tower.yaml").read_text())
    config["areas"].append({"name": "belt", "geoms": ["crate_1"], "cost": 2})
    given = {"name": "hoist", "stops": [[5.0, 1.0, 0.0], [5.0, 1.0, 3.2]]}
    settings = {key: config[key] for key in ("agent", "grid", "agents", "areas")}
    settings["links"] = [*config["links"], given]
    baker = navbake.Baker(model, **settings)
    names = [link.name for link in baker.grid.links]
    assert names == ["hoist", "lift_a", "lift_b", "drop 1"]
    for joints in ({"lift_a": 3.2}, {"lift_a": 6.4, "lift_b": 1.1}, {"lift_b": 3.2}):
        changes = baker.update(joints=joints)
        assert first_difference(changes.grid, fresh(baker, **settings)) is None
        assert [link.name for link in changes.grid.links] == names
    crate = model.geom("crate_1")
    model.geom_pos[crate.id] = [4.9, 1.1, 0.45]  # onto a stop, and with it the area
    changes = baker.update()
    assert first_difference(changes.grid, fresh(baker, **settings)) is None
    assert np.count_nonzero(changes.grid.levels[0].area_index == 3) > 50
    assert "stop 1, (5.00, 1.00, 0.00), is blocked" in changes.grid.warnings[-1]
