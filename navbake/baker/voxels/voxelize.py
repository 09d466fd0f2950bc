"""Voxels of a scene: which boxes of a grid its geoms meet, and which ID each geom's voxels get."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

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
from navbake.formats.convert import OCTREE_SUFFIXES
from navbake.known_names import find_near
from navbake.navgrid.lattice import CELL_SLACK, Lattice
from navbake.threads import run_in_chunks
from navbake.voxels.grid import Placement, VoxelGrid, check_memory, dtype_of, place_grid

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack


Segments = Literal["geom", "body", "top"] | str | Mapping[str, int] | Sequence[str]

KINDS = ("geom", "body", "top")
MOST = 2**32 - 1
OTHER = "other"


class GridOptions(TypedDict, total=False):
    """What `Voxelizer.create` takes by name besides the edge of a voxel."""

    size: Sequence[float] | None
    segments: Segments | None
    align: bool


def create_voxel_grid(
    scene: Any,
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

    Solids, hulls, height fields and closed surfaces count inside, infinite planes behind their
    front; what only touches a voxel (reaches in by less than 0.5 µm) doesn't. Where several
    geoms meet a voxel, the least of their IDs is its.

    Args:
        scene: settings, the path of a YAML or of a scene file, the YAML as a mapping, a scene in
            memory, see `navbake.bake`, or one that is loaded already.
        position: the grid's centre, world frame [m]. With neither this nor counts nor size the
            grid covers the scene's box.
        ncells_x, ncells_y, ncells_z: voxels along each axis, >= 1.
        res: edge of a voxel [m].
        of: a file to write: ``.binvox``, ``.bt``, ``.ot`` or ``.npz``.
        ignore: name patterns of bodies that are left out, with what hangs on them.
        options: `size`, `segments` and `align` of `Voxelizer.create`; where an octree is to be
            written, the grid is aligned unless told otherwise.

    Raises:
        ConfigError: a setting or a number is wrong, or the grid needs more memory than there is.
        SceneError: the scene cannot be read, or holds nothing that counts.
    """
    counts = [n for n in (ncells_x, ncells_y, ncells_z) if n is not None]
    if len(counts) not in (0, 3):
        raise ConfigError(f"expected 3 counts of cells, whole numbers >= 1, got {counts}")
    if options.get("align") is None:
        options["align"] = of is not None and str(of).lower().endswith(OCTREE_SUFFIXES)
    voxelizer = scene if isinstance(scene, Voxelizer) else Voxelizer(scene, ignore=ignore)
    if ignore and voxelizer is scene:
        raise ConfigError("expected `ignore` where the Voxelizer is made, not where it is used")
    grid = voxelizer.create(position, counts or None, res=res, **options)
    if of is not None:
        grid.save(of)
    return grid


