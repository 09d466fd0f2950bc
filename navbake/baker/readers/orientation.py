"""Which way a mesh is up: by its largest flat surfaces, and by what stands on them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navbake.baker.geometry.shapes import drop_unused_vertices, triangle_areas
from navbake.baker.geometry.triangle_kernels import describe_triangles, find_nearest_axes
from navbake.baker.readers.mesh import (
    AXES,
    Direction,
    NamedMesh,
    bounds_of_meshes,
    file_up_axis,
    rotation_to_z_up,
)
from navbake.config.settings import SceneSettings
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float

SPECK = 0.1  # of a piece of a scan that is left out [m²]
MOST_TRIANGLES = 30_000  # that are used; of more, each second one, or third, …
# How many times the area of walls of one direction the floors and ceilings have at least of a mesh
# that lies on its side
LYING = 1.5
UNCLEAR = "this floor may be a ceiling: what stands in the mesh doesn't say which way is up"
NUM_AXES = 400  # of the hemisphere's directions in which surfaces are counted, 7° apart
NEAR = 0.12  # at most so far are directions from the nearest of these, of unit length
FACING = np.cos(np.radians(30.0))  # of a triangle, along its plane's normal: scans are noisy
APART = np.cos(np.radians(40.0))  # of two directions that are looked at
THICK = 0.08  # of what is one flat surface, on both sides [m]
STANDING = 0.12, 1.1  # heights over a floor at which most furniture is [m]
PLANES = 4  # flat surfaces that are looked at in a direction
# shares of the largest one that floors have, and that is no furniture
FLOOR = 0.5
WALL = 0.25
AWAY = 0.2  # of a floor's surface that may face down, beside what faces up
SIZE_WEIGHT = 0.1  # of a flat surface, beside what stands on it
LEAST = 4.0  # area of a floor; a mesh whose flat surfaces are smaller may be furniture [m²]
CLEAR = 0.1, 1.3  # of its size, and times what is so in any other direction, that stands on it


class Orientation(NamedTuple):
    """A direction that may be up."""

    direction: Float  # of unit length, in the frame of the mesh
    size: float  # area of the largest flat surface that faces along it [m²]
    standing: float  # area of what stands on such ones: of no wall, at heights `STANDING` [m²]


class Surface(NamedTuple):
    """Some triangles of a mesh."""

    center: Float  # (n, 3) [m]
    normal: Float  # of unit length, (n, 3)
    area: Float  # of each, and of those that it stands for [m²]


def orient_meshes(
    read: Callable[..., list[NamedMesh]], settings: SceneSettings, warnings: list[str]
) -> list[NamedMesh]:
    """Take the parts of a mesh in the world frame, as `scene.up` says; warn where that looks wrong.

    `auto` is the axis that the file states, else z; or y where a file without one seems to lie on
    its side, see `lies_on_side`, and `find_up` agrees. `read` takes ``up``, a direction in the
    file, and returns the parts [m].
    """
    said = file_up_axis(Path(settings.path)) if settings.up == "auto" else None
    is_level = settings.up == "level" or (said is None and settings.up == "auto" and settings.scan)
    up = (said or "z") if settings.up in ("auto", "level") else settings.up
    parts = read(up=up)
    if settings.scan:
        parts = drop_specks(parts, warnings)
    surface = sample_surface(parts)
    ups, is_clear = find_up(surface)
    if is_level:
        if not is_clear:
            other = _name(-ups[0].direction)
            warnings.append(f"{UNCLEAR}: `scene.up: {other}` turns the mesh over")
        return _turned(parts, ups[0].direction)
    turn = rotation_to_z_up(up).T
    best = turn @ ups[0].direction
    lies = settings.up == "auto" and lies_on_side(parts, surface)
    if is_clear and lies and said is None and abs(ups[0].direction[1]) > FACING:
        axis = _name(best)
        warnings.append(
            f"the mesh lies on its side, and is taken with {axis} up, as things stand on what "
            f"faces that way: `scene.up: {axis}` silences this, `z` leaves it as it is"
        )
        return _turned(parts, AXES[axis])
    if is_clear and ups[0].direction[2] < -FACING:
        warnings.append(
            f"this floor may be a ceiling: next to nothing stands on it, and "
            f"{ups[0].standing:.1f} m² hang from a surface like it above: "
            f"`scene.up: {_name(best)}` turns the mesh over"
        )
    elif lies:
        axis = _name(np.abs(turn[:, 1]))
        warnings.append(
            f"the mesh is lowest along {axis}, and most of its surface faces along {axis}: if it "
            f"lies on its side, set `scene.up` to {axis} ({up} silences this)"
        )
    return parts


def drop_specks(parts: list[NamedMesh], warnings: list[str]) -> list[NamedMesh]:
    """Leave out connected pieces smaller than `SPECK`, with a warning.

    Scanners see people, reflections and dust as small pieces that stand in mid-air.
    """
    from scipy.sparse import coo_array, csgraph  # scipy loads slowly, and few bake scans

    kept = list[NamedMesh]()
    dropped = 0
    lost = 0.0
    for part in parts:
        _, place = np.unique(part.vertices, axis=0, return_inverse=True)
        corners = place.reshape(-1)[part.faces]
        ends = corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel()
        size = int(corners.max()) + 1
        edges = coo_array((np.ones(len(ends[0]), dtype=np.bool_), ends), shape=(size, size))
        piece = csgraph.connected_components(edges, directed=False)[1][corners[:, 0]]
        area = np.bincount(piece, triangle_areas(part.vertices, part.faces))
        small = (area > 0.0) & (area < SPECK)
        dropped = dropped + int(small.sum())
        lost = lost + float(area[small].sum())
        vertices, faces = drop_unused_vertices(part.vertices, part.faces[~small[piece]])
        if len(faces):
            kept.append(NamedMesh(part.name, vertices, faces))
    if not kept or not dropped:
        return parts
    each = f"each smaller than {SPECK} m² and {lost:.2f} m² in all"
    warnings.append(f"{dropped} pieces of the scan, {each}, are left out (`scene.scan`)")
    return kept


def _turned(parts: list[NamedMesh], up: Direction) -> list[NamedMesh]:
    return [part._replace(vertices=part.vertices @ rotation_to_z_up(up).T) for part in parts]


def lies_on_side(parts: Collection[NamedMesh], surface: Surface) -> bool:
    """Whether a mesh in the world frame looks as if its y axis were the vertical one.

    Its box is lowest along y, and `LYING` times as much area faces within 45° of y as of z.
    """
    along_y, along_z = np.abs(surface.normal[:, 1:].T) >= np.sqrt(0.5)
    if surface.area[along_y].sum() <= LYING * surface.area[along_z].sum():
        return False
    low, high = bounds_of_meshes(parts)
    width, depth, height = np.subtract(high, low)
    return bool(depth < min(width, height))


def _name(direction: Float) -> str:
    """A direction as `scene.up` takes it: the axis that it is near to, or its numbers."""
    name, axis = max(AXES.items(), key=lambda item: float(np.dot(item[1], direction)))
    if np.dot(axis, direction) >= np.cos(np.radians(10.0)):
        return name
    return "[" + ", ".join(f"{value:.4g}" for value in direction) + "]"


def find_up(surface: Surface) -> tuple[list[Orientation], bool]:
    """The directions that may be up, the likeliest first, and whether the first is clearly up.

    They are those that large flat surfaces face, and the opposite ones, exact by fitted planes. Up
    is where most stands on these: things gather on floors. It is clear where no other direction has
    as much. Of two that are alike, that nearer to +z comes first.
    """
    center, normal, area = surface
    found = [_find_planes(axis, surface) for axis in _find_axes(normal, area)]
    largest = max((planes[0].size for planes in found if planes), default=0.0)
    rest = np.ones(len(area), dtype=np.bool_)
    for plane in (plane for planes in found for plane in planes if plane.size > WALL * largest):
        rest &= ~plane.own
    center = center[rest]
    area = area[rest]
    ups = list[Orientation]()
    for planes in found:
        flats = [plane for plane in planes if plane.size >= FLOOR * largest]
        for way in (1.0, -1.0):
            floors = [plane for plane in flats if way * plane.facing >= -AWAY * plane.size]
            if not floors:
                continue
            up = way * floors[0].normal
            stands = np.zeros(len(area), dtype=np.bool_)
            for plane in floors:
                height = (center - plane.middle) @ up
                stands |= (height >= STANDING[0]) & (height <= STANDING[1])
            ups.append(Orientation(up, floors[0].size, float(area[stands].sum())))
    ups.sort(
        key=lambda one: -round(one.standing + SIZE_WEIGHT * one.size, 3) - 1e-6 * one.direction[2]
    )
    least = [CLEAR[0] * ups[0].size, *(CLEAR[1] * one.standing for one in ups[1:])]
    return ups, ups[0].size >= LEAST and ups[0].standing > max(least)


def sample_surface(parts: Collection[NamedMesh]) -> Surface:
    """Take `MOST_TRIANGLES` triangles of parts."""
    step = max(1, -(-sum(len(part.faces) for part in parts) // MOST_TRIANGLES))
    found = [describe_triangles(part.vertices, part.faces[::step].copy()) for part in parts]
    center, normal, area = map(np.concatenate, zip(*found, strict=True))
    return Surface(center, normal, area * step)


def list_axes() -> Float:
    """`NUM_AXES` directions of a hemisphere, by ascending z: Fibonacci's lattice."""
    number = np.arange(NUM_AXES)
    up = (number + 0.5) / NUM_AXES
    turn = np.pi * (3.0 - np.sqrt(5.0)) * number
    wide = np.sqrt(1.0 - up * up)
    return np.stack([wide * np.cos(turn), wide * np.sin(turn), up], axis=1)


