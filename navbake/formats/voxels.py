"""Voxel files by their suffix, the table of their IDs beside them, and binvox itself.

binvox is run-length encoded voxels after a text header. A voxel grid ``g[x, y, z]`` of the world, z
up, is written by the rules of the format: ``dim nx nz ny``, y fastest, then z, then x;
``translate`` is the lower corner of the first voxel, ``scale`` the grid's longest side. So a
voxel's centre is ``translate + (i + 0.5) * res`` with ``res = scale / max(dim)``. Version 1 holds 0
and 1, version 2 any byte.

AirSim has its own layout under the same name: x fastest, then z, then y; ``scale`` is one over the
size along x; ``translate`` is half of the size, without the grid's position; a voxel i is sampled
at ``(i - n // 2) * res``, so grids of even counts lie half a voxel off. Its axes are north, east
and up, which is (x, -y, z) here.
"""

import json
import math
import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import FormatError
from navbake.formats.allowance import Allowance, JsonPath, format_value
from navbake.formats.convert import OCTREE_SUFFIXES, VOXEL_SUFFIXES
from navbake.formats.npz import encode_npz, read_npz
from navbake.formats.octomap import encode_octomap, read_octomap
from navbake.formats.source import check_path, format_path, read_bytes, read_header, write_bytes
from navbake.navgrid.lattice import FARTHEST
from navbake.voxels.grid import VoxelGrid, check_three

IdMapping: TypeAlias = Mapping[int, int] | Literal["compact"]
BinvoxLayout: TypeAlias = Literal["auto", "binvox", "airsim"]
LAYOUTS = ("auto", "binvox", "airsim")
MAGIC = b"#binvox"
MOST = 255  # greatest value of a voxel, and most voxels of a run
DECIMALS = 12  # of the numbers in the header
NEAR = 1e-4  # relative; AirSim writes six digits
RULE = "0 is empty; where several meet a voxel, the least ID is its"

# number and type of each header line's numbers: `dim` is nx, nz, ny, `translate` and `scale` are
# in metres, `scale` in AirSim's layout in 1/m
LINES: dict[str, tuple[int, type]] = {
    "#binvox": (1, int),
    "dim": (3, int),
    "translate": (3, float),
    "scale": (1, float),
}
MAY_MISS = {"translate": ["0"] * 3, "scale": ["1"]}  # words of lines that a header may lack


def write_voxels(
    grid: VoxelGrid,
    path: str | PathLike[str],
    *,
    free: bool = False,
    layout: Literal["binvox", "airsim"] = "binvox",
    mapping: IdMapping | None = None,
) -> None:
    """Write a voxel file, and the table of its IDs' names beside it if it has any.

    `path` ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``; the table of `a.npz` is
    `a.npz.names.json`. `free` is for octrees, see `encode_octomap`; `layout` and `mapping` for
    binvox, see `encode_binvox` and `map_ids`. Raises a FormatError if the format can't hold
    the grid.
    """
    suffix = _check_suffix(path)
    if suffix in OCTREE_SUFFIXES:
        write_bytes(encode_octomap(grid, suffix[1:], free=free), path)
        return
    if suffix == ".binvox":
        mapped = map_ids(grid, mapping)
        write_bytes(encode_binvox(mapped, layout), path)
        grid = mapped
    else:
        write_bytes(encode_npz(grid), path)
    if grid.is_segmented:
        ids = {str(number): grid.names[number] for number in sorted(grid.names)}
        table = json.dumps({"rule": RULE, "ids": ids}, indent=2, ensure_ascii=False)
        write_bytes(f"{table}\n".encode(), id_table_path(path))


def read_voxels(path: str | PathLike[str], *, max_voxels: int | None = None) -> VoxelGrid:
    """Read a voxel file, with the table of its IDs if it lies beside it.

    `path` ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``. The grid has `max_voxels` at most; if
    None, 2**31, and no more memory than 256 MiB and 512 bytes for each byte of the file. Raises a
    FormatError if the file is broken, of an unknown format, or needs too much memory.
    """
    suffix = _check_suffix(path)
    if suffix == ".npz":
        return read_npz(path, max_voxels=max_voxels)
    if suffix != ".binvox":
        return read_octomap(path, max_voxels=max_voxels)
    grid = read_binvox(path, max_voxels=max_voxels)
    beside = id_table_path(path)
    if grid.is_segmented and os.path.lexists(beside):
        content, name = read_bytes(beside)
        try:
            grid.names = msgspec.json.decode(content, type=_Names).ids
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            message = f"expected a table of IDs, {format_path(name)} can't be read: {error}"
            raise FormatError(message) from error
    return grid


class _Names(msgspec.Struct):
    """The table of IDs' names in a file."""

    ids: dict[Annotated[int, msgspec.Meta(ge=0, lt=2**32)], str]


def _check_suffix(path: str | PathLike[str]) -> str:
    suffix = Path(check_path(path)).suffix.lower()
    if suffix not in VOXEL_SUFFIXES:
        raise FormatError(f"expected a name that ends in {', '.join(VOXEL_SUFFIXES)}, got {path}")
    return suffix


