"""Triangles are what other readers take them for; a layer's pixels lie on their cells; a click
finds the cell below the nearest thing that is shown.
"""

import io
import json
import struct
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import navbake
from grid_maps import level_from
from navbake.views.layers import FLAT_TOLERANCE, LAYER_LIFT
from navbake.views.viewer.meshes import (
    Surface,
    ViewRay,
    draw_overlay,
    make_floor_surface,
    make_glb,
)
from navbake.views.viewer.view import make_view_state
from navbake.views.viewer.view_state import first_choices
from viewer_scenes import room_view_state

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 3]], dtype=np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


def read(content):
    return trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False)


def test_triangles_and_colors_are_read_as_they_were_written():
    colors = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 1, 1]], dtype=np.float32)
    (mesh,) = read(make_glb([Surface(VERTICES, FACES, colors=colors)])).geometry.values()
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.faces, FACES)


def test_a_picture_lies_as_it_was_laid():
    picture = np.arange(4 * 2 * 3, dtype=np.uint8).reshape(2, 4, 3)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32)
    content = make_glb([Surface(VERTICES, FACES, uv=uv, texture=0)], {0: picture})
    (mesh,) = read(content).geometry.values()
    np.testing.assert_array_equal(np.asarray(mesh.visual.material.baseColorTexture), picture)
    # trimesh counts v from below
    np.testing.assert_allclose(mesh.visual.uv, np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1))


def test_nothing_is_a_file_too():
    empty = Surface(VERTICES, FACES[:0])
    assert not read(make_glb([empty])).geometry
    assert len(make_glb([])) % 4 == 0


def test_what_shines_through_says_so():
    clear = np.tile(np.array([1, 1, 1, 0.5], dtype=np.float32), (4, 1))
    for part, mode in (
        (Surface(VERTICES, FACES), b"OPAQUE"),
        (Surface(VERTICES, FACES, colors=clear), b"BLEND"),
        (Surface(VERTICES, FACES, opacity=0.5), b"BLEND"),
    ):
        assert b'"alphaMode":"' + mode in make_glb([part])


def floors_of(floor_surface, level):
    """How often each cell is covered, and the height of the floor_surface there."""
    covered, height = np.zeros(level.shape, np.int64), np.full(level.shape, np.nan)
    xy = level.lattice.positions(*np.indices(level.shape))
    for corners in floor_surface.vertices.reshape(-1, 4, 3).astype(np.float64):
        low, high = corners[0], corners[2]
        inside = ((xy > low[:2]) & (xy < high[:2])).all(axis=-1)
        covered += inside
        # a rectangle is a plane
        share = (xy[inside] - low[:2]) / (high - low)[:2]
        rise = np.stack([corners[1, 2] - low[2], corners[3, 2] - low[2]])
        height[inside] = low[2] + share @ rise
    return covered, height


