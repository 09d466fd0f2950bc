"""Which way a mesh is up: as its file says, as it is set, or as what stands in it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from navbake.baker.bake.pipeline import run_bake
from navbake.baker.readers.mesh import AXIS_VECTORS, make_rotation_to_z_up
from navbake.config.settings import SceneSettings, parse_config
from navbake.types import Float
from scenes_alone import load_alone

GRID = 0.1  # edge of the triangles of a scan [m]


def sheet(corner, along, aside, hole=None) -> trimesh.Trimesh:
    """A rectangle of small triangles, without those in a hole (x0, y0, x1, y1)."""
    corner, along, aside = (np.array(v, dtype=float) for v in (corner, along, aside))
    m, n = (round(float(np.linalg.norm(v)) / GRID) for v in (along, aside))
    u, v = np.meshgrid(np.arange(m + 1) / m, np.arange(n + 1) / n, indexing="ij")
    points = corner + u.reshape(-1, 1) * along + v.reshape(-1, 1) * aside
    at = np.arange((m + 1) * (n + 1)).reshape(m + 1, n + 1)
    a, b, c, d = (k.ravel() for k in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    if hole is not None:
        x, y = points[faces].mean(axis=1)[:, :2].T
        faces = faces[~((x > hole[0]) & (x < hole[2]) & (y > hole[1]) & (y < hole[3]))]
    return trimesh.Trimesh(points, faces, process=False)


def scan(path: Path, up: Float, *, bed: bool = True, pillar: bool = False) -> str:
    """A room of 5 x 4 x 2.5 m as a scanner sees it, with a hole of 1 m² in its floor."""
    hole = (3.0, 1.0, 4.0, 2.0)
    parts = [
        sheet((0, 0, 0), (5, 0, 0), (0, 4, 0), hole),
        sheet((0, 0, 2.5), (0, 4, 0), (5, 0, 0)),
        sheet((0, 0, 0), (0, 0, 2.5), (5, 0, 0)),
        sheet((0, 4, 0), (5, 0, 0), (0, 0, 2.5)),
        sheet((0, 0, 0), (0, 4, 0), (0, 0, 2.5)),
        sheet((5, 0, 0), (0, 0, 2.5), (0, 4, 0)),
    ]
    if bed:
        parts += [
            sheet((0.5, 2, 0.5), (1.6, 0, 0), (0, 1.9, 0)),
            sheet((0.5, 2, 0), (1.6, 0, 0), (0, 0, 0.5)),
            sheet((2.1, 2, 0), (0, 1.9, 0), (0, 0, 0.5)),
        ]
    if pillar:  # round the hole, up to the ceiling
        x0, y0, x1, y1 = hole
        for one, other in (((x0, y0), (x1, y0)), ((x1, y0), (x1, y1)), ((x1, y1), (x0, y1)),
                           ((x0, y1), (x0, y0))):  # fmt: skip
            along = (*np.subtract(other, one), 0)
            parts.append(sheet((*one, 0), along, (0, 0, 2.5)))
    mesh = trimesh.util.concatenate(parts)
    mesh.vertices = mesh.vertices @ make_rotation_to_z_up(up)  # from +z to `up`
    mesh.vertices += np.random.default_rng(1).normal(0, 0.004, mesh.vertices.shape)
    mesh.export(path)
    return str(path)


def bake(path: str, **scene):
    return run_bake(parse_config({"scene": {"path": path, **scene}}))


def ceilings(result) -> list[str]:
    return [text for text in result.warnings if "may be a ceiling" in text]


# ---------------------------------------------------------------- turning


@pytest.mark.parametrize("up", [*AXIS_VECTORS, (0.2, -0.9, 0.1), (0.3, 0.1, -2.0), (0, 1e-9, -1)])
def test_what_is_up_turns_to_z_and_nothing_is_mirrored(up):
    turn = make_rotation_to_z_up(up)
    vector = np.array(AXIS_VECTORS[up] if isinstance(up, str) else up)
    assert turn @ (vector / np.linalg.norm(vector)) == pytest.approx([0, 0, 1], abs=1e-12)
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)
    if isinstance(up, str):
        assert set(np.abs(turn).ravel()) == {0.0, 1.0} and not np.signbit(turn[turn == 0]).any()


def test_axes_and_vectors_are_taken_as_they_are_set(tmp_path):
    path = tmp_path / "wedge.ply"
    trimesh.creation.box((1, 2, 3)).apply_translation((10, 20, 30)).export(path)

    def heights(up) -> list[float]:
        (part,) = load_alone(SceneSettings(path=path, up=up)).exact_meshes.values()
        return [float(part.vertices[:, 2].min()), float(part.vertices[:, 2].max())]

    assert heights("z") == heights([0.0, 0.0, 2.0]) == [28.5, 31.5]
    assert heights("-z") == [-31.5, -28.5]
    assert heights("-y") == heights([0.0, -0.5, 0.0]) == [-21, -19]
    assert heights("x") == [9.5, 10.5]


AXIS = "<unit meter='1'/><up_axis>{}</up_axis>"


@pytest.mark.parametrize(
    ("name", "said", "height"),
    [
        ("a.glb", "", 2), ("a.gltf", "", 2), ("a.ply", "", 3), ("a.obj", "", 3), ("a.stl", "", 3),
        ("a.dae", "Y_UP", 2), ("a.dae", "Z_UP", 3), ("a.dae", "X_UP", 1), ("a.dae", "", 3),
    ],
)  # fmt: skip
def test_auto_is_what_the_file_says(tmp_path, name, said, height):
    path = tmp_path / name
    trimesh.creation.box((1, 2, 3)).export(path)
    if name == "a.dae":
        text = path.read_text()
        begin, rest = text[: text.index("<asset>") + 7], text[text.index("</asset>") :]
        path.write_text(begin + (AXIS.format(said) if said else "") + rest)
    scene = load_alone(SceneSettings(path=path))
    assert np.diff(scene.bounds, axis=0)[0, 2] == pytest.approx(height)
    assert load_alone(SceneSettings(path=path, up="z")).bounds[1, 2] == pytest.approx(1.5)


# ---------------------------------------------------------------- scans


@pytest.mark.parametrize("down", [*AXIS_VECTORS, (0.3, -0.5, 0.8)])
def test_level_finds_the_floor_that_things_stand_on(tmp_path, down):
    up = -np.array(AXIS_VECTORS[down] if isinstance(down, str) else down)
    path = scan(tmp_path / "scan.ply", up)
    result = bake(path, up="level")
    (level,) = result.grid.levels
    heights = level.floor_height[level.free]
    assert np.abs(heights).max() < 0.03
    assert np.polyfit(np.arange(len(heights)), heights, 1)[0] == pytest.approx(0, abs=1e-5)
    assert not ceilings(result)


def test_level_is_exact(tmp_path):
    up = np.array([0.31, -0.52, 0.79]) / np.linalg.norm([0.31, -0.52, 0.79])
    path = scan(tmp_path / "scan.ply", up)
    (part,) = load_alone(SceneSettings(path=path, up="level")).exact_meshes.values()
    (file,) = load_alone(SceneSettings(path=path, up="z")).exact_meshes.values()
    turn = np.linalg.lstsq(file.vertices, part.vertices, rcond=None)[0].T
    assert np.degrees(np.arccos((turn @ up)[2])) < 0.1


def test_auto_takes_the_axis_of_a_scan_that_lies_on_its_side_and_says_so(tmp_path):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["-y"]))
    scene = load_alone(SceneSettings(path=path))
    (hint,) = scene.hints
    assert "is taken with -y up" in hint and "`scene.up: -y` silences this" in hint
    assert not load_alone(SceneSettings(path=path, up="-y")).warnings
    assert scene.bounds[1, 2] == pytest.approx(2.5, abs=0.05)
    # one that stands upright stays as it is
    assert not load_alone(
        SceneSettings(path=scan(tmp_path / "b.ply", np.array(AXIS_VECTORS["z"])))
    ).hints


@pytest.mark.parametrize("up", ["y", [0, 1.0, 0]])
def test_a_ceiling_is_told_from_a_floor(tmp_path, up):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["-y"]))
    (warning,) = ceilings(bake(path, up=up))
    assert "`scene.up: -y` turns the mesh over" in warning
    assert "has y up" not in warning


def test_a_ceiling_in_a_file_without_an_axis_may_be_a_wall(tmp_path):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["-z"]))
    (warning,) = ceilings(bake(path))
    assert "`scene.up: -z` turns the mesh over, `scene.up: y` is right if" in warning


def test_level_says_that_an_empty_room_may_be_either_way_up(tmp_path):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["-y"]), bed=False)
    (warning,) = ceilings(bake(path, up="level"))
    assert "doesn't say which way is up" in warning


def test_furnished_rooms_get_no_such_warning(tmp_path):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["z"]))
    assert not ceilings(bake(path)) and not ceilings(bake(path, up="level"))


# ---------------------------------------------------------------- drawn buildings


def drawn_house(path: Path, up: Float) -> str:
    """Two rooms of boxes, 6 x 4 m: their walls have more area than their floors."""
    boxes = [
        ((0, 0, -0.1), (6, 4, 0)),
        ((-0.1, -0.1, -0.1), (6.1, 0, 2.6)), ((-0.1, 4, -0.1), (6.1, 4.1, 2.6)),
        ((-0.1, 0, -0.1), (0, 4, 2.6)), ((6, 0, -0.1), (6.1, 4, 2.6)),
        ((2.95, 0, 0), (3.05, 1.5, 2.6)), ((2.95, 2.4, 0), (3.05, 4, 2.6)),
        ((4, 0.1, 0), (5.8, 0.9, 0.7)), ((1, 1, 0.7), (2, 2, 0.74)),
    ]  # fmt: skip
    mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in boxes])
    mesh.vertices = mesh.vertices @ make_rotation_to_z_up(up)  # from +z to `up`
    mesh.export(path)
    return str(path)


def hints_of_y(path: str, **settings) -> list[str]:
    scene = load_alone(SceneSettings(path=path, **settings))
    return [hint for hint in scene.hints if "has y up" in hint]


def test_a_house_whose_walls_outweigh_its_floors_gets_a_hint_of_y(tmp_path):
    y_up = drawn_house(tmp_path / "y.obj", np.array(AXIS_VECTORS["y"]))
    (hint,) = hints_of_y(y_up)
    assert "set `scene.up` to y (z silences this)" in hint
    assert not hints_of_y(y_up, up="y") and not hints_of_y(y_up, up="z")
    assert not hints_of_y(drawn_house(tmp_path / "z.obj", np.array(AXIS_VECTORS["z"])))


def test_one_piece_of_furniture_gets_no_hint_of_y(tmp_path):
    shelf = trimesh.util.concatenate(
        [trimesh.creation.box((0.8, 0.02, 2.0)).apply_translation((0, y, 0)) for y in (0, 0.3)]
    )
    shelf.export(tmp_path / "shelf.stl")
    assert not hints_of_y(str(tmp_path / "shelf.stl"))


@pytest.mark.parametrize("up", ["y", "z", (0.31, -0.52, 0.79)])
def test_level_turns_a_drawn_house_by_no_hundredth_of_a_degree(tmp_path, up):
    """The floor's top and underside lie in one plane of a scan; a fit to both would be tilted."""
    vector = np.array(AXIS_VECTORS[up] if isinstance(up, str) else up)
    path = drawn_house(tmp_path / "house.ply", vector / np.linalg.norm(vector))
    (level,) = bake(path, up="level").grid.levels
    assert np.abs(level.floor_height[level.free]).max() < 1e-5
    assert level.floor_height.shape == (42, 62) or not isinstance(up, str)


