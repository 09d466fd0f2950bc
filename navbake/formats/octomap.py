"""OctoMap trees: voxels as octrees, ``.bt`` (occupied, free, unknown) and ``.ot`` (log-odds).

A tree has depth 16; a voxel's key is ``floor(coordinate / res) + 32768`` along each axis. So the
corners of voxels are multiples of `res`, at most 32768 of them from the world's origin.
Children that are equal are pruned. Files are the same, byte for byte, as OctoMap's own.

Source: OctoMap 1.9 (`AbstractOcTree.cpp`, `OccupancyOcTreeBase.hxx`): the header's lines, the
order of the nodes, and the log-odds of what is certain.
"""

import math
from functools import partial
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import FormatError
from navbake.formats.source import read_bytes, read_header
from navbake.formats.voxel_allowance import VoxelAllowance
from navbake.types import Int, Int32
from navbake.voxels.grid import VoxelGrid
from navbake.voxels.placement import finite_array

# Functions import kernels when they run: numba takes long to load.

MAGIC = b"# Octomap OcTree"
DEPTH = 16
CENTER = 2 ** (DEPTH - 1)  # key of the world's origin
FIRST_LINES = {"bt": "# Octomap OcTree binary file", "ot": "# Octomap OcTree file"}
COMMENT = "# (feel free to add / change comments, but leave the first line as it is!)\n#"
BAND = 1 << 16  # nodes that are worth a thread's while
OFF = 1e-3  # of a voxel: what a grid may lie off the tree's lattice

# OctoMap's clamping thresholds: the log-odds of what is certainly free or occupied
FREE_ODDS, OCCUPIED_ODDS = (math.log(p / (1 - p)) for p in (0.1192, 0.971))

Box = tuple[Int, tuple[int, int, int]]  # first key along each axis, and counts of voxels


def encode_octomap(grid: VoxelGrid, kind: str, *, free: bool = False) -> bytes:
    """Encode an octree.

    Args:
        grid: the voxels; IDs count as occupied. It must lie on whole multiples of its edge.
        kind: ``bt`` or ``ot``.
        free: voxels that are known and not occupied are free; else they are unknown.

    Raises:
        FormatError: the grid doesn't lie on the tree's lattice, or reaches beyond it.
    """
    from navbake.formats.kernels.octree import write_odds, write_tree  # numba loads slowly

    if kind not in FIRST_LINES:
        raise FormatError(f"expected an octree as bt or ot, got {kind!r}")
    first = _first_key(grid)
    levels = _build_pyramid(grid, first, free)
    write: Any = write_tree
    if kind == "ot":
        odds = np.array([0.0, FREE_ODDS, OCCUPIED_ODDS], dtype="<f4").view(np.uint8).reshape(3, 4)
        write = partial(write_odds, odds)
    num_bytes, num_nodes = write(levels, first, np.empty(0, np.uint8))
    nodes = np.empty(num_bytes, np.uint8)
    write(levels, first, nodes)
    header = (
        f"{FIRST_LINES[kind]}\n{COMMENT}\nid OcTree\nsize {num_nodes}\n"
        f"res {_text(grid.res)}\ndata\n"
    )
    return header.encode() + nodes.tobytes()


