"""The kinds of inputs: good ones, how they are broken, and what a user does with them."""

from __future__ import annotations

import gzip
import io
import json
import math
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
import trimesh

import navbake
from fuzzing import texts
from fuzzing.mutations import (
    dump_tree,
    mutate_bytes,
    mutate_text,
    mutate_tree,
    odd_value,
)
from navbake.arena import map_descriptor
from navbake.baker.scene.mesh_scene import read_mesh_parts
from navbake.config.settings import load_config
from navbake.errors import NavbakeError
from navbake.formats.binvox import encode_binvox, read_binvox
from navbake.formats.navgrid import dumps_navgrid
from navbake.formats.npz import encode_npz
from navbake.formats.octomap import encode_octomap
from navbake.formats.shapes.geojson import read_room_outlines
from navbake.formats.voxels import names_path, read_voxels
from navbake.views.info import describe
from navbake.views.why import describe_column
from navbake.voxels.grid import VoxelGrid

FEW_VOXELS = 4_000_000


class Kind(NamedTuple):
    """A kind of input.

    Attributes:
        make: the input of a generator of random numbers, with the ending that its file has.
        use: reads the file and does what users do; raises what they would see.
    """

    make: Callable[[Random], tuple[bytes, str]]
    use: Callable[[Path], object]


# ---------------------------------------------------------------- grids


def make_navgrid(rng: Random) -> tuple[bytes, str]:
    """A NavGrid file with changes in its JSON; some are gzipped, some of these broken."""
    data = dump_tree(mutate_tree(rng.choice(texts.GRIDS), rng), rng)
    if rng.random() < 0.05:
        data = gzip.compress(data, compresslevel=1, mtime=0)
        data = mutate_bytes(data, rng) if rng.random() < 0.5 else data
        return data, ".json.gz"
    return data, ".json"


def use_navgrid(path: Path) -> None:
    """Load, describe, save, load again, change doors, look at cells, and plan."""
    grid = navbake.load(path)
    describe(grid)
    written = dumps_navgrid(grid)
    if dumps_navgrid(navbake.load(written)) != written:
        raise AssertionError("a grid is another one after it is written and read")
    for table in (grid.rooms, grid.doors, grid.links):
        _ = [entry.to_json() for entry in table if hasattr(entry, "to_json")]
    for level in grid.levels:
        _ = level.rooms, level.doors, dict(level.user_data)
    x0, y0, x1, y1 = grid.levels[0].lattice.bounds
    middle = (x0 + x1) / 2, (y0 + y1) / 2
    describe_column(grid, *middle)
    for state in ("open", "closed", "removed", "modelled"):
        _try(lambda state=state: dumps_navgrid(grid.with_doors(state)))
    if _is_one_in(8, written):
        finder = navbake.PathFinder(grid)
        for goal in (middle, (x0, y0), *(f"room:{room.id}" for room in grid.rooms[:2])):
            _try(lambda goal=goal: finder.find_path(middle, goal))
        _try(lambda: finder.random_point(np.random.default_rng(0)))
        _try(lambda: finder.snap(middle))
        _try(lambda: dumps_navgrid(grid.inflate(grid.levels[0].lattice.cell_size)))


def _is_one_in(number: int, data: bytes) -> bool:
    """A draw that is the same whenever a file is used."""
    return zlib.crc32(data) % number == 0


def _try(action: Callable[[], object]) -> None:
    """A question may have no answer, if that is said."""
    try:
        action()
    except NavbakeError as error:
        check_message(error)


def check_message(error: NavbakeError) -> None:
    """Errors are one line that fits a terminal."""
    message = str(error)
    if "\n" in message or not message or len(message) > 1500:
        raise AssertionError(f"not one line: {message[:300]!r}")


# ---------------------------------------------------------------- voxels


@cache
def _voxels() -> tuple[VoxelGrid, ...]:
    rng = np.random.default_rng(0)
    plain = VoxelGrid(values=rng.random((4, 3, 5)) < 0.4, origin=(0.0, -0.5, 1.0), res=0.5)
    ids = rng.integers(0, 4, (3, 4, 2)).astype(np.uint16)
    known = rng.random((3, 4, 2)) < 0.8
    named = VoxelGrid(
        values=ids, origin=(0.0, 0.0, 0.0), res=0.25, names={1: "a", 2: "é", 3: "c"}, known=known
    )
    return plain, named