class Voxelizer:
    """A scene that stays ready for voxel grids, wherever they lie and however it is posed.

    Attributes:
        scene: the scene as it was loaded.
        shapes: the counted geoms' geometry as it is posed now, world frame.
    """

    def __init__(
        self,
        scene: Any,
        data: Any = None,
        /,
        *,
        ignore: str | Sequence[str] = (),
        exclude: Mapping[str, Any] | None = None,
        robot: Any = None,
        **settings: Unpack[SettingKeywords],
    ) -> None:
        """Load a scene.

        Args:
            scene: see `create_voxel_grid`.
            data: the pose of a scene in memory, see `navbake.bake`.
            ignore: name patterns of bodies that are left out, with what hangs on them.
            exclude, robot: what else is left out, see `navbake.bake`.
            settings: sections of settings in place of the scene's, see `navbake.bake`.

        Raises:
            ConfigError: a setting is wrong, or names a body that isn't there.
            SceneError: the scene cannot be read, or holds nothing that counts.
        """
        self._settings: SceneSettings | None = None
        if isinstance(scene, Scene):
            given = {"ignore": ignore or None, "exclude": exclude, "robot": robot, "data": data}
            for name, value in {**given, **settings}.items():
                if value is not None:
                    raise ConfigError(f"expected `{name}` where the scene is loaded, this one is")
            self.scene = scene
        else:
            config, opened = parse_arguments(scene, data, settings, exclude, robot)
            exclusions = config.scene.exclude
            bodies = [*exclusions.bodies, *([ignore] if isinstance(ignore, str) else ignore)]
            update = {"exclude": exclusions.model_copy(update={"bodies": bodies})}
            self._settings = config.scene.model_copy(update=update if ignore else {})
            config = config.model_copy(update={"scene": self._settings})
            self.scene = load_scene(config, opened=opened)
        self.shapes = self.scene.shapes
        self._labels: dict[Any, Labels] = {}

    def create(
        self,
        position: ArrayLike | None = None,
        cells: Sequence[int] | None = None,
        *,
        res: float,
        size: Sequence[float] | None = None,
        segments: Segments | None = None,
        align: bool = False,
    ) -> VoxelGrid:
        """Make a voxel grid of the scene as it is posed now.

        Args:
            position: its centre, world frame [m].
            cells: voxels along x, y and z, >= 1 each.
            res: edge of a voxel [m].
            size: what it covers along x, y and z [m], in place of `cells`.
            segments: voxels hold IDs of this, see `label_geoms`; None for True and False.
            align: move the grid by half a voxel at most, onto whole multiples of `res`.

        Raises:
            ConfigError: a number is wrong, or the grid needs more memory than there is.
        """
        bounds = self.shapes.bounds
        place = place_grid(position, cells, size, res, bounds, align=align)
        grid = self.fill(place, segments)
        if place.moved > CELL_SLACK * place.res:
            grid.notes.append(
                f"the grid was moved by {place.moved:.3g} m onto whole multiples of its edge"
            )
        return grid

    def fill(self, place: Placement, segments: Segments | None = None) -> VoxelGrid:
        """Make the voxel grid of a given placement.

        Raises:
            ConfigError: `segments` is wrong, or the grid needs more memory than there is.
        """
        ensure_compiled("baker.kernels.voxels.", "baker.kernels.rays.")
        labels = self._label(segments)
        dtype = dtype_of(max(labels.names, default=1))
        # one kernel for all IDs beyond a byte: each dtype costs seconds of compiling
        worked = dtype if dtype == np.uint8 else np.dtype(np.uint32)
        check_memory(place.shape, worked.itemsize + (worked != dtype) * dtype.itemsize)
        x, y, z = place.origin.tolist()
        nx, ny, _ = place.shape
        voxels = Voxels(np.zeros(place.shape, dtype=worked), z, place.res)
        lattice = Lattice(x, y + ny * place.res, place.res, nx, ny)
        shapes = self.shapes
        tiled = tile_shapes(self.shapes, lattice, 0.0)
        nothing = np.zeros(len(self.scene.geoms), dtype=np.bool_)
        meshes = replace(shapes.only(nothing), meshes=shapes.meshes)
        geometry = lattice, shapes.solids, tiled.facets, shapes.planes, tiled.tile_index
        for rows in split_into_row_chunks(lattice):
            hits = cast_columns(replace(tiled, shapes=meshes), rows).hits
            tiles = tiles_of_rows(lattice, rows)
            work = voxels, *geometry, hits, labels.ids.astype(worked)
            run_in_chunks(fill_voxels, len(tiles), *work, begin=tiles.start)
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
        data: Any = None,
    ) -> None:
        """Move the scene's geoms; nothing is loaded.

        Args:
            joints: positions by name [m or rad], all others as the keyframe has them.
            keyframe: a keyframe's name or index; as modelled if None.
            qpos: or all joint positions at once, shape (nq,).
            data: or a mujoco.MjData of this scene whose geoms are placed already.

        Raises:
            ConfigError: there is no such joint or keyframe, or not as many positions.
            SceneError: a geom that counts would stand at no finite place.
        """
        model = self.scene.model
        given = (joints is not None or keyframe is not None, qpos is not None, data is not None)
        if sum(given) != 1:
            raise ConfigError("expected one of joints (with a keyframe or not), qpos and data")
        if isinstance(keyframe, int) and keyframe < 0:
            raise ConfigError(f"expected a keyframe's name or its index >= 0, got {keyframe}")
        if qpos is not None:
            data = data_of_qpos(model, qpos)
        elif data is None:
            if joints is not None and not isinstance(joints, Mapping):
                raise ConfigError(f"expected joints as positions by name, got {joints!r}")
            settings = self._settings or SceneSettings(path=Path(self.scene.id))
            update = {"joints": dict(joints or {}), "keyframe": keyframe}
            data = pose_model(model, settings.model_copy(update=update))
        if not hasattr(data, "geom_xpos"):
            raise ConfigError(f"expected a mujoco.MjData of this scene, got {type(data).__name__}")
        first = self.scene.data
        base = self.scene.shapes
        if data.geom_xpos.shape != first.geom_xpos.shape:
            raise ConfigError(
                f"expected data of this scene's {model.ngeom} geoms, got {len(data.geom_xpos)}"
            )
        pos = np.array(data.geom_xpos)
        flat = np.array(data.geom_xmat)
        counted = np.array([geom.counted for geom in self.scene.geoms])
        if not (np.isfinite(pos[counted]).all() and np.isfinite(flat[counted]).all()):
            raise SceneError(f"a geom of {self.scene.id} would stand at no finite place")
        moved = (pos != first.geom_xpos).any(axis=1) | (flat != first.geom_xmat).any(axis=1)
        moved &= counted
        known = self.scene.selections, self.scene.exact_meshes, np.flatnonzero(moved).tolist()
        shapes, *_ = collect_shapes(model, data, *known, self.scene.meshes)
        self.shapes = base.replaced(shapes, moved)

    def _label(self, segments: Segments | None) -> Labels:
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
        ids: by geom id, shape (n,), uint32; 0 for geoms that don't count.
        names: what each ID stands for.
        notes: what the user should know, one line each.
    """

    ids: NDArray[np.uint32]
    names: dict[int, str]
    notes: list[str]


def label_geoms(scene: Scene, segments: Segments) -> Labels:
    """Give the counted geoms of a scene their IDs.

    `geom` is MuJoCo's geom id plus 1, as in a camera's segmentation image. `body` and `top` (the
    top-most body; a geom of the world stands for itself) count from 1, in the order of the geoms.
    Patterns match the names of a geom, its mesh, its body and the bodies above; the first match
    decides. All other geoms are ``other``, with the greatest of the IDs plus 1.

    Args:
        segments: ``geom``, ``body``, ``top``, a mapping of name patterns (``*``, ``?``, ``[…]``)
            to IDs from 1, or a list of patterns, whose IDs are 1, 2, 3, …. One pattern is a list
            of one.

    Raises:
        ConfigError: it is none of these, or an ID is none.
    """
    if isinstance(segments, str) and segments in KINDS:
        return _label_by_kind(scene, segments)
    patterns = _check_patterns(segments)
    other = max(patterns.values()) + 1
    ids = np.zeros(len(scene.geoms), dtype=np.uint32)
    used = set()
    for geom in _counted(scene):
        names = _known_as(scene.model, geom)
        match = next((p for p in patterns if any(fnmatchcase(n, p) for n in names)), None)
        used.add(match)
        ids[geom] = other if match is None else patterns[match]
    table: dict[int, str] = {}
    for pattern, number in patterns.items():
        table[number] = f"{table[number]}, {pattern}" if number in table else pattern
    if None in used:
        table[other] = OTHER
    known = sorted({name for geom in _counted(scene) for name in _known_as(scene.model, geom)})
    notes = [warn_unmatched("segments", p, known) for p in patterns if p not in used]
    return Labels(ids, table, notes)


def _label_by_kind(scene: Scene, kind: str) -> Labels:
    model = scene.model
    ids = np.zeros(len(scene.geoms), dtype=np.uint32)
    numbers: dict[tuple[str, int], int] = {}
    table: dict[int, str] = {}
    for geom in _counted(scene):
        body = int(model.geom_bodyid[geom])
        if kind == "top":
            body = int(model.body_rootid[body])
        is_geom = kind == "geom" or (kind == "top" and body == 0)
        key = ("geom", geom) if is_geom else ("body", body)
        number = geom + 1 if kind == "geom" else numbers.setdefault(key, len(numbers) + 1)
        ids[geom] = number
        table[number] = all_names(model).geoms[geom].geom if is_geom else body_name(model, body)
    return Labels(ids, table, [])


def _check_patterns(segments: Any) -> dict[str, int]:
    if isinstance(segments, Mapping):
        patterns = dict(segments)
    elif isinstance(segments, str) and (
        set(segments) & set("*?[") or not find_near(segments, KINDS)  # else a slip
    ):
        patterns = {segments: 1}
    elif isinstance(segments, Sequence) and not isinstance(segments, str):
        patterns = {pattern: number for number, pattern in enumerate(segments, 1)}
    else:
        patterns = {}
    if not patterns or not all(isinstance(p, str) and p for p in patterns):
        raise ConfigError(
            f"expected `segments` to be {', '.join(KINDS)}, or name patterns with their IDs, "
            f"got {segments!r}"
        )
    for pattern, number in patterns.items():
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if not whole or not 1 <= number < MOST:
            raise ConfigError(
                f"expected an ID from 1 to {MOST - 1} for segment pattern {pattern!r}, "
                f"got {number!r}"
            )
    return {pattern: int(number) for pattern, number in patterns.items()}


def _counted(scene: Scene) -> list[int]:
    return [geom.id for geom in scene.geoms if geom.counted]


def _known_as(model: Any, geom: int) -> list[str]:
    """The names of a geom, its mesh and all bodies above it."""
    names = all_names(model).geoms[geom]
    bodies = []
    body = int(model.geom_bodyid[geom])
    while body:
        bodies.append(body_name(model, body))
        body = int(model.body_parentid[body])
    return [name for name in (names.geom, names.mesh, *bodies) if name]