# ---------------------------------------------------------------- holes


def test_holes_of_a_scan_are_closed_and_marked(tmp_path):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["z"]))
    (level,) = bake(path, up="z", scan=True).grid.levels
    unseen = level.attributes["unseen"].astype(bool)
    assert level.attributes["unseen"].dtype == np.uint8
    assert unseen.sum() == pytest.approx(100, abs=8)
    assert level.free[unseen].all()
    assert np.abs(level.floor_height[unseen]).max() < 0.03
    (without,) = bake(path, up="z").grid.levels
    assert "unseen" not in without.attributes and np.isnan(without.floor_height[unseen]).all()
    small = run_bake(parse_config({"scene": {"path": path, "up": "z"}, "floors": {"fill": 0.5}}))
    assert not small.grid.levels[0].attributes["unseen"].any()


def test_nobody_stands_inside_of_a_hollow_pillar(tmp_path):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["z"]), pillar=True)
    (level,) = bake(path, up="z", scan=True).grid.levels
    assert not level.attributes["unseen"].any()


def test_a_verification_takes_no_closed_hole_for_a_floor_that_is_off(tmp_path):
    path = scan(tmp_path / "scan.ply", np.array(AXIS_VECTORS["z"]))
    settings = {"scene": {"path": path, "up": "z", "scan": True}, "verify": {"sample": 5000}}
    result = run_bake(parse_config(settings))
    assert result.grid.navbake["verified"]["disagreements"] == 0


