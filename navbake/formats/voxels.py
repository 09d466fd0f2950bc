"""Reads and writes voxel files of all formats, and the tables beside them that name voxels' IDs.

An ID says what a voxel belongs to. The format binvox is in this module itself: run-length encoded
voxels after a text header. A voxel grid ``g[x, y, z]`` of the world, z up, is written by the rules
of the format: ``dim nx nz ny``, y fastest, then z, then x; ``translate`` is the lower corner of the
first voxel, ``scale`` the grid's longest side. So a voxel's centre is
``translate + (i + 0.5) * res`` with ``res = scale / max(dim)``. Version 1 holds 0 and 1, version 2
any byte.

AirSim writes a different layout under the same name: x fastest, then z, then y. ``scale`` is one
over the size along x. ``translate`` is minus half of the size; the grid's position is missing. Of n
voxels along an axis, voxel i is sampled at ``(i - n // 2) * res``, so a grid of an even count lies
half a voxel off. The axes are north, east and up, which is (x, -y, z) here.
"""

import json
import math
import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import FormatError
from navbake.formats.allowance import Allowance, JsonPath, format_value
from navbake.formats.format_table import OCTREE_SUFFIXES, VOXEL_SUFFIXES
from navbake.formats.npz import encode_npz, read_npz
from navbake.formats.octomap import encode_octomap, read_octomap
from navbake.formats.source import (
    Files,
    check_path,
    format_path,
    read_bytes,
    read_header,
    write_bytes,
    write_files,
)
from navbake.lengths import format_position
from navbake.navgrid.lattice import MAX_COORDINATE
from navbake.types import Float
from navbake.voxels.grid import AIRSIM_SHIFT, VoxelGrid, check_three_numbers

IdMapping: TypeAlias = Mapping[int, int] | Literal["compact"]
BinvoxLayout: TypeAlias = Literal["auto", "binvox", "airsim"]
BINVOX_LAYOUTS = ("auto", "binvox", "airsim")
MAGIC = b"#binvox"
MAX_BYTE_VALUE = 255  # largest value of a voxel, and most voxels of a run
DECIMALS = 12  # of the numbers in the header
AIRSIM_TOLERANCE = 1e-4  # relative error of numbers in AirSim's headers, which have six digits
ID_RULE = "0 is empty; where several meet a voxel, the least ID is its"

# first word of a header line -> count and type of its numbers. `dim` is nx, nz, ny; `translate` and
# `scale` are in metres, but in AirSim's layout, `scale` is in 1/m
HEADER_LINES: dict[str, tuple[int, type]] = {
    "#binvox": (1, int),
    "dim": (3, int),
    "translate": (3, float),
    "scale": (1, float),
}
# first word of a line that a header may lack -> the words that count then
DEFAULT_LINES = {"translate": ["0"] * 3, "scale": ["1"]}


def write_voxels(
    grid: VoxelGrid,
    path: str | PathLike[str],
    *,
    free: bool = False,
    layout: Literal["binvox", "airsim"] = "binvox",
    mapping: IdMapping | None = None,
) -> None:
    """Write a voxel file, and the table of its IDs' names beside it if it has any.

    Args:
        grid: the voxels.
        path: the file, which ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``. The table of
            ``a.npz`` is ``a.npz.names.json``.
        free: for an octree, whether to write voxels that are known to be empty as free. If False,
            they are unknown in the file, as are all voxels that aren't occupied.
        layout: the layout of a binvox, see `encode_binvox`.
        mapping: the new IDs in a binvox, see `map_ids`.

    Raises:
        FormatError: the format can't hold the grid, or a file can't be written.
    """
    suffix = _check_suffix(path)
    if suffix in OCTREE_SUFFIXES:
        write_bytes(encode_octomap(grid, suffix[1:], free=free), path)
        return
    if suffix == ".binvox":
        if layout == "airsim":
            grid.notes.append(_describe_airsim_position(grid, path))
        grid = map_ids(grid, mapping)
        content = encode_binvox(grid, layout)
    else:
        content = encode_npz(grid)
    files: Files = {}
    if grid.is_segmented:
        ids = {str(voxel_id): grid.names[voxel_id] for voxel_id in sorted(grid.names)}
        table_text = json.dumps({"rule": ID_RULE, "ids": ids}, indent=2, ensure_ascii=False)
        files[id_table_path(path)] = f"{table_text}\n".encode()
    files[Path(path)] = content  # after the table that is read with it
    write_files(files)


