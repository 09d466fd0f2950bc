"""Odd meshes bake or are refused in one line, and verify agrees with what was baked.

The kinds are those of strangers' files: thin, tiny, open, degenerate, far away, tilted, inverted.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

import navbake
from navbake.baker.core.constants import OPEN_SURFACE as BAKED_OPEN
from navbake.baker.geometry.mesh_parts import split_mesh
from navbake.verifier.mesh_parts import OPEN_SURFACE, split_mesh_parts
from odd_meshes import KINDS, LOWERED

SEEDS = range(6)


def bake_or_refuse(mesh, settings):
    """The grid of a mesh; None where the bake refuses it."""
    try:
        return navbake.bake(mesh, **settings)
    except navbake.NavbakeError:
        return None


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
@pytest.mark.parametrize("settings", [{}, LOWERED], ids=["default", "lowered"])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_verify_agrees_wherever_it_bakes(kind, settings):
    for seed in SEEDS:
        mesh = kind(np.random.default_rng(seed))
        grid = bake_or_refuse(mesh, settings)
        if grid is None:
            continue
        report = navbake.verify(grid, mesh, sample=200)
        assert report.ok, (seed, report.findings[:2])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_both_sides_agree_on_what_meshes_enclose(kind):
    for seed in SEEDS:
        mesh = kind(np.random.default_rng(seed))
        baked = split_mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        closed = baked.faces[baked.closed != BAKED_OPEN]
        parts = split_mesh_parts(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        enclosing = [part.faces for part in parts if part.kind != OPEN_SURFACE]
        faces = np.concatenate(enclosing) if enclosing else np.empty((0, 3), np.int64)
        assert rolled(faces) == rolled(closed)


def rolled(faces):
    """Triangles as a set, each from its lowest corner on."""
    return {min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in faces.tolist()}


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
@pytest.mark.parametrize("height", [0.3, 0.6])
def test_a_plateau_of_a_height_field_is_ground(height):
    heights = np.zeros((101, 101))
    heights[40:60, 40:60] = 1.0
    spec = mujoco.MjSpec()
    spec.add_hfield(
        name="field", nrow=101, ncol=101, size=[5, 5, height, 0.5], userdata=heights.ravel()
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="field", name="terrain")
    grid = navbake.bake(spec)
    place = grid.at((0, 0, 1))
    assert place.free
    assert place.floor == pytest.approx(height)
    assert navbake.verify(grid, spec, sample=2000).ok


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_box_on_a_height_field_is_no_ground():
    spec = mujoco.MjSpec()
    spec.add_hfield(name="field", nrow=3, ncol=3, size=[5, 5, 1, 0.5], userdata=np.zeros(9))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="field")
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.3], pos=[0, 0, 0.3])
    assert not navbake.bake(spec).at((0, 0, 1)).free


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_mesh_whose_steep_facets_are_all_clearly_steep():
    floor = trimesh.creation.box(
        (4.0, 4.0, 0.1), trimesh.transformations.translation_matrix([0, 0, -0.05])
    )
    corners = [(2.1, -2, 0), (2.15, -2, 3), (2.15, 2, 3), (2.1, 2, 0)]
    steep = trimesh.Trimesh(corners, [[0, 2, 1], [0, 3, 2]], process=False)
    for mesh in (
        trimesh.util.concatenate([floor, steep]),
        KINDS[1](np.random.default_rng(20261190)),
    ):
        grid = navbake.bake(mesh, grid={"cell_size": 0.1})
        assert navbake.verify(grid, mesh, sample=200).ok
