"""Small scenes that are easily baked wrong.

Each is named after the file in `SHARED_DATA` that is equal in meaning. Where boxes make it up, in
whole or but for thin things, they are listed, so that a test can say exactly what they occupy.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import trimesh

from box_truth import Corners
from box_worlds import box, world
from project_paths import SHARED_DATA

SHARED = SHARED_DATA / "hard_cases"
GROUND = '<geom name="ground" type="plane" size="0 0 1"/>'


class Case(NamedTuple):
    """A scene and how to bake it.

    Attributes:
        scene: an MJCF text, or a mesh.
        boxes: those that it has, apart from what the text or the mesh adds.
        settings: but for the path, as in the YAML.
        mesh: the mesh file that the MJCF names.
    """

    scene: str | trimesh.Trimesh
    boxes: list[Corners]
    settings: dict[str, Any] = {}  # noqa: RUF012  # never written to
    mesh: tuple[str, trimesh.Trimesh] | None = None


def write_case(folder: Path, name: str) -> Path:
    """Write a scene, and give its path."""
    case = CASES[name]
    path = folder / name
    if isinstance(case.scene, str):
        path.write_text(case.scene, encoding="utf-8")
    else:
        case.scene.export(path)
    if case.mesh is not None:
        file, mesh = case.mesh
        mesh.export(folder / file)
    return path


def of_boxes(boxes: list[Corners], more: str = "", **settings: Any) -> Case:
    """Boxes, and other geoms."""
    return Case(world("".join(box("", *corners) for corners in boxes) + more), boxes, settings)


def one_mesh(boxes: list[Corners], *more: trimesh.Trimesh, **settings: Any) -> Case:
    """Boxes and other meshes as one mesh."""
    return Case(joined(*more, *(solid(*corners) for corners in boxes)), boxes, settings)


def solid(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> trimesh.Trimesh:
    """A box as a closed mesh, whose triangles face outwards."""
    return trimesh.creation.box(bounds=[[x0, y0, z0], [x1, y1, z1]])


def sheet(x0: float, y0: float, x1: float, y1: float, z: float) -> trimesh.Trimesh:
    """A rectangle of two triangles that face up."""
    corners = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


def house_on_slab(slab: float, end: float) -> list[Corners]:
    """A house with a door 1 m wide on a slab; its walls end at a height, the ceiling is at 2.6."""
    return [
        (0, 0, 0, 8, 8, slab),
        (0, 0, 0, 3.5, 0.15, end),
        (4.5, 0, 0, 8, 0.15, end),
        (0, 7.85, 0, 8, 8, end),
        (0, 0, 0, 0.15, 8, end),
        (7.85, 0, 0, 8, 8, end),
        (0, 0, 2.6, 8, 8, 2.8),
    ]


# they only stretch the grid: an endless plane does not count towards it
STONES: list[Corners] = [(-3, 0, 0, -2.9, 0.1, 0.1), (10.9, 7.9, 0, 11, 8, 0.1)]


def walls(top: float) -> list[Corners]:
    """Four walls 0.2 m thick, their middles along the edges of a square of 8 m."""
    return [
        (-4.1, -4.1, 0, -3.9, 4.1, top),
        (3.9, -4.1, 0, 4.1, 4.1, top),
        (-4.1, -4.1, 0, 4.1, -3.9, top),
        (-4.1, 3.9, 0, 4.1, 4.1, top),
    ]


WINDOW: list[Corners] = [
    (-4.1, -2.1, -0.1, 4.1, 2.1, 0),
    (-4.1, 2.0, 0, 4.1, 2.1, 2.6),
    (-4.1, -2.1, 0, 4.1, -2.0, 2.6),
    (-4.1, -2.1, 0, -4.0, 2.1, 2.6),
    (4.0, -2.1, 0, 4.1, 2.1, 2.6),
    (-0.05, 1.0, 0, 0.05, 2.0, 2.6),
    (-0.05, -2.0, 0, 0.05, -1.0, 2.6),
    (-0.05, -1.0, 0, 0.05, 1.0, 0.9),
    (-0.05, -1.0, 2.1, 0.05, 1.0, 2.6),
]
GARAGE: list[Corners] = [
    (-3, -3, -0.3, 11, 9, 0),
    (0, 0, 0, 3.35, 0.15, 2.5),
    (4.65, 0, 0, 8, 0.15, 2.5),
    (0, 5.85, 0, 8, 6, 2.5),
    (0, 0, 0, 0.15, 6, 2.5),
    (7.85, 0, 0, 8, 6, 2.5),
    (0, 0, 2.5, 8, 6, 2.7),
]
RACK: list[Corners] = [
    (-3, -3, -0.1, 12, 6, 0),
    (0, 0, 0.1, 8.1, 1.1, 0.2),
    (0, 0, 1.6, 8.1, 1.1, 1.7),
    (0, 0, 3.1, 8.1, 1.1, 3.2),
]
THICK_WALLS: list[Corners] = [
    (0, 0, -0.1, 5, 5, 0),
    (5.8, 0, -0.1, 10.8, 5, 0),
    (5, 2, -0.1, 5.8, 3, 0),
    (-0.8, -0.8, -0.1, 11.6, 0, 2.5),
    (-0.8, 5, -0.1, 11.6, 5.8, 2.5),
    (-0.8, 0, -0.1, 0, 5, 2.5),
    (10.8, 0, -0.1, 11.6, 5, 2.5),
    (5, 0, -0.1, 5.8, 2, 2.5),
    (5, 3, -0.1, 5.8, 5, 2.5),
]
CLOSET: list[Corners] = [
    (-5, -5, -0.02, 5, 5, 0),
    (-0.65, -2.5, 0, -0.55, 2.5, 2.8),
    (0.55, -2.5, 0, 0.65, 2.5, 2.8),
    (-0.65, -2.55, 0, 0.65, -2.45, 2.8),
    (-0.65, 2.45, 0, 0.65, 2.55, 2.8),
    (-0.65, -2.55, 2.8, 0.65, 2.55, 2.9),
    (-0.03, 2.55, 2.8, 0.13, 4.95, 2.9),
]
CRACK: list[Corners] = [
    (-5.0025, -2.5, 2.9, -0.0025, 2.5, 3.1),
    (0.0025, -2.5, 2.9, 5.0025, 2.5, 3.1),
    (-5.05, 2.48, 3.1, 5.05, 2.52, 4.1),
]
BARN: list[Corners] = [
    (-20, -20, -0.2, 20, 20, 0),
    (7.9, -5, 0, 8.1, 5, 4),
    (13.9, -5, 0, 14.1, 5, 4),
    (7.9, -5, 7.9, 14.1, 5, 8.1),
]
PANEL = """<geom type="cylinder" size=".1 .8" pos="0 0 .8"/>
<geom type="box" size="2 1 .02" pos="0 0 2" euler="30 0 0"/>"""
SOFA: Corners = (0.2, 0.6, 0, 1.8, 1.4, 0.8)
HULL = [(-4.1, -4.1, -0.1, 4.1, 4.1, 0), *walls(2.5)]
CASES: dict[str, Case] = {
    "1_thin_wall.xml": of_boxes(
        [(-2, -2, -0.2, 2, 2, 0)], '<geom type="plane" size="2 2 .1" pos="0 0 1" zaxis="1 0 0"/>'
    ),
    "1b_thick_wall_one_mesh.obj": one_mesh([(-0.1, -2, 0, 0.1, 2, 2.5)], sheet(-2, -2, 2, 2, 0)),
    "2_house_walls_1mm_short.xml": of_boxes(
        STONES + house_on_slab(0.1, 2.599), GROUND, grid={"cell_size": 0.05}
    ),
    "2_house_walls_end_at_ceiling.xml": of_boxes(
        STONES + house_on_slab(0.1, 2.6), GROUND, grid={"cell_size": 0.05}
    ),
    "2_house_walls_1mm_into_ceiling.xml": of_boxes(
        STONES + house_on_slab(0.1, 2.601), GROUND, grid={"cell_size": 0.05}
    ),
    "3_crate_one_mesh.obj": one_mesh([(-1.47, -1.47, 0, 1.53, 1.53, 2.5)], sheet(-5, -5, 5, 5, 0)),
    "4_garage.xml": of_boxes(GARAGE),
    "4b_rack.xml": of_boxes(RACK),
    "5_thick_walls.xml": of_boxes(THICK_WALLS),
    "6_dock.xml": of_boxes(
        [(-8, -6, -0.2, 8, 6, 0), (1, -2, 0, 5, 2, 1)],
        '<geom type="box" pos="-1 0 .45" size="2.1 .6 .05" euler="0 -14.2 0"/>',
    ),
    "7_ramp15.xml": of_boxes(
        [(-6, -3, -0.2, 0, 3, 0), (3.73205, -3, 0.8, 8.73205, 3, 1.0)],
        '<geom type="box" pos="1.85308 0 .451704" size="1.93185 3 .05" euler="0 -15 0"/>',
        grid={"cell_size": 0.02},
    ),
    "8_building_hull.xml": Case(
        world(
            '<geom name="house" type="mesh" mesh="house"/>' + box("sofa", *SOFA),
            '<mesh name="house" file="8_house.stl"/>',
        ),
        [*HULL, SOFA],
        {},
        ("8_house.stl", joined(*(solid(*corners) for corners in HULL))),
    ),
    "9_stray_triangle.stl": one_mesh(
        [(-5, -5, -0.1, 5, 5, 0), (-1, -1, -0.01, 1, 1, 2.99)],
        trimesh.Trimesh([[4, 4, 1], [4.1, 4, 1], [4, 4.1, 1]], [[0, 1, 2]]),
        scene={"meshes": "surface"},
    ),
    "10_counter_under_sheet.stl": one_mesh(
        [(-4, -4, -0.2, 4, 4, 0), (-1.03, -1.03, 0, 1.03, 1.03, 1), *walls(3)],
        sheet(-4, -4, 4, 4, 3),
        scene={"meshes": "surface"},
    ),
    "11_closet_with_beam.xml": of_boxes(CLOSET, GROUND),
    # the storey is open to the sky and has no walls: it is a floor only where roofs are
    "12_crack.xml": of_boxes(CRACK, GROUND, floors={"roofs": True}),
    "13_window.xml": of_boxes(WINDOW),
    "13_window.stl": one_mesh(WINDOW, scene={"meshes": "surface"}),
    "14_panel_and_barn.xml": of_boxes(BARN, PANEL),
    "15_corner.xml": of_boxes([(-6, -6, -0.1, 6, 6, 0), (-3, -2, 0, 3, 2, 2)]),
}
