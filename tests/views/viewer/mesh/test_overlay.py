"""Patches cover each cell with a floor once, at its height; a layer's pixels lie on their cells."""

import io
import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from navbake.views.viewer.mesh import overlay
from navbake.views.viewer.mesh.overlay import draw_overlay, lay_carpet
from navbake.views.viewer.mesh.patches import FLAT, lay_patches
from viewer_scenes import room_exhibit


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32), st.integers(1, 300), st.integers(1, 300), st.integers(0, 4))
def test_each_cell_with_a_floor_is_covered_once_at_its_height(seed, height, width, kind):
    rng = np.random.default_rng(seed)
    floor = rng.integers(0, 4, (height, width)) * np.float32(0.2)
    floor[:, : width // 2] = 1.0
    floor = np.sort(floor, axis=0) if kind > 2 else floor
    floor[rng.random(floor.shape) < 0.1 * kind] = np.nan
    patches = lay_patches(floor.astype(np.float32))
    covered = np.zeros(floor.shape, np.int64)
    drawn = np.full(floor.shape, np.nan)
    for (r0, r1), (c0, c1), z in zip(patches.rows, patches.cols, patches.z, strict=True):
        covered[r0:r1, c0:c1] += 1
        drawn[r0:r1, c0:c1] = z
    has_floor = ~np.isnan(floor)
    assert (covered[has_floor] == 1).all() and (covered <= 1).all()
    assert (np.abs(drawn - floor)[has_floor] <= FLAT + 1e-6).all()


def test_a_flat_floor_takes_few_patches():
    assert len(lay_patches(np.zeros((2000, 2000), np.float32)).z) == 64


def test_a_hilly_floor_is_drawn_coarser_rather_than_in_more_patches():
    floor = np.random.default_rng(0).random((200, 200)).astype(np.float32)
    patches = lay_patches(floor, most=2000)
    assert len(patches.z) <= 2000 and patches.flatness > FLAT


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


@pytest.mark.parametrize("tile", [4096, 16])
def test_a_pixel_lies_on_its_cell(tile, monkeypatch):
    monkeypatch.setattr(overlay, "TILE", tile)
    if tile < 256:
        monkeypatch.setattr("navbake.views.viewer.mesh.patches.LARGEST", 4)
    level = room_exhibit().grid.levels[0]
    rows, cols = np.indices(level.shape)
    rgb = np.dstack([rows, cols, np.zeros_like(rows)]).astype(np.uint8)
    seen = np.zeros(level.shape, np.int64)
    for places, uv, pixels in parse(draw_overlay(lay_carpet(level), rgb)):
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
            assert (found[:, 3] == 255).all()
    np.testing.assert_array_equal(seen, ~np.isnan(level.floor_height))


def test_without_a_scene_there_are_no_holes():
    level = room_exhibit().grid.levels[0]
    floor = level.floor_height.copy()
    floor[0, 0] = np.nan
    holed = level.with_layers(attributes={"floorHeight": floor})
    assert not lay_carpet(holed).shown[0, 0]
    assert lay_carpet(holed, with_holes=False).shown.all()