def id_table_path(path: str | PathLike[str]) -> Path:
    """The path of the table of a file's IDs: ``a.npz.names.json`` beside ``a.npz``."""
    return Path(f"{path}.names.json")


# ---------------------------------------------------------------- binvox


def map_ids(grid: VoxelGrid, mapping: IdMapping | None) -> VoxelGrid:
    """The grid with other IDs, 0 to 255; ``compact`` numbers the existing IDs from 1, in order."""
    if not grid.is_segmented or mapping is None:
        return grid
    present = grid.ids()
    if mapping == "compact":
        ids = {old: new for new, old in enumerate(present, 1)}
    elif isinstance(mapping, Mapping):
        ids = {int(old): int(new) for old, new in mapping.items()}
        missing = [old for old in present if old not in ids]
        if missing:
            raise FormatError(f"the mapping lacks ID {missing[0]}, which the voxels have")
    else:
        raise FormatError(f"expected a mapping of IDs, or 'compact', got {mapping!r}")
    bad = [new for new in ids.values() if not 0 <= new <= MOST]
    if bad:
        remedy = f": {len(present)} IDs occur; write .npz" if mapping == "compact" else ""
        raise FormatError(f"binvox holds values up to {MOST}, and the mapping has {bad[0]}{remedy}")
    return grid.with_ids(ids)


