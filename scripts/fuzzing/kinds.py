"""The kinds of inputs: how each is made, what reads it, and what is done with what was read."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec

from fuzzing import grids, maps, meshes, scenes, settings, voxel_files
from fuzzing.kind import Kind
from navbake.config.settings import load_config
from navbake.formats.maps.nav2 import read_nav2
from navbake.formats.maps.procthor import read_procthor
from navbake.formats.navgrid import read_navgrid
from navbake.formats.npz import read_npy
from navbake.formats.shapes.geojson import read_room_outlines
from navbake.views.report.report import read_verification

make_bt, make_ot = (partial(voxel_files.make_octree, kind) for kind in ("bt", "ot"))

KINDS: dict[str, Kind] = {
    "navgrid": Kind(grids.make_navgrid, read_navgrid, grids.check_grid),
    "grid-npz": Kind(grids.make_grid_npz, grids.read_grid_archive, grids.check_grid),
    "binvox": Kind(voxel_files.make_binvox, voxel_files.read_twice, voxel_files.check_voxels),
    "bt": Kind(make_bt, voxel_files.read_some, voxel_files.check_voxels),
    "ot": Kind(make_ot, voxel_files.read_some, voxel_files.check_voxels),
    "npz": Kind(voxel_files.make_npz, voxel_files.read_some, voxel_files.check_voxels),
    "names": Kind(voxel_files.make_names, voxel_files.read_some, voxel_files.check_voxels),
    "nav2": Kind(maps.make_nav2, read_nav2, grids.check_grid),
    "procthor": Kind(maps.make_procthor, read_procthor, grids.check_grid),
    "descriptor": Kind(maps.make_descriptor, maps.read_descriptor, maps.check_descriptor),
    "explored": Kind(maps.make_explored, read_npy),
    "yaml": Kind(settings.make_yaml, load_config, settings.check_config),
    "geojson": Kind(settings.make_geojson, read_room_outlines),
    "manifest": Kind(settings.make_manifest, settings.read_manifest, settings.check_jobs),
    "index": Kind(settings.make_index, settings.read_rows, settings.check_rows),
    "verification": Kind(
        settings.make_verification, read_verification, settings.check_verification
    ),
    "ply": Kind(meshes.make_ply, meshes.read_mesh, meshes.check_parts),
    "stl": Kind(meshes.make_stl, meshes.read_mesh, meshes.check_parts),
    "obj": Kind(meshes.make_obj, meshes.read_mesh, meshes.check_parts),
    "gltf": Kind(meshes.make_gltf, meshes.read_mesh, meshes.check_parts),
    "dae": Kind(meshes.make_dae, meshes.read_mesh, meshes.check_parts),
    "mjcf": Kind(scenes.make_mjcf, scenes.read_scene, scenes.check_scene, scenes.compile_alone),
    "urdf": Kind(scenes.make_urdf, scenes.read_scene, scenes.check_scene, scenes.compile_alone),
    "mjb": Kind(scenes.make_mjb, scenes.read_scene, scenes.check_scene, scenes.compile_alone),
}
SKIPPED: dict[str, str] = {}  # kinds that can't be made here, and why
if find_spec("pyarrow") is None:
    SKIPPED["parquet"] = 'it needs pyarrow: pip install "navbake[batch]"'
else:
    from fuzzing import tables

    KINDS["parquet"] = Kind(tables.make_parquet, settings.read_manifest, settings.check_jobs)
