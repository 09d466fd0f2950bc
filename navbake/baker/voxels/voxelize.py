"""Make voxel grids of scenes: find which voxels geoms meet, and give them the geoms' IDs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.baker.bake.arguments import parse_arguments
from navbake.baker.columns.columns import (
    cast_columns,
    split_into_row_chunks,
    tile_shapes,
    tiles_of_rows,
)
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.names import all_names, body_name, warn_unmatched
from navbake.baker.scene.pose import data_of_qpos, pose_model
from navbake.baker.scene.scene import Scene, load_scene
from navbake.baker.voxels.voxel_kernels import Voxels, fill_voxels
from navbake.compiled import ensure_compiled
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, SceneError
from navbake.formats.format_table import OCTREE_SUFFIXES
from navbake.known_names import find_similar_names
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.lattice import CELL_SLACK, Lattice
from navbake.threads import run_in_chunks
from navbake.voxels.grid import (
    Placement,
    VoxelGrid,
    VoxelLayout,
    check_memory,
    dtype_of,
    place_grid,
)

if TYPE_CHECKING:  # mujoco and trimesh are slow to load
    import mujoco
    from typing_extensions import Unpack  # `typing` has it from Python 3.11 on

    from navbake.baker.scene.model import SceneInput


Segments = Literal["geom", "body", "top"] | str | Mapping[str, int] | Sequence[str]
"""What the IDs of voxels stand for, see `label_geoms`."""

ID_KINDS = ("geom", "body", "top")
MAX_ID = 2**32 - 1  # the IDs of patterns are below this, as unmatched geoms get one ID more
UNMATCHED_NAME = "other"  # name of the ID of geoms that no pattern matches


class GridOptions(TypedDict, total=False):
    """The options of `create_voxel_grid`, which it passes on to `Voxelizer.create`.

    Attributes:
        size: the grid's lengths along x, y and z [m], in place of the numbers of voxels.
        segments: the kind of thing that an ID stands for, see `label_geoms`.
        align: whether to move the grid onto whole multiples of the edge of a voxel.
        layout: ``airsim`` to place voxels where AirSim samples them.
    """

    size: Sequence[float] | None
    segments: Segments | None
    align: bool
    layout: VoxelLayout


def create_voxel_grid(
    scene: SceneInput | Scene | Voxelizer,
    position: ArrayLike | None = None,
    ncells_x: int | None = None,
    ncells_y: int | None = None,
    ncells_z: int | None = None,
    res: float = 0.1,
    of: str | PathLike[str] | None = None,
    *,
    ignore: str | Sequence[str] = (),
    **options: Unpack[GridOptions],
) -> VoxelGrid:
    """Make the voxel grid of a scene: True where a geom that counts meets a voxel.

    The inside of solids, hulls, height fields and closed surfaces is filled, and so is the space
    behind infinite planes. A geom that only touches a voxel, reaching in by less than 0.5 µm, does
    not meet it. Where several geoms meet a voxel, it gets the least of their IDs.

    Args:
        scene: the path of a scene file or of a YAML file with settings, the settings as a mapping
            or a `BakeConfig`, or a scene in memory, see `navbake.bake`; or a `Voxelizer`.
        position: the grid's centre, shape (3,), world frame [m]. Without position, numbers of
            voxels and size, the grid covers the scene's box.
        ncells_x, ncells_y, ncells_z: voxels along each axis, >= 1.
        res: edge of a voxel [m].
        of: a file to write: ``.binvox``, ``.bt``, ``.ot`` or ``.npz``.
        ignore: name patterns of bodies that are left out, with all bodies below them.
        options: `size`, `segments`, `align` and `layout` of `Voxelizer.create`; if an octree is
            to be written, `align` is True by default.

    Returns:
        The grid; its values are bool, or IDs if `segments` are given.

    Raises:
        ConfigError: a setting or a number is wrong, or the grid needs more memory than there is.
        SceneError: the scene cannot be read, or holds nothing that counts.

    Example:
        >>> import navbake
        >>> scene = navbake.samples.path("apartment")
        >>> grid = navbake.create_voxel_grid(scene, res=0.05, of="apartment.binvox")
    """
    voxel_counts = [
        num_cells for num_cells in (ncells_x, ncells_y, ncells_z) if num_cells is not None
    ]
    if len(voxel_counts) not in (0, 3):
        raise ConfigError(f"expected 3 counts of cells, whole numbers >= 1, got {voxel_counts}")
    if options.get("align") is None:
        options["align"] = of is not None and str(of).lower().endswith(OCTREE_SUFFIXES)
    voxelizer = scene if isinstance(scene, Voxelizer) else Voxelizer(scene, ignore=ignore)
    if ignore and voxelizer is scene:
        raise ConfigError("expected `ignore` where the Voxelizer is made, not where it is used")
    grid = voxelizer.create(position, voxel_counts or None, res=res, **options)
    if of is not None:
        grid.save(of)
    return grid


class Voxelizer:
    """Makes voxel grids of a scene that is loaded once, at any place and in any pose.

    Attributes:
        scene: the scene as it was loaded.
        shapes: the geometry of the geoms that count, in the current pose, world frame.

    Example:
        >>> import navbake
        >>> voxelizer = navbake.Voxelizer(navbake.samples.path("apartment"))
        >>> grid = voxelizer.create((0.0, 0.0, 1.0), (64, 64, 32), res=0.05)
    """

    def __init__(
        self,
        scene: SceneInput | Scene,
        data: MjDataLike | None = None,
        /,
        *,
        ignore: str | Sequence[str] = (),
        exclude: Mapping[str, object] | None = None,
        robot: object = None,
        **settings: Unpack[SettingKeywords],
    ) -> None:
        """Load a scene.

        Args:
            scene: the path of a scene or of settings, settings, or a scene in memory, as for
                `navbake.bake`.
            data: the pose of a scene in memory, see `navbake.bake`.
            ignore: name patterns of bodies that are left out, with all bodies below them.
            exclude, robot: bodies and geoms that are left out, too, see `navbake.bake`.
            settings: sections of settings in place of the scene's, see `navbake.bake`.

        Raises:
            ConfigError: a setting is wrong, or names a body that isn't there.
            SceneError: the scene cannot be read, or holds nothing that counts.
        """
        self._settings: SceneSettings | None = None
        if isinstance(scene, Scene):
            arguments = {"ignore": ignore or None, "exclude": exclude, "robot": robot, "data": data}
            for name, argument in {**arguments, **settings}.items():
                if argument is not None:
                    raise ConfigError(f"expected `{name}` where the scene is loaded, this one is")
            self.scene = scene
        else:
            config, scene_model = parse_arguments(scene, data, settings, exclude, robot)
            self._settings = config.scene
            if ignore:
                exclusions = config.scene.exclude
                patterns = [ignore] if isinstance(ignore, str) else ignore
                excluded_bodies = [*exclusions.bodies, *patterns]
                extended_exclusions = exclusions.model_copy(update={"bodies": excluded_bodies})
                self._settings = config.scene.model_copy(update={"exclude": extended_exclusions})
            config = config.model_copy(update={"scene": self._settings})
            self.scene = load_scene(config, scene_model=scene_model)
        self.shapes = self.scene.shapes
        self._labels: dict[str, Labels] = {}  # ``repr(segments)`` -> labels

    def create(
        self,
        position: ArrayLike | None = None,
        cells: Sequence[int] | None = None,
        *,
        res: float,
        size: Sequence[float] | None = None,
        segments: Segments | None = None,
        align: bool = False,
        layout: VoxelLayout = "binvox",
    ) -> VoxelGrid:
        """Make a voxel grid of the scene in its current pose.

        Args:
            position: the grid's centre, shape (3,), world frame [m]. Without position, `cells` and
                `size`, the grid covers the scene's box.
            cells: numbers of voxels along x, y and z, >= 1 each.
            res: edge of a voxel [m].
            size: the grid's lengths along x, y and z [m], in place of `cells`.
            segments: the kind of thing that an ID stands for, see `label_geoms`; if None, the
                values are True and False.
            align: move the grid by half a voxel at most, onto whole multiples of `res`.
            layout: ``airsim`` to place voxels where AirSim's ``simCreateVoxelGrid`` samples them
                round the centre: of n voxels along an axis, the middle of voxel ``n // 2`` is
                there, counted along x, -y (its east) and z. So even counts are half a voxel off.

        Returns:
            The grid.

        Raises:
            ConfigError: a number is wrong, or the grid needs more memory than there is.
        """
        placement = place_grid(
            position, cells, size, res, self.shapes.bounds, align=align, layout=layout
        )
        grid = self.fill(placement, segments)
        if placement.alignment_shift > CELL_SLACK * placement.res:
            grid.notes.append(
                f"the grid was moved by {placement.alignment_shift:.3g} m onto whole multiples of "
                "its edge"
            )
        return grid

    def fill(self, place: Placement, segments: Segments | None = None) -> VoxelGrid:
        """Make the voxel grid at a place, with the scene in its current pose.

        Args:
            place: where the grid lies, and its numbers of voxels.
            segments: the kind of thing that an ID stands for, see `label_geoms`; if None, the
                values are True and False.

        Returns:
            The grid.

        Raises:
            ConfigError: `segments` is wrong, or the grid needs more memory than there is.
        """
        ensure_compiled("baker.voxels.voxel_kernels.", "baker.columns.ray_kernels.")
        labels = self._get_labels(segments)
        dtype = dtype_of(max(labels.names, default=1))
        # one kernel for all IDs beyond a byte: each dtype costs seconds of compiling
        kernel_dtype = dtype if dtype == np.uint8 else np.dtype(np.uint32)
        copy_itemsize = dtype.itemsize if kernel_dtype != dtype else 0
        check_memory(place.shape, kernel_dtype.itemsize + copy_itemsize)
        x, y, z = place.origin.tolist()
        nx, ny, _ = place.shape
        voxels = Voxels(np.zeros(place.shape, dtype=kernel_dtype), z, place.res)
        lattice = Lattice(x, y + ny * place.res, place.res, nx, ny)
        shapes = self.shapes
        tiled_shapes = tile_shapes(shapes, lattice, 0.0)
        # only closed surfaces are filled by the hits of lines: solids and planes are left out
        no_geom_mask = np.zeros(len(self.scene.geoms), dtype=np.bool_)
        mesh_shapes = replace(shapes.only(no_geom_mask), meshes=shapes.meshes)
        tiled_meshes = replace(tiled_shapes, shapes=mesh_shapes)
        for rows in split_into_row_chunks(lattice):
            tile_range = tiles_of_rows(lattice, rows)
            run_in_chunks(
                fill_voxels,
                len(tile_range),
                voxels,
                lattice,
                shapes.solids,
                tiled_shapes.facets,
                shapes.planes,
                tiled_shapes.tile_index,
                cast_columns(tiled_meshes, rows).hits,
                labels.ids.astype(kernel_dtype),
                begin=tile_range.start,
            )
        values = voxels.values.astype(dtype, copy=False)
        return VoxelGrid(
            values=values.view(np.bool_) if segments is None else values,
            origin=(x, y, z),
            res=place.res,
            names=labels.names,
            notes=list(labels.notes),
        )

    def set_pose(
        self,
        *,
        joints: Mapping[str, float | list[float]] | None = None,
        keyframe: str | int | None = None,
        qpos: ArrayLike | None = None,
        data: MjDataLike | None = None,
    ) -> None:
        """Change the pose of the scene without loading it again.

        Args:
            joints: positions by joint name [m or rad]; those of other joints are the keyframe's.
            keyframe: a keyframe's name or index; as modelled if None.
            qpos: all joint positions, shape (nq,), in place of `joints` and `keyframe`.
            data: a mujoco.MjData of this scene in which geom poses are already computed; replaces
                the other arguments.

        Raises:
            ConfigError: a joint or keyframe does not exist, or the number of positions is wrong.
            SceneError: a geom that counts would be at infinite or NaN coordinates.
        """
        model = self.scene.model
        has_joints_or_keyframe = joints is not None or keyframe is not None
        if has_joints_or_keyframe + (qpos is not None) + (data is not None) != 1:
            raise ConfigError("expected one of joints (with a keyframe or not), qpos and data")
        if isinstance(keyframe, int) and keyframe < 0:
            raise ConfigError(f"expected a keyframe's name or its index >= 0, got {keyframe}")
        if qpos is not None:
            data = data_of_qpos(model, qpos)
        elif data is None:
            if joints is not None and not isinstance(joints, Mapping):
                raise ConfigError(f"expected joints as positions by name, got {joints!r}")
            settings = self._settings or SceneSettings(path=Path(self.scene.id))
            pose_settings = {"joints": dict(joints or {}), "keyframe": keyframe}
            data = pose_model(model, settings.model_copy(update=pose_settings))
        if not hasattr(data, "geom_xpos"):
            raise ConfigError(f"expected a mujoco.MjData of this scene, got {type(data).__name__}")
        loaded_data = self.scene.data
        if data.geom_xpos.shape != loaded_data.geom_xpos.shape:
            raise ConfigError(
                f"expected data of this scene's {model.ngeom} geoms, got {len(data.geom_xpos)}"
            )
        geom_positions = np.array(data.geom_xpos)
        geom_rotations = np.array(data.geom_xmat)
        is_counted = np.array([geom.counted for geom in self.scene.geoms])
        if not (
            np.isfinite(geom_positions[is_counted]).all()
            and np.isfinite(geom_rotations[is_counted]).all()
        ):
            raise SceneError(f"a geom of {self.scene.id} would be at infinite or NaN coordinates")
        has_moved = (geom_positions != loaded_data.geom_xpos).any(axis=1)
        has_moved |= (geom_rotations != loaded_data.geom_xmat).any(axis=1)
        has_moved &= is_counted
        shapes, _, _ = collect_shapes(
            model,
            data,
            self.scene.selections,
            self.scene.exact_meshes,
            geom_ids=np.flatnonzero(has_moved).tolist(),
            meshes=self.scene.meshes,
        )
        self.shapes = self.scene.shapes.with_replaced(shapes, has_moved)

    def _get_labels(self, segments: Segments | None) -> Labels:
        """Return the geoms' IDs for `segments`; if None, all geoms have the ID 1.

        They are computed once for each value of `segments`.
        """
        if segments is None:
            return Labels(np.ones(len(self.scene.geoms), dtype=np.uint32), {}, [])
        key = repr(segments)
        if key not in self._labels:
            self._labels[key] = label_geoms(self.scene, segments)
        return self._labels[key]


# ---------------------------------------------------------------- what the IDs stand for


@dataclass(frozen=True)
class Labels:
    """The IDs of a scene's geoms.

    Attributes:
        ids: ID of each geom, by geom id, shape (n,), uint32; 0 for geoms that don't count.
        names: ID -> name of the geom, body or pattern that it stands for.
        notes: remarks for the user, one line each.
    """

    ids: NDArray[np.uint32]
    names: dict[int, str]
    notes: list[str]


def label_geoms(scene: Scene, segments: Segments) -> Labels:
    """Assign IDs to the geoms of a scene that count.

    With ``geom``, the ID is MuJoCo's geom id plus 1, as in a camera's segmentation image. With
    ``body`` and ``top`` (the top-most body; a geom of the world stands for itself), IDs count from
    1, in the order of the geoms. Patterns match the names of a geom, its mesh, its body and the
    bodies above; the first match decides. Geoms without a match are ``other``; their ID is the
    greatest of the patterns' plus 1.

    Args:
        scene: the scene.
        segments: ``geom``, ``body``, ``top``, a mapping of name patterns (``*``, ``?``, ``[…]``) to
            IDs from 1, or a list of patterns, whose IDs are 1, 2, 3, …. A single pattern is the
            same as a list of that pattern alone.

    Returns:
        The ID of each geom, the names of the IDs, and a note for each pattern without a match.

    Raises:
        ConfigError: `segments` is none of these, or an ID is out of range.
    """
    if isinstance(segments, str) and segments in ID_KINDS:
        return _label_by_kind(scene, segments)
    patterns = _check_patterns(segments)
    unmatched_id = max(patterns.values()) + 1
    ids = np.zeros(len(scene.geoms), dtype=np.uint32)
    matched_patterns = set()
    has_unmatched = False
    for geom in _list_counted_geoms(scene):
        pattern = _find_first_match(patterns, _list_names(scene.model, geom))
        if pattern is None:
            has_unmatched = True
            ids[geom] = unmatched_id
        else:
            matched_patterns.add(pattern)
            ids[geom] = patterns[pattern]
    segment_names: dict[int, str] = {}
    for pattern, segment_id in patterns.items():
        segment_names[segment_id] = (
            f"{segment_names[segment_id]}, {pattern}" if segment_id in segment_names else pattern
        )
    if has_unmatched:
        segment_names[unmatched_id] = UNMATCHED_NAME
    names_in_scene = sorted(
        {name for geom in _list_counted_geoms(scene) for name in _list_names(scene.model, geom)}
    )
    notes = [
        warn_unmatched("segments", pattern, names_in_scene)
        for pattern in patterns
        if pattern not in matched_patterns
    ]
    return Labels(ids, segment_names, notes)


def _find_first_match(patterns: Iterable[str], names: Sequence[str]) -> str | None:
    """Return the first pattern that matches any of the names."""
    for pattern in patterns:
        if any(fnmatchcase(name, pattern) for name in names):
            return pattern
    return None


def _label_by_kind(scene: Scene, id_kind: str) -> Labels:
    """Give an ID to each geom, body or top-most body.

    Args:
        scene: the scene.
        id_kind: the kind of thing that gets IDs: ``geom``, ``body`` or ``top``.
    """
    model = scene.model
    ids = np.zeros(len(scene.geoms), dtype=np.uint32)
    id_of_segment: dict[tuple[str, int], int] = {}
    segment_names: dict[int, str] = {}
    for geom in _list_counted_geoms(scene):
        body = int(model.geom_bodyid[geom])
        if id_kind == "top":
            body = int(model.body_rootid[body])
        is_geom = id_kind == "geom" or (id_kind == "top" and body == 0)
        if id_kind == "geom":
            segment_id = geom + 1
        else:
            segment = ("geom", geom) if is_geom else ("body", body)
            segment_id = id_of_segment.setdefault(segment, len(id_of_segment) + 1)
        ids[geom] = segment_id
        name = all_names(model).geoms[geom].geom if is_geom else body_name(model, body)
        segment_names[segment_id] = name
    return Labels(ids, segment_names, [])


def _check_patterns(segments: object) -> dict[str, int]:
    """Return name pattern -> ID; raise a ConfigError if `segments` are no name patterns."""
    if isinstance(segments, Mapping):
        patterns = dict(segments)
    elif isinstance(segments, str) and (
        # a name that is nearly one of ID_KINDS is a typing error
        set(segments) & set("*?[") or not find_similar_names(segments, ID_KINDS)
    ):
        patterns = {segments: 1}
    elif isinstance(segments, Sequence) and not isinstance(segments, str):
        patterns = {pattern: segment_id for segment_id, pattern in enumerate(segments, 1)}
    else:
        patterns = {}
    if not patterns or not all(isinstance(key, str) and key for key in patterns):
        raise ConfigError(
            f"expected `segments` to be {', '.join(ID_KINDS)}, or name patterns with their IDs, "
            f"got {segments!r}"
        )
    for pattern, segment_id in patterns.items():
        is_integer = isinstance(segment_id, int | np.integer) and not isinstance(segment_id, bool)
        if not is_integer or not 1 <= segment_id < MAX_ID:
            raise ConfigError(
                f"expected an ID from 1 to {MAX_ID - 1} for segment pattern {pattern!r}, "
                f"got {segment_id!r}"
            )
    return {pattern: int(segment_id) for pattern, segment_id in patterns.items()}


def _list_counted_geoms(scene: Scene) -> list[int]:
    """Return the ids of the geoms that count."""
    return [geom.id for geom in scene.geoms if geom.counted]


def _list_names(model: mujoco.MjModel, geom: int) -> list[str]:
    """Return the names of a geom, of its mesh and of all bodies above it."""
    geom_names = all_names(model).geoms[geom]
    bodies_above = []
    body = int(model.geom_bodyid[geom])
    while body:
        bodies_above.append(body_name(model, body))
        body = int(model.body_parentid[body])
    return [name for name in (geom_names.geom, geom_names.mesh, *bodies_above) if name]