def read_voxels(path: str | PathLike[str], *, max_voxels: int | None = None) -> VoxelGrid:
    """Read a voxel file, with the table of its IDs if it lies beside it.

    Args:
        path: the file, which ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``.
        max_voxels: the largest number of voxels. If None: 2**31, and at most 256 MiB of memory plus
            512 bytes for each byte of the file.

    Returns:
        The voxels.

    Raises:
        FormatError: the file is broken, of an unknown format, or needs too much memory.

    Example:
        >>> voxels = navbake.load_voxels("room.binvox")
        >>> voxels.shape
        (120, 80, 50)
    """
    suffix = _check_suffix(path)
    if suffix == ".npz":
        return read_npz(path, max_voxels=max_voxels)
    if suffix != ".binvox":
        return read_octomap(path, max_voxels=max_voxels)
    grid = read_binvox(path, max_voxels=max_voxels)
    table_path = id_table_path(path)
    if grid.is_segmented and os.path.lexists(table_path):
        content, name = read_bytes(table_path)
        try:
            grid.names = msgspec.json.decode(content, type=_IdTable).ids
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            expected = "a table of IDs"
            message = f"expected {expected}, {format_path(name)} can't be read: {error}"
            raise FormatError(message, path=name, expected=expected) from error
    return grid


class _IdTable(msgspec.Struct):
    """The table of IDs' names in a file."""

    ids: dict[Annotated[int, msgspec.Meta(ge=0, lt=2**32)], str]


def _check_suffix(path: str | PathLike[str]) -> str:
    """Return the suffix of a voxel file in lower case; raise a FormatError for any other."""
    suffix = Path(check_path(path)).suffix.lower()
    if suffix not in VOXEL_SUFFIXES:
        expected = f"a name that ends in {', '.join(VOXEL_SUFFIXES)}"
        raise FormatError(f"expected {expected}, got {path}", path=str(path), expected=expected)
    return suffix


def id_table_path(path: str | PathLike[str]) -> Path:
    """Return the path of the table of a file's IDs: ``a.npz.names.json`` beside ``a.npz``."""
    return Path(f"{path}.names.json")


# ---------------------------------------------------------------- binvox


def map_ids(grid: VoxelGrid, mapping: IdMapping | None) -> VoxelGrid:
    """Give the IDs of voxels new numbers from 0 to 255, as a binvox needs them.

    Args:
        grid: the voxels.
        mapping: existing ID -> new ID; ``compact`` numbers the existing IDs from 1, in order; None
            keeps them.

    Returns:
        A new grid; the grid itself if it has no IDs, or if `mapping` is None.

    Raises:
        FormatError: the mapping lacks an ID, or has one above 255.
    """
    if not grid.is_segmented or mapping is None:
        return grid
    present_ids = grid.ids()
    if mapping == "compact":
        new_ids = {old_id: new_id for new_id, old_id in enumerate(present_ids, 1)}
    elif isinstance(mapping, Mapping):
        new_ids = {int(old_id): int(new_id) for old_id, new_id in mapping.items()}
        missing_ids = [old_id for old_id in present_ids if old_id not in new_ids]
        if missing_ids:
            message = f"the mapping lacks ID {missing_ids[0]}, which the voxels have"
            raise FormatError(message, key="mapping", value=missing_ids[0])
    else:
        expected = "a mapping of IDs, or 'compact'"
        raise FormatError(
            f"expected {expected}, got {mapping!r}", key="mapping", value=mapping, expected=expected
        )
    invalid_ids = [new_id for new_id in new_ids.values() if not 0 <= new_id <= MAX_BYTE_VALUE]
    if invalid_ids:
        message = (
            f"binvox holds values up to {MAX_BYTE_VALUE}, and the mapping has {invalid_ids[0]}"
        )
        if mapping == "compact":
            message += f": {len(present_ids)} IDs occur; write .npz"
        raise FormatError(message, key="mapping", value=invalid_ids[0])
    return grid.with_ids(new_ids)


