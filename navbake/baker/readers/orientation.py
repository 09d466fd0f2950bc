"""Finds the up direction of a mesh: the direction that the floors with the most furniture face.

A sample of the triangles is taken. The directions that most of its area faces are searched
(`_find_axes`), and along each direction the largest flat surfaces (`_find_planes`). The large ones
of these surfaces are floors, and each direction that floors face may be up. Most things stand on
floors and not on walls or ceilings, so the direction with most area a little above its floors is
taken as up (`find_orientations`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navbake.baker.geometry.shapes import drop_unused_vertices, triangle_areas
from navbake.baker.geometry.triangle_kernels import describe_triangles, find_nearest_axes
from navbake.baker.readers.mesh import (
    AXIS_VECTORS,
    Direction,
    NamedMesh,
    make_rotation_to_z_up,
    measure_mesh_bounds,
    read_up_axis,
)
from navbake.config.settings import SceneSettings
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float

MIN_PIECE_AREA = 0.1  # smaller connected pieces of a scan are left out [m²]
# About the most triangles that are sampled: of a larger mesh every second, third, … triangle is
MAX_TRIANGLES = 30_000
# A mesh may lie on its side if more than this many times as much area faces along y as along z
ON_SIDE_RATIO = 1.5
CEILING_WARNING = "this floor may be a ceiling: what stands in the mesh doesn't say which way is up"
NUM_AXES = 400  # how many directions of a hemisphere triangles are sorted into, about 7° apart
# The largest distance of a unit vector, or its opposite, from the nearest of these directions
MAX_AXIS_DISTANCE = 0.12
# A triangle belongs to a direction or a plane if the cosine between the normals is at least this
# (scans are noisy)
MIN_FACING_COSINE = np.cos(np.radians(30.0))
# Directions nearer than this to one that was found are not searched again
MAX_DISTINCT_COSINE = np.cos(np.radians(40.0))
MAX_SEARCHED_AXES = 4
MAX_PLANES = 4  # the most flat surfaces that are searched along an axis
NUM_FIT_ITERATIONS = 4  # the number of iterations that fit an axis or a plane
PLANE_THICKNESS = 0.08  # a flat surface lies within this distance of its plane, on both sides [m]
# A plane's normal is only fitted if the plane's triangles have more variance than this along its
# narrower direction: a strip says little about its normal [m²]
MIN_PLANE_VARIANCE = 0.04
# If at least this share of a plane's area faces within the angle of `PLANE_COSINE` of its normal,
# as in drawn buildings, the mean of these triangles' normals is more exact than a fit
MIN_EXACT_SHARE = 0.5
PLANE_COSINE = np.cos(np.radians(2.0))
# Heights above a floor between which a surface counts as furniture [m]
MIN_FURNITURE_HEIGHT = 0.12
MAX_FURNITURE_HEIGHT = 1.1
# A floor has at least this fraction of the area of the largest flat surface; a flat surface with
# more than the second fraction is no furniture
MIN_FLOOR_SHARE = 0.5
MAX_FURNITURE_PLANE_SHARE = 0.25
# In a floor, the area of triangles that face down may exceed the area of those that face up by this
# fraction of the floor's area
MAX_DOWN_SHARE = 0.2
FLOOR_WEIGHT = 0.1  # weight of a floor's area, where the area of the furniture on it has weight 1
MIN_FLOOR_AREA = 4.0  # a mesh whose largest flat surface is smaller may be furniture [m²]
# It is clear which direction is up if the furniture's area is more than this fraction of the
# floor's area, and more than this many times the furniture's area in any other direction
MIN_CLEAR_SHARE = 0.1
MIN_CLEAR_RATIO = 1.3
# y may be up, rather than z, if floors and furniture along it score this many times as much
MIN_HINT_RATIO = 1.5


class Orientation(NamedTuple):
    """A direction of a mesh that may be up.

    Attributes:
        direction: unit vector in the frame of the mesh, (3,).
        floor_area: area of the largest floor that faces this direction [m²].
        furniture_area: area of the triangles that seem to be furniture on such floors [m²]: they
            are `MIN_FURNITURE_HEIGHT` to `MAX_FURNITURE_HEIGHT` above them, and belong to no large
            flat surface.
    """

    direction: Float
    floor_area: float
    furniture_area: float


class TriangleSample(NamedTuple):
    """A sample of a mesh's triangles.

    Attributes:
        center: the triangles' centres, (n, 3) [m].
        normal: the triangles' unit normals, (n, 3).
        area: the area that each triangle stands for, (n,) [m²]. If every k-th triangle of the mesh
            is in the sample, it is k times the triangle's own area.
    """

    center: Float
    normal: Float
    area: Float


def orient_meshes(
    read_meshes: Callable[..., list[NamedMesh]], settings: SceneSettings, warnings: list[str]
) -> list[NamedMesh]:
    """Read the meshes of a file, and turn them so that the direction of `scene.up` is up.

    - ``auto``, if the file states an axis: that axis.
    - ``auto``, if the file of a scan states none: as for ``level``.
    - ``auto``, if another file states none: z. But it is an axis near y, and a warning says so, if
      the mesh looks as if it lay on its side (`lies_on_side`), and things clearly stand on surfaces
      that face along y. Where only one of these two is so, a warning asks for `scene.up`.
    - ``level``: the direction that `find_orientations` finds from the floors of the mesh.
    - otherwise the axis or the vector that the setting states.

    Args:
        read_meshes: a function with the keyword ``up``, the direction in the file that is up;
            returns the meshes in the world frame [m].
        settings: `scene.up`, `scene.scan` and `scene.path` are used.
        warnings: the list to which warnings are added, for example if the orientation looks wrong.

    Returns:
        The meshes in the world frame [m].
    """
    file_axis = read_up_axis(Path(settings.path)) if settings.up == "auto" else None
    is_auto_without_axis = settings.up == "auto" and file_axis is None
    is_up_searched = settings.up == "level" or (is_auto_without_axis and settings.scan)
    up = (file_axis or "z") if settings.up in ("auto", "level") else settings.up
    meshes = read_meshes(up=up)
    if settings.scan:
        meshes = drop_small_pieces(meshes, warnings)
    sample = sample_triangles(meshes)
    orientations, is_clear = find_orientations(sample)
    best_orientation = orientations[0]
    if is_up_searched:
        if not is_clear:
            opposite_name = _name_direction(-best_orientation.direction)
            warnings.append(f"{CEILING_WARNING}: `scene.up: {opposite_name}` turns the mesh over")
        return _turn_up(meshes, best_orientation.direction)
    to_file_frame = make_rotation_to_z_up(up).T  # from the world frame
    best_direction_in_file = to_file_frame @ best_orientation.direction
    is_turned = is_auto_without_axis and lies_on_side(meshes, sample)
    if is_turned and is_clear and abs(best_orientation.direction[1]) > MIN_FACING_COSINE:
        direction_name = _name_direction(best_direction_in_file)
        warnings.append(
            f"the mesh lies on its side, and is taken with {direction_name} up, as things stand on "
            f"what faces that way: `scene.up: {direction_name}` silences this, `z` leaves it as it "
            "is"
        )
        return _turn_up(meshes, AXIS_VECTORS.get(direction_name, best_orientation.direction))
    if is_clear and best_orientation.direction[2] < -MIN_FACING_COSINE:
        hint = f"`scene.up: {_name_direction(best_direction_in_file)}` turns the mesh over"
        if is_auto_without_axis:
            hint += ", `scene.up: y` is right if the file has y up, as many have that state no axis"
        warnings.append(
            f"this floor may be a ceiling: next to nothing stands on it, and "
            f"{best_orientation.furniture_area:.1f} m² hang from a surface like it above: {hint}"
        )
    elif is_auto_without_axis and _is_y_likelier(orientations):
        warnings.append(
            "more stands on what faces along y than on what faces along z: if the file has y up, "
            "set `scene.up` to y (z silences this)"
        )
    elif settings.up == "auto" and lies_on_side(meshes, sample):
        axis_name = _name_direction(np.abs(to_file_frame[:, 1]))
        warnings.append(
            f"the mesh is lowest along {axis_name}, and most of its surface faces along "
            f"{axis_name}: if it lies on its side, set `scene.up` to {axis_name} ({up} silences "
            "this)"
        )
    return meshes


def drop_small_pieces(meshes: list[NamedMesh], warnings: list[str]) -> list[NamedMesh]:
    """Drop connected pieces of a scan that are smaller than `MIN_PIECE_AREA`, with a warning.

    Scans contain people, reflections and dust as small pieces in mid-air.

    Args:
        meshes: the meshes of the scan, world frame [m].
        warnings: the list to which a warning is added if pieces are dropped.

    Returns:
        The meshes without these pieces; all meshes if nothing would be left.
    """
    from scipy.sparse import coo_array, csgraph  # scipy loads slowly, and few bake scans

    large_meshes = list[NamedMesh]()
    num_dropped = 0
    dropped_area = 0.0
    for mesh in meshes:
        # Vertices with the same coordinates are one point: pieces are connected through it.
        _, point_of_vertex = np.unique(mesh.vertices, axis=0, return_inverse=True)
        corner_points = point_of_vertex.reshape(-1)[mesh.faces]
        num_points = int(corner_points.max()) + 1
        edge_starts = corner_points[:, [0, 1]].ravel()
        edge_ends = corner_points[:, [1, 2]].ravel()
        edges = coo_array(
            (np.ones(len(edge_starts), dtype=np.bool_), (edge_starts, edge_ends)),
            shape=(num_points, num_points),
        )
        _, piece_of_point = csgraph.connected_components(edges, directed=False)
        piece_of_face = piece_of_point[corner_points[:, 0]]
        areas = np.bincount(piece_of_face, triangle_areas(mesh.vertices, mesh.faces))
        is_small = (areas > 0.0) & (areas < MIN_PIECE_AREA)
        num_dropped += int(is_small.sum())
        dropped_area += float(areas[is_small].sum())
        faces = mesh.faces[~is_small[piece_of_face]]
        vertices, faces = drop_unused_vertices(mesh.vertices, faces)
        if len(faces):
            large_meshes.append(NamedMesh(mesh.name, vertices, faces))
    if not large_meshes or not num_dropped:
        return meshes
    areas_text = f"each smaller than {MIN_PIECE_AREA} m² and {dropped_area:.2f} m² in all"
    warnings.append(f"{num_dropped} pieces of the scan, {areas_text}, are left out (`scene.scan`)")
    return large_meshes


def _turn_up(meshes: list[NamedMesh], up: Direction) -> list[NamedMesh]:
    """Rotate meshes so that the direction `up` becomes +z."""
    rotation = make_rotation_to_z_up(up)
    return [mesh._replace(vertices=mesh.vertices @ rotation.T) for mesh in meshes]


def is_shortest_along_y(meshes: Collection[NamedMesh]) -> bool:
    """Return whether the bounding box of meshes in the world frame is smallest along y.

    Args:
        meshes: the meshes, world frame [m].
    """
    lowest_corner, highest_corner = measure_mesh_bounds(meshes)
    width, depth, height = np.subtract(highest_corner, lowest_corner)
    return bool(depth < min(width, height))


def lies_on_side(meshes: Collection[NamedMesh], sample: TriangleSample) -> bool:
    """Return whether a mesh in the world frame looks as if its y axis were vertical.

    This is so if its bounding box is smallest along y, and the area whose normal is within 45° of
    y (or -y) is more than `ON_SIDE_RATIO` times the area whose normal is within 45° of z (or -z).

    Args:
        meshes: the meshes, world frame [m].
        sample: a sample of their triangles.
    """
    is_facing_y = np.abs(sample.normal[:, 1]) >= np.sqrt(0.5)
    is_facing_z = np.abs(sample.normal[:, 2]) >= np.sqrt(0.5)
    y_area = sample.area[is_facing_y].sum()
    z_area = sample.area[is_facing_z].sum()
    return bool(y_area > ON_SIDE_RATIO * z_area) and is_shortest_along_y(meshes)


def _name_direction(direction: Float) -> str:
    """Write a direction as a value of `scene.up`: an axis within 10°, or else its components."""
    name, axis = max(
        AXIS_VECTORS.items(), key=lambda name_and_axis: float(np.dot(name_and_axis[1], direction))
    )
    if np.dot(axis, direction) >= np.cos(np.radians(10.0)):
        return name
    return "[" + ", ".join(f"{value:.4g}" for value in direction) + "]"


def find_orientations(sample: TriangleSample) -> tuple[list[Orientation], bool]:
    """Find the directions of a mesh that may be up, the likeliest first.

    A direction may be up if a large flat surface is perpendicular to it, and doesn't clearly face
    the other way; if nothing is flat, +z may be. A direction is the likelier, the more furniture
    stands on its floors and, with less weight, the larger its largest floor is. Of equally likely
    directions, the one nearer to +z comes first.

    Args:
        sample: a sample of the mesh's triangles.

    Returns:
        The directions; and whether the first one is clearly up: its floor is large, there is much
        furniture on it, and clearly more than for any other direction.
    """
    planes_of_axes = [_find_planes(axis, sample) for axis in _find_axes(sample.normal, sample.area)]
    largest_area = max((planes[0].area for planes in planes_of_axes if planes), default=0.0)
    may_be_furniture = np.ones(len(sample.area), dtype=np.bool_)
    for planes in planes_of_axes:
        for plane in planes:
            if plane.area > MAX_FURNITURE_PLANE_SHARE * largest_area:
                may_be_furniture &= ~plane.is_member
    furniture_center = sample.center[may_be_furniture]
    furniture_area = sample.area[may_be_furniture]
    orientations = list[Orientation]()
    for planes in planes_of_axes:
        large_planes = [plane for plane in planes if plane.area >= MIN_FLOOR_SHARE * largest_area]
        for sign in (1.0, -1.0):
            floors = [
                plane
                for plane in large_planes
                if sign * plane.net_facing_area >= -MAX_DOWN_SHARE * plane.area
            ]
            if not floors:
                continue
            up = sign * floors[0].normal
            stands_on_floor = np.zeros(len(furniture_area), dtype=np.bool_)
            for plane in floors:
                height = (furniture_center - plane.center) @ up
                stands_on_floor |= (height >= MIN_FURNITURE_HEIGHT) & (
                    height <= MAX_FURNITURE_HEIGHT
                )
            orientations.append(
                Orientation(
                    direction=up,
                    floor_area=floors[0].area,
                    furniture_area=float(furniture_area[stands_on_floor].sum()),
                )
            )
    if not orientations:  # nothing is flat
        orientations.append(
            Orientation(np.array([0.0, 0.0, 1.0]), floor_area=0.0, furniture_area=0.0)
        )
    orientations.sort(key=_make_sort_key)
    best_orientation = orientations[0]
    is_clear = _is_furnished(best_orientation) and all(
        best_orientation.furniture_area > MIN_CLEAR_RATIO * orientation.furniture_area
        for orientation in orientations[1:]
    )
    return orientations, is_clear


def _is_furnished(orientation: Orientation) -> bool:
    """Return whether a direction has a large floor, and much furniture on its floors."""
    return (
        orientation.floor_area >= MIN_FLOOR_AREA
        and orientation.furniture_area > MIN_CLEAR_SHARE * orientation.floor_area
    )


def _score(orientation: Orientation) -> float:
    """Return how likely a direction is up; higher is likelier [m²]."""
    return round(orientation.furniture_area + FLOOR_WEIGHT * orientation.floor_area, 3)


def _make_sort_key(orientation: Orientation) -> float:
    """Return a number by which to sort directions: the likelier a direction is up, the lower."""
    return float(-_score(orientation) - 1e-6 * orientation.direction[2])


def _is_y_likelier(orientations: list[Orientation]) -> bool:
    """Return whether y or -y is by far the likeliest direction to be up, rather than z.

    Args:
        orientations: the directions in the world frame that may be up, the likeliest first.
    """
    best_orientation = orientations[0]
    is_along_y = abs(best_orientation.direction[1]) > MIN_FACING_COSINE
    upright_score = max(
        (
            _score(orientation)
            for orientation in orientations
            if orientation.direction[2] > MIN_FACING_COSINE
        ),
        default=0.0,
    )
    is_likelier = _score(best_orientation) > MIN_HINT_RATIO * upright_score
    return bool(is_along_y and is_likelier and _is_furnished(best_orientation))


def sample_triangles(meshes: Collection[NamedMesh]) -> TriangleSample:
    """Sample every n-th triangle of meshes, about `MAX_TRIANGLES` at most.

    Args:
        meshes: the meshes [m].
    """
    num_triangles = sum(len(mesh.faces) for mesh in meshes)
    sampling_step = max(1, -(-num_triangles // MAX_TRIANGLES))
    described_triangles = [
        describe_triangles(mesh.vertices, mesh.faces[::sampling_step].copy()) for mesh in meshes
    ]
    centers, normals, areas = zip(*described_triangles, strict=True)
    return TriangleSample(
        center=np.concatenate(centers),
        normal=np.concatenate(normals),
        area=np.concatenate(areas) * sampling_step,
    )


def list_axes() -> Float:
    """Return `NUM_AXES` evenly spread unit vectors with z > 0, (n, 3), by ascending z.

    They are a Fibonacci lattice.
    """
    axis_number = np.arange(NUM_AXES)
    z = (axis_number + 0.5) / NUM_AXES
    angle = np.pi * (3.0 - np.sqrt(5.0)) * axis_number
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _find_axes(normal: Float, area: Float) -> list[Float]:
    """Find the directions that most of a mesh's area faces, up to `MAX_SEARCHED_AXES`.

    A triangle counts for its normal and for the opposite direction.

    Args:
        normal: the triangles' unit normals, (n, 3).
        area: the triangles' areas, (n,) [m²].

    Returns:
        Unit vectors, (3,) each.
    """
    axes = list_axes()
    nearest_axis = np.zeros(len(normal), dtype=np.int64)
    run_in_chunks(
        find_nearest_axes,
        len(normal),
        normal,
        axes,
        MAX_AXIS_DISTANCE,
        nearest_axis,
        min_chunk_size=1024,
    )
    area_of_axis = np.bincount(nearest_axis, area, NUM_AXES)
    faced_axes = np.flatnonzero(area_of_axis)  # few, as in most scenes most surfaces are flat
    is_near_faced_axis = np.abs(axes @ axes[faced_axes].T) >= MIN_FACING_COSINE
    facing_area = is_near_faced_axis @ area_of_axis[faced_axes]
    area_normal = normal * area[:, None]
    directions: list[Float] = []
    for _ in range(MAX_SEARCHED_AXES):
        start_axis = axes[facing_area.argmax()]
        direction = _fit_axis(start_axis, normal, area_normal)
        if all(
            abs(direction @ earlier_direction) < MIN_FACING_COSINE
            for earlier_direction in directions
        ):
            directions.append(direction)
        is_near = np.abs(axes @ direction) >= MAX_DISTINCT_COSINE
        is_near |= np.abs(axes @ start_axis) >= MAX_DISTINCT_COSINE
        facing_area[is_near] = 0.0
        if not facing_area.any():
            break
    return directions


def _fit_axis(axis: Float, normal: Float, area_normal: Float) -> Float:
    """Return the mean direction of the triangles that face nearly along an axis, or against it.

    The triangles are selected again by the mean direction, up to `NUM_FIT_ITERATIONS` times.

    Args:
        axis: a unit vector, (3,).
        normal: the triangles' unit normals, (n, 3).
        area_normal: these normals times the triangles' areas, (n, 3) [m²].

    Returns:
        A unit vector, (3,).
    """
    is_facing = np.empty(0, dtype=np.bool_)  # no triangles were selected before
    for _ in range(NUM_FIT_ITERATIONS):
        was_facing = is_facing
        is_facing = np.abs(normal @ axis) >= MIN_FACING_COSINE
        if np.array_equal(is_facing, was_facing):  # no further iteration changes anything
            break
        triangles = np.flatnonzero(is_facing)
        # the eigenvector of the largest eigenvalue
        covariance = area_normal.take(triangles, axis=0).T @ normal.take(triangles, axis=0)
        axis = np.linalg.eigh(covariance)[1][:, 2]
    return axis


class _Plane(NamedTuple):
    """A flat surface of a mesh.

    Attributes:
        area: the area of its triangles [m²].
        net_facing_area: the area of its triangles that face along `normal`, less the area of its
            other triangles [m²].
        center: the triangles' mean centre, (3,) [m].
        normal: the plane's normal, a unit vector, (3,).
        is_member: for each triangle of the sample, whether it is part of the surface, (n,).
    """

    area: float
    net_facing_area: float
    center: Float
    normal: Float
    is_member: Bool


def _find_planes(axis: Float, sample: TriangleSample) -> list[_Plane]:
    """Find the largest flat surfaces perpendicular to an axis, the largest first.

    The axis is divided into slots of `PLANE_THICKNESS`. The slot with the most area is the first
    guess of a plane, which is then fitted to the triangles near it. They are removed, and the next
    plane is searched among the remaining triangles.

    Args:
        axis: a unit vector, (3,).
        sample: a sample of the mesh's triangles.

    Returns:
        Up to `MAX_PLANES` flat surfaces.
    """
    remaining_triangles = np.flatnonzero(np.abs(sample.normal @ axis) >= MIN_FACING_COSINE)
    planes = list[_Plane]()
    slot_numbers, slot_of_triangle = np.unique(
        np.floor(sample.center[remaining_triangles] @ axis / PLANE_THICKNESS), return_inverse=True
    )
    for _ in range(MAX_PLANES):
        if not len(remaining_triangles):
            break
        centers = sample.center[remaining_triangles]
        areas = sample.area[remaining_triangles]
        largest_slot = np.bincount(slot_of_triangle, areas).argmax()
        center = axis * slot_numbers[largest_slot] * PLANE_THICKNESS
        normal = axis
        is_member = np.abs((centers - center) @ axis) <= 2 * PLANE_THICKNESS
        for _ in range(NUM_FIT_ITERATIONS):
            members = np.flatnonzero(is_member)
            member_areas = areas[members]
            total_area = member_areas.sum()
            member_centers = centers.take(members, axis=0)
            center = member_areas @ member_centers / total_area
            center_offsets = member_centers - center
            # The centres' principal axes, by ascending variance: the first is the plane's normal.
            variances, principal_axes = np.linalg.eigh(
                (center_offsets * member_areas[:, None]).T @ center_offsets
            )
            if variances[1] > MIN_PLANE_VARIANCE * total_area:
                normal = principal_axes[:, 0]
                if not normal @ axis > 0:
                    normal = -normal
            is_near = np.abs((centers - center) @ normal) <= PLANE_THICKNESS
            if np.array_equal(is_near, is_member):  # no further iteration changes anything
                break
            is_member = is_near if is_near.any() else is_member
        normals = sample.normal[remaining_triangles][is_member]
        normal = _refine_normal(normal, normals, areas[is_member])
        signs = np.sign(normals @ normal)
        is_member_of_sample = np.zeros(len(sample.area), dtype=np.bool_)
        is_member_of_sample[remaining_triangles[is_member]] = True
        planes.append(
            _Plane(
                area=float(areas[is_member].sum()),
                net_facing_area=float(areas[is_member] @ signs),
                center=center,
                normal=normal,
                is_member=is_member_of_sample,
            )
        )
        remaining_triangles = remaining_triangles[~is_member]
        slot_of_triangle = slot_of_triangle[~is_member]
    return sorted(planes, key=lambda plane: -plane.area)


def _refine_normal(plane_normal: Float, normals: Float, areas: Float) -> Float:
    """Return the mean normal of a plane's triangles if most of them face nearly along its own.

    In drawn buildings they do. There, a fit to the triangles' centres is up to a degree off where
    the top and the underside of a floor belong to one plane; in scans, the fit is better.

    Args:
        plane_normal: the fitted normal, a unit vector, (3,).
        normals: the unit normals of the plane's triangles, (n, 3).
        areas: their areas, (n,) [m²].

    Returns:
        The normal, a unit vector, (3,).
    """
    cosines = normals @ plane_normal
    is_near = np.abs(cosines) >= PLANE_COSINE
    if areas[is_near].sum() < MIN_EXACT_SHARE * areas.sum():
        return plane_normal
    mean_normal: Float = (areas * np.sign(cosines))[is_near] @ normals[is_near]
    return mean_normal / np.linalg.norm(mean_normal)