def make_binvox(rng: Random) -> tuple[bytes, str]:
    """A binvox file with other words in its header, other runs, or other bytes."""
    grid = rng.choice(_voxels())
    data = encode_binvox(grid, rng.choice(("binvox", "airsim")))
    header, mark, runs = data.partition(b"data\n")
    kind = rng.randrange(4)
    if kind < 2:
        header = mutate_text(header, rng)
    if kind == 1 or kind == 2:
        runs = mutate_bytes(runs, rng)
    if kind == 3:  # a header that fits other runs
        dim = [rng.choice((1, 2, 7, 300, 70_000, 2**31, 2**40)) for _ in range(3)]
        header = b"#binvox 1\ndim %d %d %d\n" % tuple(dim)
        runs = b"\x01\xff" * rng.choice((1, 100, 50_000))
    return header + mark + runs, ".binvox"


@cache
def _octree(number: int, kind: str, free: bool) -> bytes:
    return encode_octomap(_voxels()[number], kind, free=free)


def make_octree(rng: Random) -> tuple[bytes, str]:
    """An octree with flipped bits in its nodes, or other words in its header."""
    kind = rng.choice(("bt", "ot"))
    data = _octree(rng.randrange(2), kind, rng.random() < 0.5)
    begin = data.index(b"data\n") + 5
    chance = rng.random()
    if chance < 0.25:
        return mutate_text(data[:begin], rng) + data[begin:], f".{kind}"
    if chance < 0.5:  # the tree stays whole: only what its leaves are changes
        changed = bytearray(data)
        for _ in range(rng.choice((1, 2, 5))):
            changed[rng.randrange(begin, len(data))] ^= 1 << rng.randrange(8)
        return bytes(changed), f".{kind}"
    if chance < 0.75:
        words = [rng.choice((0, 1, 2, 3, 0x5555, 0xAAAA, 0xFFFF, rng.randrange(65536)))]
        words *= rng.choice((1, 16, 400))
        return data[:begin] + b"".join(w.to_bytes(2, "little") for w in words), f".{kind}"
    return mutate_bytes(data, rng, begin), f".{kind}"