def encode_binvox(grid: VoxelGrid, layout: Literal["binvox", "airsim"] = "binvox") -> bytes:
    """Encode a binvox file: version 1 for voxels without IDs, version 2 for voxels with IDs.

    Args:
        grid: the voxels, with IDs up to 255 if they have any.
        layout: ``binvox``, or ``airsim`` for the layout of AirSim's simCreateVoxelGrid, which
            lacks the grid's position.

    Returns:
        The content of the file.

    Raises:
        FormatError: the layout is unknown, or an ID is above 255.
    """
    if layout not in BINVOX_LAYOUTS[1:]:
        raise FormatError(
            f"expected layout binvox or airsim, got {layout!r}",
            key="layout",
            value=layout,
            expected="binvox or airsim",
        )
    values = grid.values
    max_id = int(values.max()) if grid.is_segmented else 0
    if max_id > MAX_BYTE_VALUE:
        raise FormatError(
            f"binvox holds IDs up to {MAX_BYTE_VALUE}, and these voxels have IDs up to {max_id}: "
            f"write .npz, or give a mapping ('compact', --compact, numbers the "
            f"{len(grid.ids())} IDs that occur from 1)"
        )
    file_values = _view_in_file_order(values.astype(np.uint8, copy=False), layout == "airsim")
    flat_values = file_values.ravel()
    nx, ny, nz = grid.shape
    translate = list(grid.origin)
    scale = grid.res * max(grid.shape)
    if layout == "airsim":
        translate = [-n * grid.res / 2 for n in grid.shape]
        scale = 1.0 / (nx * grid.res)
    translate_text = " ".join(map(_format_number, translate))
    header = (
        f"#binvox {2 if grid.is_segmented else 1}\ndim {nx} {nz} {ny}\n"
        f"translate {translate_text}\nscale {_format_number(scale)}\ndata\n"
    )
    # pairs of value and count; a run longer than a byte can count takes several pairs
    run_start = np.concatenate([[0], np.flatnonzero(flat_values[1:] != flat_values[:-1]) + 1])
    run_length = np.diff(run_start, append=len(flat_values))
    num_pairs_of_run = -(-run_length // MAX_BYTE_VALUE)
    pairs = np.full((int(num_pairs_of_run.sum()), 2), MAX_BYTE_VALUE, dtype=np.uint8)
    pairs[:, 0] = np.repeat(flat_values[run_start], num_pairs_of_run)
    pairs[np.cumsum(num_pairs_of_run) - 1, 1] = run_length - MAX_BYTE_VALUE * (num_pairs_of_run - 1)
    return header.encode() + pairs.tobytes()


def find_airsim_position(grid: VoxelGrid) -> Float:
    """Compute the position that a file of AirSim's layout lacks, from the voxels themselves.

    `read_binvox` needs it as `position`, to put the voxels of the file back where they were. It is
    the position for which AirSim's simCreateVoxelGrid makes this grid.

    Args:
        grid: the voxels.

    Returns:
        World x, y, z [m], shape (3,), float64. In AirSim's own frame, it is (x, -y, -z).
    """
    is_even = np.array(grid.shape) % 2 == 0
    position: Float = grid.bounds.mean(axis=0) - is_even * AIRSIM_SHIFT * grid.res
    return position


def _describe_airsim_position(grid: VoxelGrid, path: str | PathLike[str]) -> str:
    """Describe where a file of AirSim's layout lies, which the file doesn't hold."""
    x, y, z = (_format_number(round(value, 9)) for value in find_airsim_position(grid).tolist())
    return (
        f"{path}: AirSim's layout holds no position: x is north, -y is east, and its readers find "
        f"the voxels round x, y, z = ({x}, {y}, {z})"
    )


def _format_number(value: float) -> str:
    """Format a number of the header without the rounding noise of multiples, and 0 for -0.0."""
    return repr(round(value, DECIMALS) + 0.0)


def _view_in_file_order(values: NDArray[np.uint8], is_airsim: bool) -> NDArray[np.uint8]:
    """Return a view of `values` with the axes in the file's order; writing it changes `values`."""
    if is_airsim:
        return values[:, ::-1].transpose(1, 2, 0)  # east, up, north; east is -y
    return values.transpose(0, 2, 1)


def read_binvox(
    source: str | PathLike[str] | bytes,
    *,
    layout: BinvoxLayout = "auto",
    position: ArrayLike = (0.0, 0.0, 0.0),
    voxel_edge: float | None = None,
    max_voxels: int | None = None,
) -> VoxelGrid:
    """Read a binvox file, versions 1 and 2.

    Empty runs, and comment lines in the header, are skipped. Version 1 is read as bool, version 2
    as IDs, uint8. A version 1 with values besides 0 and 1, which simulators with segmentation
    write, is read as IDs, too.

    Args:
        source: a path, or a file's content.
        layout: ``binvox``, ``airsim`` or ``auto``, which detects AirSim's layout by its inverted
            scale and adds a note to the grid's notes.
        position: the position of AirSim's grid, which its files lack, world frame [m].
            AirSim's frame is north, east, down: its (n, e, d) is (n, -e, -d) here.
        voxel_edge: the edge of AirSim's voxels [m], `res` of the grid. AirSim's files lack it: they
            have the size that was asked for, which may exceed the voxels by less than one. If None,
            the edge is computed from this size and the counts of voxels.
        max_voxels: the largest number of voxels, see `read_voxels`.

    Returns:
        The voxels; their notes state what the file doesn't determine.

    Raises:
        FormatError: the file is no binvox, its header is broken, its data are too few or many, or
            the grid needs more memory than there is.
        ConfigError: the position is invalid.
    """
    if layout not in BINVOX_LAYOUTS:
        expected = ", ".join(BINVOX_LAYOUTS)
        raise FormatError(
            f"expected layout {expected}, got {layout!r}",
            key="layout",
            value=layout,
            expected=expected,
        )
    data, name = read_bytes(
        source, beginnings=MAGIC, expected="a binvox file that begins with #binvox"
    )
    header = _read_binvox_header(data, name)
    dim = header.dim
    nx, nz, ny = dim
    place = JsonPath(name)
    allowance = Allowance(len(data), "max_voxels", max_voxels)
    pairs = np.frombuffer(data, dtype=np.uint8, offset=header.data_offset)
    # checked before any array of the header's size is made
    num_voxels = math.prod(dim)
    num_voxels_in_runs = int(pairs[1::2].sum(dtype=np.int64))
    if num_voxels_in_runs != num_voxels or len(pairs) % 2:
        actual_text = "half a run" if len(pairs) % 2 else f"{num_voxels_in_runs} voxels"
        if num_voxels_in_runs != num_voxels:
            actual_text += ": too many" if num_voxels_in_runs > num_voxels else ": too few"
        place_text = f"{name} (dim {' '.join(format_value(count) for count in dim)})"
        expected = f"runs of {format_value(num_voxels)} voxels"
        raise FormatError(
            f"expected {expected} in {place_text}, got {actual_text}",
            path=name,
            value=actual_text,
            expected=expected,
        )
    allowance.take_cells((nx, ny, nz), place)
    allowance.take_array((nx, ny, nz), 2, place)  # in the file's order, then in ours
    is_airsim = layout == "airsim" or (layout == "auto" and _is_airsim_header(header))
    values = np.empty((nx, ny, nz), dtype=np.uint8)
    file_values = _view_in_file_order(values, is_airsim)
    file_values[...] = np.repeat(pairs[::2], pairs[1::2]).reshape(file_values.shape)
    notes = []
    if header.version == 1 and values.max() > 1:
        notes.append(f"{name}: version 1 with values above 1, read as IDs")
    elif header.version == 1:
        values = values.view(np.bool_)
    if not is_airsim:
        x, y, z = header.translate
        edge = header.scale / max(dim)
        return VoxelGrid(values=values, origin=(x, y, z), res=edge, notes=notes)

    # AirSim cuts counts, it does not round them, so the true edge is the least of these or less
    edges_along_axes = -2 * np.array(header.translate) / (nx, ny, nz)
    edge = float(edges_along_axes.min()) if voxel_edge is None else float(voxel_edge)
    if voxel_edge is not None and not (math.isfinite(edge) and edge > 0):
        message = f"expected `voxel_edge` of AirSim's voxels to be > 0 m, got {voxel_edge}"
        raise FormatError(message, key="voxel_edge", value=voxel_edge, expected="a number > 0")
    if not edge > 0:
        message = f"expected a negative `translate` in AirSim's layout in {name}"
        raise FormatError(message, path=name, key="translate", value=header.translate)
    # The middle of the first voxel, from the grid's position, which is the middle of voxel n // 2
    # of n. AirSim counts the voxels along y from the other side.
    first_index = np.array([-(nx // 2), ny // 2 - (ny - 1), -(nz // 2)])
    first_middle = first_index * edge
    center = check_three_numbers(position, "the position to be x, y, z [m]")
    is_edge_uncertain = voxel_edge is None and edges_along_axes.max() > edge * (
        1 + AIRSIM_TOLERANCE
    )
    hint = " at most (give `voxel_edge`: the sizes are no whole multiples)"
    notes.append(
        f"{name}: laid out as AirSim writes it (scale {header.scale:g} is 1 / size): read as "
        f"north, east, up, voxels of {edge:g} m{hint if is_edge_uncertain else ''}, "
        f"round ({format_position(center)})"
    )
    x, y, z = (center + first_middle - edge / 2).tolist()
    return VoxelGrid(values=values, origin=(x, y, z), res=edge, notes=notes)


class _BinvoxHeader(NamedTuple):
    """The numbers of a binvox header."""

    version: int
    dim: list[int]  # nx, nz, ny
    translate: list[float]
    scale: float
    data_offset: int  # [bytes]


def _is_airsim_header(header: _BinvoxHeader) -> bool:
    """Whether a header is AirSim's, and no ordinary one.

    In AirSim's layout, `translate` is minus half of the size, and the scale is 1 / size along x. An
    edge of voxels must exist for which ``count = floor(size / edge)`` along all axes. If the header
    fits both layouts with the same edge, it counts as an ordinary one.
    """
    nx, nz, ny = header.dim
    sizes = -2 * np.array(header.translate)
    counts = np.array((nx, ny, nz), dtype=np.float64)
    if (sizes <= 0).any():
        return False
    if not math.isclose(header.scale * sizes[0], 1.0, rel_tol=AIRSIM_TOLERANCE):
        return False
    if (sizes / (counts + 1)).max() > (sizes / counts).min() * (1 + AIRSIM_TOLERANCE):
        return False
    edge = header.scale / max(header.dim)  # of a binvox
    return not math.isclose(edge, sizes[0] / nx, rel_tol=AIRSIM_TOLERANCE)


def _read_binvox_header(data: bytes, source: str) -> _BinvoxHeader:
    """Read the header of a binvox, and check its numbers."""
    lines, numbers, data_offset = read_header(data, source, HEADER_LINES, DEFAULT_LINES)
    version = numbers[0][0]
    dim = numbers[1]
    translate = numbers[2]
    scale = numbers[3][0]
    unknown_lines = [
        word
        for word in lines
        if word not in HEADER_LINES and word[:1] not in ("#", "") and word != "data"
    ]
    if unknown_lines:
        message = f"unknown line {unknown_lines[0][:40]!r} in the header of {source}"
        raise FormatError(message, path=source, key=unknown_lines[0])
    if version not in (1, 2):
        message = f"expected binvox version 1 or 2, got {version} in {source}"
        raise FormatError(message, path=source, key="#binvox", value=version, expected="1 or 2")
    if min(dim) < 1:
        message = f"expected `dim` of numbers >= 1, got {dim} in {source}"
        raise FormatError(message, path=source, key="dim", value=dim, expected="numbers >= 1")
    if not scale > 0:
        message = f"expected `scale` > 0, got {scale:g} in {source}"
        raise FormatError(message, path=source, key="scale", value=scale, expected="a number > 0")
    if max(*map(abs, translate), scale) > MAX_COORDINATE:
        actual_text = f"({', '.join(f'{value:g}' for value in translate)}) and {scale:g}"
        expected = f"`translate` and `scale` up to {MAX_COORDINATE:g} m"
        message = f"expected {expected}, got {actual_text} in {source}"
        raise FormatError(message, path=source, expected=expected)
    return _BinvoxHeader(version, dim, translate, scale, data_offset)