@settings(max_examples=25)
@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(1, 40), st.integers(0, 4))
def test_each_cell_with_a_floor_is_covered_once_at_its_height(seed, height, width, kind):
    rng = np.random.default_rng(seed)
    floor = rng.integers(0, 4, (height, width)) * np.float32(0.2)
    floor[:, : width // 2] = 1.0
    floor = np.sort(floor, axis=0) if kind > 2 else floor
    floor[rng.random(floor.shape) < 0.1 * kind] = np.nan
    level = level_from("\n".join(["." * width] * height))
    level.attributes["floorHeight"] = floor.astype(np.float32)
    covered, drawn = floors_of(make_floor_surface(level), level)
    has_floor = ~np.isnan(floor)
    np.testing.assert_array_equal(covered, has_floor)
    assert (
        np.abs(drawn - LAYER_LIFT - FLAT_TOLERANCE - level.floor)[has_floor]
        <= FLAT_TOLERANCE + 1e-4
    ).all()
    covered, _ = floors_of(make_floor_surface(level, with_holes=False), level)
    assert (covered == 1).all()


def test_a_flat_floor_and_a_ramp_take_few_rectangles_and_hills_are_drawn_coarser():
    level = level_from("\n".join(["." * 200] * 200))
    floor = level.attributes["floorHeight"]
    floor[:] = 0
    assert len(make_floor_surface(level).vertices) == 4
    floor[:] = np.arange(200) * 0.02
    assert len(make_floor_surface(level).vertices) < 100
    floor[:] = np.random.default_rng(0).random(floor.shape)
    assert len(make_floor_surface(level, max_rectangles=2000).vertices) <= 4 * 2000


def parse(content):
    length = struct.unpack_from("<I", content, 12)[0]
    document, data = json.loads(content[20 : 20 + length]), content[28 + length :]

    def view(number):
        entry = document["bufferViews"][number]
        return data[entry["byteOffset"] : entry["byteOffset"] + entry["byteLength"]]

    for primitive in document["meshes"][0]["primitives"]:
        arrays = [primitive["attributes"]["POSITION"], primitive["attributes"]["TEXCOORD_0"]]
        places, uv = (
            np.frombuffer(view(document["accessors"][a]["bufferView"]), np.float32) for a in arrays
        )
        image = document["images"][document["textures"][primitive["material"]]["source"]]
        pixels = np.asarray(Image.open(io.BytesIO(view(image["bufferView"]))))
        yield places.reshape(-1, 4, 3), uv.reshape(-1, 4, 2), pixels


def test_a_pixel_lies_on_its_cell():
    level = room_view_state().grid.levels[0]
    rows, cols = np.indices(level.shape)
    rgb = np.dstack([rows, cols, np.zeros_like(rows)]).astype(np.uint8)
    seen = np.zeros(level.shape, np.int64)
    for places, uv, pixels in parse(draw_overlay(make_floor_surface(level), rgb)):
        for corner, at in zip(places, uv, strict=True):
            (x0, y0), (x1, y1) = corner[:, :2].min(axis=0), corner[:, :2].max(axis=0)
            xy = level.lattice.positions(rows, cols)
            inside = (xy[..., 0] > x0) & (xy[..., 0] < x1) & (xy[..., 1] > y0) & (xy[..., 1] < y1)
            seen += inside
            share = (xy[inside] - [x0, y1]) / [x1 - x0, y0 - y1]
            low, high = at.min(axis=0), at.max(axis=0)
            place = (low + share * (high - low)) * pixels.shape[1::-1]
            col, row = place.astype(int).T
            found = pixels[row, col]
            np.testing.assert_array_equal(found[:, 0], rows[inside])
            np.testing.assert_array_equal(found[:, 1], cols[inside])
    np.testing.assert_array_equal(seen, ~np.isnan(level.floor_height))


@pytest.fixture(scope="module")
def room():
    return room_view_state()


def down(x, y):
    return ViewRay((x, y, 10), (0, 0, -1))


def pick_in(view_state, ray, **choices):
    chosen = replace(first_choices(view_state.grid), cut=None, **choices)
    return view_state.click(chosen, ray).inspected


def test_the_floor_is_a_cell_and_a_table_is_the_cell_below(room):
    found = pick_in(room, down(-1.03, 1.04))
    assert found.geom is None
    assert found.cell == room.grid.cell_at((-1.03, 1.04))
    np.testing.assert_allclose(found.position, (-1.03, 1.04, 0), atol=1e-6)
    table = pick_in(room, down(1.03, 0.52))
    assert room.drawing(first_choices(room.grid)).names[table.geom] == "table"
    assert table.position[2] == pytest.approx(0)


def test_nothing_is_nothing(room):
    assert pick_in(room, down(50, 50)) is None
    assert pick_in(room, ViewRay((0, 0, 10), (0, 0, 1))) is None


def test_what_is_not_drawn_is_not_clicked(room):
    assert pick_in(room, down(1.03, 0.52), with_scene=False).geom is None


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_clicks_meet_what_mujocos_rays_meet():
    scene = navbake.samples.path("apartment").parent / "scenes" / "apartment.xml"
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view_state = make_view_state(navbake.bake(model, grid={"cell_size": 0.2}), model)
    rng = np.random.default_rng(0)
    is_box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    met = 0
    for _ in range(80):
        origin = np.array([*rng.uniform(-4, 4, 2), 6.0])
        direction = np.array([*rng.uniform(-0.5, 0.5, 2), -1.0])
        geom = np.zeros(1, dtype=np.int32)
        mujoco.mj_ray(model, data, origin, direction, None, 1, -1, geom, None)
        found = pick_in(view_state, ViewRay(origin, direction))
        # floors are met as cells, and round things have corners here
        if geom[0] >= 0 and is_box[geom[0]] and found is not None and found.geom is not None:
            if model.geom_type[found.geom] == mujoco.mjtGeom.mjGEOM_SDF:
                continue  # the vase: MuJoCo 3's rays pass through it
            met += 1
            assert found.geom == geom[0]
    assert met > 20


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_of_two_storeys_the_one_below_the_click_counts():
    house = navbake.samples.path("house")
    view_state = make_view_state(navbake.bake(house), house)
    grid = view_state.grid
    upper, lower = grid.levels[1], grid.levels[0]
    floors = np.argwhere((np.abs(upper.floor - upper.ground) < 0.01)[: lower.height, : lower.width])
    row, col = floors[len(floors) // 2]
    x, y = upper.lattice.positions(row, col)
    ray = ViewRay((x, y, upper.ground + 0.5), (0, 0, -1))
    assert pick_in(view_state, ray).cell.level == 1
    assert pick_in(view_state, ray, levels=(0,), with_scene=False).cell.level == 0