def make_npz(rng: Random) -> tuple[bytes, str]:
    """An archive with arrays of other shapes and dtypes, members that are none, other bytes."""
    data = encode_npz(rng.choice(_voxels()))
    if rng.random() < 0.3:
        return mutate_bytes(data, rng), ".npz"
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for _ in range(rng.choice((1, 1, 2, 3))):
        _change_member(members, rng)
    packed = io.BytesIO()
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(packed, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    data = packed.getvalue()
    return (mutate_bytes(data, rng) if rng.random() < 0.1 else data), ".npz"


def _change_member(members: dict[str, bytes], rng: Random) -> None:
    name = rng.choice(("values.npy", "origin.npy", "res.npy", "ids.npy", "names.npy", "known.npy"))
    content = members.get(name, b"")
    kind = rng.randrange(6)
    if kind == 0:
        members.pop(name, None)
    elif kind == 1:
        members[name.removesuffix(".npy")] = rng.choice((b"", b"hello", content))
        members.pop(name, None)
    elif kind == 2 and content:
        members[name] = mutate_bytes(content, rng)
    elif kind == 3 and content:  # the header claims another shape or dtype than there is
        old = rng.choice((b"(", b"3", b"4", b"|b1", b"<u2", b"<f8", b"False"))
        new = rng.choice((b"9999999999", b"-1", b"|O", b"<c16", b"<M8[s]", b"|V9", b"(((", b"True"))
        members[name] = content.replace(old, new, 1)
    else:
        shape = tuple(rng.choice((0, 1, 2, 3, 5)) for _ in range(rng.choice((0, 1, 1, 3, 3, 4))))
        dtype = rng.choice(
            ("?", "u1", "u2", "u4", "u8", "i8", "f4", "f8", "c8", "U3", "S2", "M8[s]")
        )
        value = rng.choice((0, 1, 7, math.inf if dtype in ("f4", "f8") else 3))
        file = io.BytesIO()
        np.lib.format.write_array(file, np.full(shape, value).astype(dtype), allow_pickle=False)
        members[name] = file.getvalue()


def make_names(rng: Random) -> tuple[bytes, str]:
    """A table of IDs with changes in its JSON."""
    table = {"rule": "0 is empty", "ids": {"1": "a", "2": "b", "3": "é"}}
    return dump_tree(mutate_tree(table, rng), rng), ".json"


def use_voxels(path: Path) -> None:
    """Read voxels, write them again, and ask for what they hold.

    Some may fill as much memory as the file's size allows; for most that takes too long.
    """
    grid = read_voxels(path, max_voxels=None if _is_one_in(50, path.read_bytes()) else FEW_VOXELS)
    _use_grid(grid)
    if path.suffix == ".binvox":
        _try(lambda: read_binvox(path, layout="airsim"))


def use_names(path: Path) -> None:
    """Read voxels with a table of IDs beside them."""
    voxels = path.with_name("named.binvox")
    if not voxels.exists():
        voxels.write_bytes(encode_binvox(_voxels()[1]))
    table = names_path(voxels)
    table.unlink(missing_ok=True)
    path.rename(table)
    _use_grid(read_voxels(voxels))


def _use_grid(grid: VoxelGrid) -> None:
    _ = grid.bounds, grid.ids()
    _try(lambda: grid.at(grid.bounds.mean(axis=0)))
    if grid.values.size <= 1_000_000:
        _try(lambda: encode_binvox(grid))
        _try(lambda: encode_npz(grid))
        if _is_one_in(20, grid.values.tobytes()):  # slow, in parallel
            _try(lambda: encode_octomap(grid, "bt"))


# ---------------------------------------------------------------- settings, rooms, descriptors


def make_yaml(rng: Random) -> tuple[bytes, str]:
    """Settings with other words, lines, tags, anchors and depths."""
    text = rng.choice(texts.SETTINGS)
    for _ in range(rng.choice((1, 1, 2, 4))):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        key, colon, value = lines[at].partition(":")
        kind = rng.randrange(8)
        if kind < 4:
            tag = rng.choice(texts.TAGS) if rng.random() < 0.4 else ""
            odd = rng.choice((*texts.SCALARS, json.dumps(odd_value(rng)), value.strip()))
            lines[at] = f"{key}{colon} {tag} {odd}"
        elif kind == 4:
            lines[at] = f"{key}{colon} &a {value}\nmore: *a"
        elif kind == 5:
            lines[at] = rng.choice(("", " ", "  ", "\t", "- ", "? ", "    ")) + lines[at].lstrip()
        elif kind == 6:
            lines.insert(at, rng.choice(lines))
        else:
            del lines[at]
        text = "\n".join(lines)
    data = text.encode(errors="surrogatepass")
    return (mutate_bytes(data, rng) if rng.random() < 0.1 else data), ".yaml"


def make_geojson(rng: Random) -> tuple[bytes, str]:
    """Room outlines with changes in their JSON."""
    return dump_tree(mutate_tree(rng.choice(texts.OUTLINES), rng), rng), ".geojson"


def make_descriptor(rng: Random) -> tuple[bytes, str]:
    """Both parts of a map descriptor, with changes, and a shape."""
    shape = rng.choice(((20, 15), (20, 15), (3, 5), (1, 1)))
    known = np.array([[rng.random() < 0.7 for _ in range(shape[1])] for _ in range(shape[0])])
    parts: list[Any] = list(map_descriptor.encode(known, known[::-1]))
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(2)
        text = parts[at] if isinstance(parts[at], str) else ""
        kind = rng.randrange(5)
        if kind == 0 and text:
            place = rng.randrange(len(text))
            parts[at] = text[:place] + rng.choice("0123456789abcdefFxg ٣\0") + text[place + 1 :]
        elif kind == 1:
            parts[at] = text[: rng.randrange(len(text) + 1)]
        elif kind == 2:
            parts[at] = text + rng.choice(("0", "00", "F", " ", "\n", "0" * 100_000))
        elif kind == 3:
            parts[at] = odd_value(rng)
        else:
            shape = rng.choice(
                ((0, 1), (-1, 5), (10**6, 10**6), (1.5, 2), (20,), "ab", 5, (True, 9))
            )
    return json.dumps([parts, shape]).encode(), ".json"


def use_descriptor(path: Path) -> None:
    """Decode a descriptor, and encode it again."""
    (part1, part2), shape = json.loads(path.read_bytes())
    explored, obstacles = map_descriptor.decode(part1, part2, shape)
    map_descriptor.encode(explored, obstacles)
    map_descriptor.draw(explored, obstacles)


# ---------------------------------------------------------------- meshes


@cache
def _meshes() -> dict[str, bytes]:
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1, 2, 1)), geom_name="table", node_name="table")
    cone = trimesh.creation.cone(1, 2, sections=5)
    scene.add_geometry(
        cone, node_name="cone", transform=trimesh.transformations.rotation_matrix(1, (0, 0, 1))
    )
    box = trimesh.creation.box((1, 1, 1))
    files = {name: box.export(file_type=kind, **more) for name, kind, more in (
        ("a.stl", "stl", {}), ("b.stl", "stl_ascii", {}), ("a.ply", "ply", {}),
        ("b.ply", "ply", {"encoding": "ascii"}), ("b.obj", "obj", {}), ("a.dae", "dae", {}),
    )}  # fmt: skip
    files["a.obj"], files["a.glb"] = scene.export(file_type="obj"), scene.export(file_type="glb")
    files["a.gltf"] = texts.GLTF
    return {name: data.encode() if isinstance(data, str) else data for name, data in files.items()}