def _build_pyramid(grid: VoxelGrid, first: Int, free: bool) -> tuple[NDArray[np.uint8], ...]:
    """The states of all nodes over the grid, from the voxels up to the root."""
    from navbake.formats.kernels.octree import OCCUPIED, join_states
    from navbake.threads import run_in_bands  # loads numba, too

    states = grid.occupied.astype(np.uint8)
    states *= OCCUPIED
    if free:  # the numbers of the states ascend: UNKNOWN, FREE, OCCUPIED
        np.maximum(states, True if grid.known is None else grid.known, out=states)
    levels = [states]
    # level k has the nodes from `first >> k` to `last >> k`, whole multiples of 2**k voxels
    last = first + np.array(grid.shape) - 1
    for level in range(1, DEPTH + 1):
        above = np.empty((last >> level) - (first >> level) + 1, np.uint8)
        below, begin = levels[-1], first >> (level - 1)
        least = max(1, BAND // above[0].size)
        run_in_bands(join_states, len(above), below, begin, above, least=least)
        levels.append(above)
    return tuple(levels)


def _first_key(grid: VoxelGrid) -> Int:
    """The tree's key of the first voxel along each axis."""
    place = np.array(grid.origin) / grid.res
    whole = np.round(place)
    off = np.abs(place - whole).max()
    if off > OFF:
        raise FormatError(
            f"an octree's voxels lie on whole multiples of their edge {grid.res:g} m, and this "
            f"grid's lower corner ({', '.join(f'{c:g}' for c in grid.origin)}) is "
            f"{off * grid.res:.3g} m off: make the grid with align=True (--align)"
        )
    if (np.abs(whole) > CENTER).any() or (np.abs(whole + grid.shape) > CENTER).any():
        raise FormatError(
            f"an octree reaches {CENTER * grid.res:g} m from the origin with voxels of "
            f"{grid.res:g} m, and this grid goes beyond: expected larger voxels or a grid nearer "
            f"to the origin"
        )
    return np.asarray(whole.astype(np.int64) + CENTER)


def _text(res: float) -> str:
    """The edge in six digits, as OctoMap writes it, or in as many as it takes."""
    short = f"{res:g}"
    return short if math.isclose(float(short), res, rel_tol=1e-12) else repr(res)


class _Header(NamedTuple):
    kind: str
    size: int  # number of nodes, as stated
    res: float
    end: int  # where the data begin


def read_octomap(
    source: str | PathLike[str] | bytes,
    *,
    bounds: ArrayLike | None = None,
    max_voxels: int | None = None,
) -> VoxelGrid:
    """Read an octree of class OcTree, ``.bt`` or ``.ot``.

    The grid covers all space that is known, occupied or free; `VoxelGrid.known` says which
    voxels are. Log-odds of 0 and more are occupied.

    Args:
        source: a path, or a file's content.
        bounds: read only this box, (2, 3), lower and upper corner, world frame [m].
        max_voxels: most voxels that the grid may have. If None: 2**31, and no more memory than
            256 MiB and 512 bytes for each byte of the file, with two bytes a voxel and 20 a leaf.

    Raises:
        FormatError: it is no such file, broken, or needs more memory than it may.
    """
    from navbake.formats.kernels.octree import fill_leaves

    data, name = read_bytes(source, begins=MAGIC, expected="an OctoMap file (bt or ot)")
    header = _read_header(data, name)
    allowance = VoxelAllowance.of_file(name, len(data), max_voxels)
    leaves, notes = _read_leaves(data, header, allowance)
    first, shape = _box_leaves(leaves) if bounds is None else _box_keys(bounds, header.res)
    allowance.take_voxels(shape, 2)
    values, known = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
    fill_leaves(leaves, first, values, known)
    origin = tuple(((first - CENTER) * header.res).tolist())
    unsure = None if known.all() else known
    return VoxelGrid(values=values, origin=origin, res=header.res, known=unsure, notes=notes)


def _read_leaves(
    data: bytes, header: _Header, allowance: VoxelAllowance
) -> tuple[Int32, list[str]]:
    from navbake.formats.kernels.octree import TOO_DEEP, read_odds, read_tree

    source = allowance.source
    nodes = np.frombuffer(data, dtype=np.uint8, offset=header.end)
    empty = np.empty((0, 5), np.int32)
    if header.size == 0 and not len(nodes):
        return empty, [f"{source} is an empty tree: nothing is known"]
    read: Any = read_tree
    if header.kind == "ot":
        whole = nodes[: len(nodes) // 5 * 5].reshape(-1, 5)
        odds = np.ascontiguousarray(whole[:, :4]).view("<f4").ravel()
        read = partial(read_odds, odds)
    # leaves are counted first: the size in the header may be wrong
    num_leaves, num_bytes, num_nodes = read(nodes, empty)
    if num_leaves < 0:
        what = "a tree deeper than 16" if num_leaves == TOO_DEEP else "an end within the tree"
        raise FormatError(f"expected {header.size} nodes in {source}, got {what}")
    if num_bytes != len(nodes):
        got = f"got {len(nodes)}: data run over"
        raise FormatError(f"expected {num_bytes} bytes of nodes in {source}, {got}")
    allowance.take_bytes(num_leaves * 5 * empty.itemsize)
    leaves = np.empty((num_leaves, 5), np.int32)
    read(nodes, leaves)
    if num_nodes != header.size:
        return leaves, [f"{source} has {num_nodes} nodes, and says {header.size}"]
    return leaves, []


def _box_leaves(leaves: Int32) -> Box:
    """The box of all leaves; a single voxel if there are none."""
    if not len(leaves):
        return np.full(3, CENTER), (1, 1, 1)
    low = leaves[:, :3].astype(np.int64)
    first = low.min(axis=0)
    nx, ny, nz = ((low + (1 << leaves[:, 3:4])).max(axis=0) - first).tolist()
    return first, (nx, ny, nz)


def _box_keys(bounds: ArrayLike, res: float) -> Box:
    """The box that a user asked for, (2, 3) [m]; voxels that it reaches into by a hair are out."""
    box = finite_array(bounds, (2, 3))
    if box is None or not (box[0] < box[1]).all():
        raise FormatError(f"expected bounds as (lower, upper) corner [m], got {bounds!r}")
    place = np.clip(box / res + CENTER, -1.0, 2.0 * CENTER + 1.0)  # whole numbers hold no more
    first = np.clip(np.floor(place[0] + OFF), 0, None).astype(np.int64)
    end = np.clip(np.ceil(place[1] - OFF), None, 2 * CENTER).astype(np.int64)
    end = np.where(end == first, first + 1, end)  # a box within a hair of a face
    if (end <= first).any() or (end > 2 * CENTER).any():
        expected = f"bounds within {CENTER * res:g} m of the origin, where the tree reaches"
        raise FormatError(f"expected {expected}, got {box.tolist()}")
    nx, ny, nz = (end - first).tolist()
    return first, (nx, ny, nz)


def _read_header(data: bytes, source: str) -> _Header:
    first = data[:200].partition(b"\n")[0].decode("ascii", errors="replace").strip()
    kind = next((kind for kind, line in FIRST_LINES.items() if first == line), None)
    if kind is None:
        raise FormatError(f"expected an OctoMap file (bt or ot), got {source}")
    lines, end = read_header(data, source)
    fields = {name: " ".join(words) for name, words in lines.items()}
    if fields.get("id") != "OcTree":
        raise FormatError(f"expected a tree of id OcTree in {source}, got {fields.get('id')!r}")
    return _Header(kind, int(_number(fields, "size", source)), _number(fields, "res", source), end)


def _number(fields: dict[str, str], name: str, source: str) -> float:
    try:
        number = float(fields[name])
    except (KeyError, ValueError):
        number = math.nan  # refused below
    if not math.isfinite(number) or number < 0 or (name == "res" and number == 0):
        got = repr(fields.get(name, "none"))
        raise FormatError(f"expected a number > 0 at `{name}` in the header of {source}, got {got}")
    return number
