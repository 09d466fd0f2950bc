"""Mesh files: PLY, STL, OBJ, glTF and DAE."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import trimesh

from fuzzing import texts
from fuzzing.kind import Input
from fuzzing.mutations import cut, dump_tree, mutate_bytes, mutate_text, mutate_tree
from navbake.baker.scene.mesh_scene import MeshPart, read_mesh_parts

COUNTS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 10**9)
NUMBERS = (b"0", b"-1", b"2147483647", b"4294967296", b"9999999999", b"1e9", b"nan", b"1e308")
ENTITIES = (  # "billion laughs", and a file that is not asked for
    b'<!DOCTYPE d [<!ENTITY a0 "xxxxxxxxxx">' + b"".join(
        b'<!ENTITY a%d "%s">' % (k, b"&a%d;" % (k - 1) * 10) for k in range(1, 10)
    ) + b"]>",
    b'<!DOCTYPE d [<!ENTITY a9 SYSTEM "file:///etc/hostname">]>',
)  # fmt: skip


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


def make_ply(rng: Random) -> Input:
    """A PLY with other words or numbers in its header, or other bytes."""
    data = _meshes()[rng.choice(("a.ply", "a.ply", "b.ply"))]
    header, mark, body = data.partition(b"end_header\n")
    kind = rng.randrange(4)
    if kind == 0:  # numbers of vertices or faces that there are not
        old = rng.choice((b"vertex 8", b"face 12", b"list uchar int", b"float x"))
        new = rng.choice((b"vertex ", b"face ")) + rng.choice(NUMBERS)
        types = (b"list int int", b"list double uchar", b"list uchar char", b"double x", b"list")
        header = header.replace(old, rng.choice((new, *types)), 1)
    elif kind == 1:
        header = mutate_text(header, rng)
    elif kind == 2:
        body = mutate_bytes(body, rng)
    else:
        return Input(cut(mutate_text(data, rng), rng), ".ply")
    return Input(cut(header + mark + body, rng), ".ply")


def make_stl(rng: Random) -> Input:
    """An STL with other words, numbers of triangles, or bytes."""
    if rng.random() < 0.5:
        return Input(cut(mutate_text(_meshes()["b.stl"], rng), rng), ".stl")
    data = mutate_bytes(_meshes()["a.stl"], rng, rng.choice((0, 80)))
    if rng.random() < 0.3:
        data = data[:80] + rng.choice(COUNTS).to_bytes(4, "little") + data[84:]
    return Input(cut(data, rng), ".stl")


def make_obj(rng: Random) -> Input:
    """An OBJ with other words, lines and indices."""
    data = mutate_text(_meshes()[rng.choice(("a.obj", "b.obj"))], rng)
    if rng.random() < 0.2:
        more = (b"f 1/1/1 2//2 -1", b"f 1 2", b"f 1 2 3 4 5 6 7 8 9 10", b"v 1 2", b"g", b"o",
                b"f 999999999 1 2", b"f 0 0 0", b"mtllib /dev/zero", b"usemtl a\\", b"l 1 2",
                b"f " + b"1 " * 20_000, b"v " + b"9" * 20_000 + b" 0 0", b"#" * 99_999)  # fmt: skip
        data += b"\n" + rng.choice(more) + b"\n"
    return Input(cut(data, rng), ".obj")


def make_gltf(rng: Random) -> Input:
    """A glTF or GLB with changes in its JSON, lengths that lie, or other bytes."""
    if rng.random() < 0.4:
        return Input(dump_tree(mutate_tree(json.loads(texts.GLTF), rng), rng), ".gltf")
    data = _meshes()["a.glb"]
    data = _rebuild_glb(data, rng) if rng.random() < 0.7 else mutate_bytes(data, rng)
    return Input(cut(data, rng), ".glb")


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


def make_dae(rng: Random) -> Input:
    """A DAE with other words, numbers and entities."""
    data = mutate_text(_meshes()["a.dae"], rng, b' \n"<>/')
    if rng.random() < 0.05:
        head, mark, rest = data.partition(b"?>")
        data = head + mark + rng.choice(ENTITIES) + rest.replace(b"geometry0", b"&a9;", 1)
    return Input(cut(data, rng), ".dae")


def check_parts(parts: list[MeshPart]) -> None:
    """Parts have names of their own, finite corners, and triangles of these."""
    if len({part.name for part in parts}) < len(parts):
        raise AssertionError("two parts have one name")
    for part in parts:
        faces: Any = part.faces
        is_fine = np.isfinite(part.vertices).all() and len(faces) and faces.shape[1] == 3
        if not is_fine or not 0 <= faces.min() <= faces.max() < len(part.vertices):
            raise AssertionError(f"part {part.name!r} is broken")


def read_mesh(path: Path) -> list[MeshPart]:
    """Read a mesh file as a scene's parts."""
    return read_mesh_parts(path)