def make_mesh(rng: Random) -> tuple[bytes, str]:
    """A mesh file with other words, counts, indices, JSON or bytes."""
    name, data = rng.choice(sorted(_meshes().items()))
    suffix = name[1:]
    if suffix == ".gltf":
        return dump_tree(mutate_tree(json.loads(data), rng), rng), suffix
    if suffix == ".glb" and rng.random() < 0.7:
        return _rebuild_glb(data, rng), suffix
    if name == "a.stl":
        return mutate_bytes(data, rng, rng.choice((0, 80))), suffix
    if name == "a.ply":
        header, mark, body = data.partition(b"end_header\n")
        return mutate_text(header, rng) + mark + mutate_bytes(body, rng), suffix
    if suffix == ".dae":
        return mutate_text(data, rng, b' \n"<>/'), suffix
    return mutate_text(data, rng), suffix


def _rebuild_glb(data: bytes, rng: Random) -> bytes:
    """A GLB with changes in its JSON, and lengths that fit again, most of the time."""
    length = int.from_bytes(data[12:16], "little")
    tree, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    text = dump_tree(mutate_tree(tree, rng), rng)
    text += b" " * (-len(text) % 4)
    total = 20 + len(text) + len(rest)
    if rng.random() < 0.1:
        total = rng.choice((0, 20, 2**31, 2**32 - 1))
    head = b"glTF" + (2).to_bytes(4, "little") + total.to_bytes(4, "little")
    return head + len(text).to_bytes(4, "little") + b"JSON" + text + rest


def use_mesh(path: Path) -> None:
    """Read a mesh file as a scene's parts."""
    read_mesh_parts(path)


KINDS: dict[str, Kind] = {
    "navgrid": Kind(make_navgrid, use_navgrid),
    "binvox": Kind(make_binvox, use_voxels),
    "npz": Kind(make_npz, use_voxels),
    "octree": Kind(make_octree, use_voxels),
    "names": Kind(make_names, use_names),
    "yaml": Kind(make_yaml, load_config),
    "geojson": Kind(make_geojson, read_room_outlines),
    "descriptor": Kind(make_descriptor, use_descriptor),
    "mesh": Kind(make_mesh, use_mesh),
}