def encode_binvox(grid: VoxelGrid, layout: Literal["binvox", "airsim"] = "binvox") -> bytes:
    """Encode a binvox file: version 1 for voxels without IDs, version 2 for voxels with IDs.

    ``airsim`` is the layout of AirSim's simCreateVoxelGrid, which lacks the grid's position.
    """
    if layout not in LAYOUTS[1:]:
        raise FormatError(f"expected layout binvox or airsim, got {layout!r}")
    values = grid.values
    if grid.is_segmented and int(values.max()) > MOST:
        raise FormatError(
            f"binvox holds IDs up to {MOST}, and these voxels have IDs up to {values.max()}: write "
            f".npz, or give a mapping ('compact', --compact, numbers the {len(grid.ids())} IDs "
            f"that occur from 1)"
        )
    voxels = _in_file_order(values.astype(np.uint8, copy=False), layout == "airsim").ravel()
    nx, ny, nz = grid.shape
    translate = list(grid.origin)
    scale = grid.res * max(grid.shape)
    if layout == "airsim":
        translate = [-n * grid.res / 2 for n in grid.shape]
        scale = 1.0 / (nx * grid.res)
    # so many digits drop the rounding of multiples of the edge; 0 has no minus
    x, y, z, edge = (repr(round(value, DECIMALS) + 0.0) for value in (*translate, scale))
    header = (
        f"#binvox {2 if grid.is_segmented else 1}\ndim {nx} {nz} {ny}\n"
        f"translate {x} {y} {z}\nscale {edge}\ndata\n"
    )
    # pairs of value and count; a run longer than a byte can count is several
    start = np.concatenate([[0], np.flatnonzero(voxels[1:] != voxels[:-1]) + 1])
    length = np.diff(start, append=len(voxels))
    num_pairs = -(-length // MOST)
    pairs = np.full((int(num_pairs.sum()), 2), MOST, dtype=np.uint8)
    pairs[:, 0] = np.repeat(voxels[start], num_pairs)
    pairs[np.cumsum(num_pairs) - 1, 1] = length - MOST * (num_pairs - 1)
    return header.encode() + pairs.tobytes()


def _in_file_order(values: NDArray[np.uint8], is_airsim: bool) -> NDArray[np.uint8]:
    """A view of the voxels in the file's order; filling it fills `values`."""
    if is_airsim:
        return values[:, ::-1].transpose(1, 2, 0)  # east, up, north; east is -y
    return values.transpose(0, 2, 1)


def read_binvox(
    source: str | PathLike[str] | bytes,
    *,
    layout: BinvoxLayout = "auto",
    position: ArrayLike = (0.0, 0.0, 0.0),
    res: float | None = None,
    max_voxels: int | None = None,
) -> VoxelGrid:
    """Read a binvox file, versions 1 and 2.

    Empty runs and comment lines in the header are skipped. Version 1 becomes bool, version 2 IDs
    as uint8; so does a version 1 with other values than 0 and 1, as segmenting simulators write.

    Args:
        source: a path, or a file's content.
        layout: ``auto`` detects AirSim's by its inverted scale, and adds that to the grid's notes.
        position: of AirSim's grid, world frame [m], which its files lack. Its own frame is north,
            east, down; (n, e, d) is (n, -e, -d) here.
        res: edge of AirSim's voxels [m]: its files only have the requested size, which may exceed
            the grid's by a part of a voxel. From the sizes and counts if None.
        max_voxels: most voxels of the grid; 2**31 if None.

    Raises:
        FormatError: it is no binvox file, its header is broken, its data are too few or many, or
            the grid needs more memory than there is.
        ConfigError: the position is invalid.
    """
    if layout not in LAYOUTS:
        raise FormatError(f"expected layout {', '.join(LAYOUTS)}, got {layout!r}")
    data, name = read_bytes(source, begins=MAGIC, expected="a binvox file that begins with #binvox")
    version, dim, translate, scale, end = _read_header(data, name)
    nx, nz, ny = dim
    place = JsonPath(name)
    allowance = Allowance(len(data), "max_voxels", max_voxels)
    pairs = np.frombuffer(data, dtype=np.uint8, offset=end)
    # before any array of the header's size is made
    claimed = math.prod(dim)
    held = int(pairs[1::2].sum(dtype=np.int64))
    if held != claimed or len(pairs) % 2:
        found = "half a run" if len(pairs) % 2 else f"{held} voxels"
        if held != claimed:
            found += ": too many" if held > claimed else ": too few"
        where = f"{name} (dim {' '.join(format_value(n) for n in dim)})"
        raise FormatError(
            f"expected runs of {format_value(claimed)} voxels in {where}, got {found}"
        )
    allowance.take_cells((nx, ny, nz), place)
    allowance.take_array((nx, ny, nz), 2, place)  # in the file's order, then in ours
    is_airsim = layout == "airsim" or (
        layout == "auto" and _looks_like_airsim(dim, translate, scale)
    )
    values = np.empty((nx, ny, nz), dtype=np.uint8)
    order = _in_file_order(values, is_airsim)
    order[...] = np.repeat(pairs[::2], pairs[1::2]).reshape(order.shape)
    notes = []
    if version == 1 and values.max() > 1:
        notes.append(f"{name}: version 1 with values above 1, read as IDs")
    elif version == 1:
        values = values.view(np.bool_)
    if not is_airsim:
        x, y, z = translate
        return VoxelGrid(values=values, origin=(x, y, z), res=scale / max(dim), notes=notes)
    # AirSim cuts counts, it does not round them, so the true edge is the least of these or less
    edges = -2 * np.array(translate) / (nx, ny, nz)
    edge = float(edges.min()) if res is None else float(res)
    if res is not None and not (math.isfinite(edge) and edge > 0):
        raise FormatError(f"expected `res`, the edge of AirSim's voxels, to be > 0 m, got {res}")
    if not edge > 0:
        raise FormatError(f"expected a negative `translate` in AirSim's layout in {name}")
    first = np.array([0 - nx // 2, ny // 2 - (ny - 1), 0 - nz // 2]) * edge  # its middle
    center = check_three(position, "the position to be x, y, z [m]")
    is_unsure = res is None and edges.max() > edge * (1 + NEAR)
    notes.append(
        f"{name}: laid out as AirSim writes it (scale {scale:g} is 1 / size): read as "
        f"north, east, up, voxels of {edge:g} m"
        f"{' at most (give `res`: the sizes are no whole multiples)' if is_unsure else ''}, "
        f"round ({', '.join(f'{p:g}' for p in center)})"
    )
    x, y, z = (center + first - edge / 2).tolist()
    return VoxelGrid(values=values, origin=(x, y, z), res=edge, notes=notes)


def _looks_like_airsim(dim: list[int], translate: list[float], scale: float) -> bool:
    """Whether a header is AirSim's: the scale is 1 / size along x, and not the longest side.

    There, `translate` is minus half of the size. So one edge must fit sizes and counts along all
    axes: ``count = floor(size / edge)``.
    """
    nx, nz, ny = dim
    sizes = -2 * np.array(translate)
    counts = np.array((nx, ny, nz), dtype=np.float64)
    if (sizes <= 0).any() or not math.isclose(scale * sizes[0], 1.0, rel_tol=NEAR):
        return False
    if (sizes / (counts + 1)).max() > (sizes / counts).min() * (1 + NEAR):
        return False
    return not math.isclose(scale / max(dim), sizes[0] / nx, rel_tol=NEAR)


def _read_header(data: bytes, source: str) -> tuple[int, list[int], list[float], float, int]:
    """The numbers of `LINES`, and the offset of the data."""
    lines, found, end = read_header(data, source, LINES, MAY_MISS)
    (version,), dim, translate, (scale,) = found
    unknown = [n for n in lines if n not in LINES and n[:1] not in ("#", "") and n != "data"]
    if unknown:
        raise FormatError(f"unknown line {unknown[0][:40]!r} in the header of {source}")
    if version not in (1, 2):
        raise FormatError(f"expected binvox version 1 or 2, got {version} in {source}")
    if min(dim) < 1:
        raise FormatError(f"expected `dim` of numbers >= 1, got {dim} in {source}")
    if not scale > 0:
        raise FormatError(f"expected `scale` > 0, got {scale:g} in {source}")
    if max(*map(abs, translate), scale) > FARTHEST:
        far = f"({', '.join(f'{v:g}' for v in translate)}) and {scale:g}"
        expected = f"`translate` and `scale` up to {FARTHEST:g} m"
        raise FormatError(f"expected {expected}, got {far} in {source}")
    return version, dim, translate, scale, end