def _find_axes(normal: Float, area: Float) -> list[Float]:
    """Up to four directions in which most of the surface faces, either way."""
    axes = list_axes()
    nearest = np.zeros(len(normal), dtype=np.int64)
    run_in_chunks(find_nearest_axes, len(normal), normal, axes, NEAR, nearest, least=1024)
    count = (np.abs(axes @ axes.T) >= FACING) @ np.bincount(nearest, area, NUM_AXES)
    found: list[Float] = []
    for _ in range(4):
        best = start = axes[count.argmax()]
        for _ in range(4):  # to the mean direction of what faces that way
            own = np.abs(normal @ best) >= FACING
            best = np.linalg.eigh((normal[own] * area[own, None]).T @ normal[own])[1][:, 2]
        if all(abs(best @ other) < FACING for other in found):
            found.append(best)
        count[(np.abs(axes @ best) >= APART) | (np.abs(axes @ start) >= APART)] = 0.0
        if not count.any():
            break
    return found


class _Plane(NamedTuple):
    size: float
    facing: float  # the part of it that faces along the normal, less what faces away [m²]
    middle: Float
    normal: Float
    own: Bool  # its triangles


def _find_planes(axis: Float, surface: Surface) -> list[_Plane]:
    """The largest flat surfaces that face along an axis, the largest first."""
    left = np.flatnonzero(np.abs(surface.normal @ axis) >= FACING)
    planes = list[_Plane]()
    slot, slots = np.unique(np.floor(surface.center[left] @ axis / THICK), return_inverse=True)
    for _ in range(PLANES):
        if not len(left):
            break
        center, normal, area = (array[left] for array in surface)
        middle = axis * slot[np.bincount(slots, area).argmax()] * THICK
        best = axis
        own = np.abs((center - middle) @ axis) <= 2 * THICK
        for _ in range(4):  # fitted to what lies near it
            total = area[own].sum()
            middle = area[own] @ center[own] / total
            apart = center[own] - middle
            spread, ways = np.linalg.eigh((apart * area[own, None]).T @ apart)
            if spread[1] > 0.04 * total:  # a strip says little of its normal
                best = ways[:, 0] if ways[:, 0] @ axis > 0 else -ways[:, 0]
            near = np.abs((center - middle) @ best) <= THICK
            own = near if near.any() else own
        facing = float(area[own] @ np.sign(normal[own] @ best))
        mask = np.zeros(len(surface.area), dtype=np.bool_)
        mask[left[own]] = True
        planes.append(_Plane(float(area[own].sum()), facing, middle, best, mask))
        left = left[~own]
        slots = slots[~own]
    return sorted(planes, key=lambda plane: -plane.size)