@pytest.mark.parametrize(("fill", "told"), [(0.0, "no floor: `floors.fill`"), (2.0, "layer")])
def test_holes_of_a_floor_are_told(tmp_path, fill, told):
    path = scan(tmp_path / "scan.ply", (0, 0, 1))
    warnings = run_bake(parse_config({"scene": {"path": path}, "floors": {"fill": fill}})).warnings
    (text,) = (text for text in warnings if "open in its floor" in text)
    area = re.search(r"a hole of (\S+) m² in all", text)
    assert told in text and float(area[1]) == pytest.approx(1.0, abs=0.15)


def test_specks_of_a_scan_are_left_out(tmp_path):
    path = scan(tmp_path / "scan.ply", (0, 0, 1))
    specks = [sheet((x, 1, 1), (0.2, 0, 0), (0, 0.2, 0)) for x in (1.0, 2.5)]
    table = sheet((1, 0.5, 0.7), (0.5, 0, 0), (0, 0.5, 0))
    trimesh.util.concatenate([trimesh.load(path), *specks, table]).export(path)

    def load(is_scan):
        return load_alone(SceneSettings(path=path, up="z", scan=is_scan))

    (whole,), (kept,) = (load(is_scan).exact_meshes.values() for is_scan in (False, True))
    assert len(whole.faces) - len(kept.faces) == 2 * len(specks[0].faces)
    (told,) = (text for text in load(True).warnings if "pieces of the scan" in text)
    assert told.startswith("2 pieces") and "0.08 m² in all" in told


