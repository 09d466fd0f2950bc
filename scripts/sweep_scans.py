"""Look for scans of rooms whose floor `scene.up: level` doesn't find.

Each seed is a furnished room as a scanner sees it: one noisy surface with holes, tilted, with any
axis of the file down. Its floor is found where that of the grid lies within 2 cm of it, and what is
up in the grid within 2° of what is. Where it isn't, a warning has to say that it may be a ceiling.

    python scripts/sweep_scans.py -n 50
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

from navbake.baker.bake.pipeline import run_bake
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import parse_config
from navbake.errors import SceneError
from navbake.types import Float

EDGE = 0.08  # of the scan's triangles [m]
GAP = 0.3  # between pieces of furniture at least [m]


class Scan(NamedTuple):
    """A scanned room.

    Attributes:
        mesh: as the scanner wrote it.
        up: the direction that is up in it, of unit length.
        floor: a point of its floor.
    """

    mesh: trimesh.Trimesh
    up: Float
    floor: Float


def make_scan(seed: int, furnished: bool = True) -> Scan:
    """Make a random room, and scan it."""
    random = np.random.default_rng(seed)
    width, depth, height = random.uniform((2.5, 2.5, 2.3), (8.0, 6.0, 3.2))
    seen_from = np.array((width, depth, height)) / 2
    sheets = [
        _sheet(random, (0, 0, 0), (width, 0, 0), (0, depth, 0), random.integers(0, 5), seen_from)
    ]
    if random.random() < 0.85:
        corner, holes = (0, 0, height), random.integers(0, 3)
        sheets.append(_sheet(random, corner, (width, 0, 0), (0, depth, 0), holes, seen_from))
    for corner, along in (
        ((0, 0, 0), (width, 0, 0)), ((0, depth, 0), (width, 0, 0)),
        ((0, 0, 0), (0, depth, 0)), ((width, 0, 0), (0, depth, 0)),
    ):  # fmt: skip
        if random.random() < 0.9:
            sheets.append(
                _sheet(random, corner, along, (0, 0, height), random.integers(0, 3), seen_from)
            )
    kinds = np.array([(2.0, 1.5, 0.5), (1.4, 0.8, 0.75), (0.5, 0.5, 0.45), (1.2, 0.6, 2.0)])
    chosen = random.choice(4, random.integers(2, 7), p=(0.3, 0.3, 0.25, 0.15))
    stands = np.zeros((0, 4))
    for kind in [random.integers(0, 2), *chosen] if furnished else ():
        size = kinds[kind] * random.uniform(0.85, 1.15, 3)
        x, y = random.uniform(0.1, np.maximum((width, depth) - size[:2] - 0.1, 0.11))
        low, high = np.array((x, y)) - GAP, np.array((x, y)) + size[:2] + GAP
        if (stands[:, 2:] > low).all(axis=1)[(stands[:, :2] < high).all(axis=1)].any():
            continue  # in the way of another
        stands = np.vstack([stands, (*(low + GAP), *(high - GAP))])
        sheets += _five_sides(random, x, y, 0.0, *size)
    for _ in range(random.integers(0, 4)):  # lamps
        x, y = random.uniform(0.3, (width - 0.6, depth - 0.6))
        sheets += _five_sides(random, x, y, height - 0.35, 0.3, 0.3, -0.2)
    mesh = trimesh.util.concatenate(sheets)
    mesh.merge_vertices()
    noise = random.uniform(0.002, 0.010)
    vertices = mesh.vertices + random.normal(0.0, noise, mesh.vertices.shape)
    axis, down = np.roll(np.eye(3), random.integers(0, 3), axis=0), random.choice((-1.0, 1.0))
    turn = axis * np.array([1.0, down, down])[:, None]
    turn = turn * np.sign(np.linalg.det(turn))
    lean = trimesh.transformations.random_rotation_matrix(random.random(3))[:3, 0]
    tilt = np.radians(random.uniform(0.0, 40.0))
    turn = trimesh.transformations.rotation_matrix(tilt, lean)[:3, :3] @ turn
    shift = random.uniform(-3.0, 3.0, 3)
    faces = mesh.faces[random.random(len(mesh.faces)) > 0.004]
    scanned = trimesh.Trimesh(vertices @ turn.T + shift, faces, process=False)
    return Scan(scanned, turn[:, 2], turn @ (width / 2, depth / 2, 0.0) + shift)


def _sheet(random, corner, along, aside, holes: int, seen_from) -> trimesh.Trimesh:
    """A rectangle of small triangles, with round holes, that faces to where it is seen from."""
    corner, along, aside = (np.array(v, dtype=float) for v in (corner, along, aside))
    lengths = np.linalg.norm(along), np.linalg.norm(aside)
    m, n = (max(2, int(length / EDGE)) for length in lengths)
    u, v = np.meshgrid(np.linspace(0, 1, m + 1), np.linspace(0, 1, n + 1), indexing="ij")
    points = corner + u.reshape(-1, 1) * along + v.reshape(-1, 1) * aside
    at = np.arange((m + 1) * (n + 1)).reshape(m + 1, n + 1)
    a, b, c, d = (k.ravel() for k in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    for _ in range(holes):
        place = corner + random.random() * along + random.random() * aside
        away = np.linalg.norm(points[faces].mean(axis=1) - place, axis=1)
        faces = faces[away > random.uniform(0.1, 0.7)]
    if np.dot(np.cross(along, aside), seen_from - corner) < 0:
        faces = faces[:, ::-1]
    return trimesh.Trimesh(points, faces, process=False)


def _five_sides(random, x, y, z, dx, dy, dz) -> list[trimesh.Trimesh]:
    """The top and the four sides of a box that stands at z, or hangs from there."""
    sides = [
        ((x, y, z + dz), (dx, 0, 0), (0, dy, 0)),
        ((x, y, z), (dx, 0, 0), (0, 0, dz)), ((x, y + dy, z), (dx, 0, 0), (0, 0, dz)),
        ((x, y, z), (0, dy, 0), (0, 0, dz)), ((x + dx, y, z), (0, dy, 0), (0, 0, dz)),
    ]  # fmt: skip
    middle = np.array((x + dx / 2, y + dy / 2, z + dz / 2))
    return [
        _sheet(random, *side, 0, 2 * np.add(side[0], np.add(*side[1:]) / 2) - middle)
        for side in sides
    ]


def check(scan: Scan, path: Path) -> tuple[bool, bool, str]:
    """Bake a scan: whether its floor is found, whether a ceiling is told of, and what is wrong."""
    scan.mesh.export(path)
    config = parse_config({"scene": {"path": str(path), "up": "level", "scan": True}})
    try:
        result = run_bake(config)
    except SceneError as error:
        return False, True, str(error)
    told = any("ceiling" in warning for warning in result.warnings)
    # with the specks that the bake leaves out, so that vertices are the scan's own
    (part,) = load_scene(
        config.model_copy(update={"scene": config.scene.model_copy(update={"scan": False})})
    ).exact_meshes.values()
    given = scan.mesh.vertices[np.unique(scan.mesh.faces)]
    middle, center = given.mean(axis=0), part.vertices.mean(axis=0)
    turn = np.linalg.lstsq(given - middle, part.vertices - center, rcond=None)[0].T
    angle = np.degrees(np.arccos(np.clip((turn @ scan.up)[2], -1.0, 1.0)))
    floor = float((turn @ (scan.floor - middle) + center)[2])
    off = min(abs(float(np.nanmedian(level.floor_height)) - floor) for level in result.grid.levels)
    found = angle <= 2.0 and off <= 0.02
    return found, told, f"{angle:.2f}°, {off * 100:.1f} cm, {len(result.grid.levels)} levels"


def main() -> int:
    """Check scans, and say how many floors were found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("-n", type=int, default=50, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--empty", action="store_true", help="rooms without furniture")
    given = parser.parse_args()
    found = silent = alarms = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(given.first, given.first + given.n):
            right, told, text = check(make_scan(seed, not given.empty), Path(folder) / "scan.ply")
            found, alarms = found + right, alarms + (right and told)
            silent += not right and not told
            if not right or told:
                print(f"seed {seed}: {'found' if right else 'MISSED'}"
                      f"{', told' if told else ', not told'}: {text}")  # fmt: skip
    print(f"{found} of {given.n} floors found, {silent} missed without a warning, "
          f"{alarms} found and told to be ceilings")  # fmt: skip
    return 0 if found >= 0.96 * given.n and not silent else 1


if __name__ == "__main__":
    sys.exit(main())