def box_between(low, high) -> trimesh.Trimesh:
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)
    return trimesh.creation.box(high - low).apply_translation((low + high) / 2)


def furnished_room() -> trimesh.Trimesh:
    """A room of 10 x 8 m with thick walls, z up; half of its surface are walls."""
    return trimesh.util.concatenate(
        [
            box_between((0, 0, -0.4), (10, 8, 0)),
            box_between((0, 0, 0), (10, 0.2, 2.6)),
            box_between((0, 7.8, 0), (10, 8, 2.6)),
            box_between((0, 0, 0), (0.2, 8, 2.6)),
            box_between((9.8, 0, 0), (10, 8, 2.6)),
            box_between((2, 2, 0), (3.5, 3, 0.75)),
            box_between((7, 5, 0), (9, 7, 0.5)),
            box_between((5, 0, 0), (5.2, 3, 2.6)),
        ]
    )


@pytest.mark.parametrize("angle", [-105.0, -90.0, -78.0, 72.0, 90.0, 100.0, 112.0])
def test_a_mesh_on_its_side_stands_up_whatever_it_is_tilted_by(tmp_path, angle):
    """A direction that is no axis is taken as it is, and told by its numbers."""
    room = furnished_room()
    room.apply_transform(trimesh.transformations.rotation_matrix(np.radians(angle), (1, 0, 0)))
    path = str(tmp_path / "room.obj")
    room.export(path)
    result = run_bake(parse_config({"scene": {"path": path}}))
    (text,) = (text for text in result.warnings if "lies on its side" in text)
    assert "is taken with" in text
    assert result.grid.levels[0].free.sum() == pytest.approx(6690, abs=500)


def test_a_tower_with_balconies_stays_upright(tmp_path):
    """What projects from a facade doesn't stand on it."""
    parts = [box_between((0, 0, z - 0.2), (10, 6, z)) for z in (0, 3, 6, 9, 12)]
    parts += [box_between((0, y, 0), (10, y + 0.2, 12)) for y in (0.0, 5.8)]
    parts += [box_between((x, 0, 0), (x + 0.2, 6, 12)) for x in (0.0, 9.8)]
    parts += [
        box_between((x, -1.2, z), (x + 1.5, 0, z + 0.15)) for x in (1, 4, 7) for z in (3, 6, 9)
    ]
    path = str(tmp_path / "tower.obj")
    trimesh.util.concatenate(parts).export(path)
    result = run_bake(parse_config({"scene": {"path": path}}))
    assert len(result.grid.levels) == 4
    assert not [text for text in result.warnings if "lies on its side" in text]
