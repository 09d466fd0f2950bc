"""Draws the pictures of the README and of docs/ from the sample scenes.

python scripts/make_pictures.py [NAME…]
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")  # before mujoco is imported: no display is needed
import mujoco
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon
from PIL import Image

import navbake
from baselines import WALKERS
from make_house import make_house
from navbake.baker.bake.stages import bake_stages
from navbake.episodes import make_episodes, make_rules
from navbake.navgrid import colors
from navbake.navgrid.colors import rgb_of
from navbake.navgrid.grid import NavGrid
from navbake.views import plot
from navbake.views.flight import draw_flight
from navbake.views.layers import make_panel, paint
from navbake.views.plot import Overlays, render_picture
from sweep_scans import make_scan

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
SIZE = (1250, 1600)  # pixels; what is larger is scaled down
COLORS = 256  # of the palette that a picture is reduced to
LINE_COLORS = (colors.MARKS[0], colors.MARKS[1], colors.ROUTE)  # of the baselines
START, GOAL = (0.0, -4.8, 0.0), (-2.2, -3.2, 3.0)  # [m], from the garden to a room upstairs


# of a sample as it is baked: the sample, layers, and the level if not all
PLAIN: dict[str, tuple[str, tuple[str, ...], int | None]] = {
    "house": ("house", ("rooms", "floor"), None),  # the picture of the README
    "apartment": ("apartment", ("rooms", "floor"), None),
    "floors": ("warehouse", ("occupancy", "floor"), None),  # ramp, dock and stairs are floors
    "terrain": ("terrain", ("floor",), None),  # hills, a brook and a bridge, a level of its own
    "islands": ("terrain", ("island", "clearance"), 0),
    "clutter": ("clutter", ("occupancy", "floor"), 0),
    "tower": ("tower", ("area", "links"), None),  # lifts and stairs as arcs
    "doors": ("house", ("doors",), None),  # what they block, where they close, how wide they are
}


def bake(name: str) -> NavGrid:
    """Bake a sample scene."""
    return navbake.bake(ROOT / "configs" / f"{name}.yaml")


# --- pictures that navbake has no layer for, in the style of those that it draws ------------------


def make_maps(
    titles: Sequence[str], bounds: tuple[float, float, float, float], width: float
) -> tuple[Figure, list[Axes]]:
    """Make a figure with maps side by side.

    Args:
        titles: the title of each map.
        bounds: what the maps show, world x_min, y_min, x_max, y_max [m].
        width: width of the figure [inches].
    """
    x_min, y_min, x_max, y_max = bounds
    map_width = width / len(titles) - 0.4
    height = map_width * (y_max - y_min) / (x_max - x_min) + 1.0
    figure = Figure(figsize=(width, height), dpi=plot.DPI, layout="constrained")
    axes = list(figure.subplots(1, len(titles), squeeze=False)[0])
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, loc="left", fontsize=plot.TITLE_POINTS, color=plot.TEXT_COLOR, pad=5)
        ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal")
        plot.style_axes(ax)
    return figure, axes


def show_cells(ax: Axes, rgb: np.ndarray, bounds: tuple[float, float, float, float]) -> None:
    """Show the colours of cells, row 0 at the largest y."""
    x_min, y_min, x_max, y_max = bounds
    ax.imshow(rgb, extent=(x_min, x_max, y_min, y_max), interpolation="nearest")


def add_legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """Add a legend below the maps."""
    figure.legend(
        handles=handles,
        ncols=len(handles),
        loc="outside lower left",
        frameon=False,
        fontsize=plot.LEGEND_POINTS,
        labelcolor=plot.TEXT_COLOR,
    )


def as_png(figure: Figure) -> bytes:
    """Return the PNG of a figure."""
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


# --- the pictures -------------------------------------------------------------------------------


def draw_plain(name: str) -> bytes:
    sample, layers, level = PLAIN[name]
    return render_picture(bake(sample), level=level, layers=layers)


def draw_inflated() -> bytes:
    """Costs near walls for an agent of 0.2 m."""
    grid = bake("apartment").inflate(0.2, costs="nav2", scaling=3.0)
    return render_picture(grid, layers=("occupancy", "weights"))


def draw_path() -> bytes:
    """A path over the stairs."""
    grid = bake("house")
    path = navbake.PathFinder(grid).find_path(START, GOAL)
    return render_picture(grid, layers=("occupancy",), overlays=Overlays(route=path))


def draw_rooms() -> bytes:
    """A hundred rooms: those that share a wall have different colours."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "house-100.xml"
        scene.write_text(make_house(100), encoding="utf-8")
        grid = navbake.bake(scene, grid={"cell_size": 0.1})
    return render_picture(grid, layers=("rooms",))


def draw_scan(is_scan: bool) -> bytes:
    """A tilted scan with holes, levelled; and what `scene.scan` makes of it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.ply"
        make_scan(4).mesh.export(path)
        grid = navbake.bake(path, scene={"up": "level", "scan": is_scan})
    return render_picture(grid, layers=("occupancy", "floor"))


def draw_baselines() -> bytes:
    """An episode, and how three baselines go."""
    grid = bake("apartment").inflate(0.18)
    finder, (level,) = navbake.PathFinder(grid), grid.levels
    content = make_episodes(grid, "point", make_rules("habitat", min_distance=7.0), count=20)
    episode = max(content.episodes, key=lambda e: e.ratio or 1.0)
    figure, (ax,) = make_maps(["an episode, and how three baselines go"], level.lattice.bounds, 5.0)
    show_cells(ax, paint(make_panel(grid, "occupancy", 0)), level.lattice.bounds)
    lines = reversed(WALKERS.items())
    for (name, walk), color in zip(lines, LINE_COLORS, strict=True):
        line = walk(finder, episode, np.random.default_rng(0))
        ax.plot(*line[:, :2].T, color=color, label=name, linewidth=1.0 if name == "random" else 2.2)
    marks = {"start": (episode.start, "o", 7), "goal": (episode.goals[0].position, "*", 13)}
    for name, (position, marker, size) in marks.items():
        style = {"markeredgecolor": "white", "markersize": size, "linestyle": "none"}
        ax.plot(*position[:2], marker, color=plot.TEXT_COLOR, label=name, **style)
    add_legend(figure, ax.get_legend_handles_labels()[0])
    return as_png(figure)


def draw_voxels() -> bytes:
    """Two layers of voxels, each thing in a colour of its own."""
    voxelizer = navbake.Voxelizer(ROOT / "configs" / "apartment.yaml")
    grid = voxelizer.create(res=0.05, segments="top")
    (x0, y0, _), (x1, y1, _) = grid.bounds
    heights = (0.4, 1.2)
    figure, axes = make_maps([f"voxels at z = {z:g} m" for z in heights], (x0, y0, x1, y1), 8.3)
    rng = np.random.default_rng(4)
    palette = np.array([rgb_of(color) for color in (*colors.ROOMS, *colors.MARKS, colors.ROUTE)])
    color_of_name = palette[rng.integers(0, len(palette), max(grid.names) + 1)]
    color_of_name[0] = rgb_of(colors.FREE)
    for ax, z in zip(axes, heights, strict=True):
        layer = grid.values[:, :, int(grid.indices((x0, y0, z))[2])].T
        show_cells(ax, color_of_name[layer[::-1]].astype(np.uint8), (x0, y0, x1, y1))
    return as_png(figure)


def draw_fly() -> bytes:
    """A flight through a window of the house, as in `examples/fly_through_a_house.py`."""
    voxelizer = navbake.Voxelizer(ROOT / "configs" / "house.yaml")
    lower, upper = voxelizer.shapes.bounds
    voxels = voxelizer.create((lower + upper) / 2, res=0.1, size=upper - lower + 2.0, align=True)
    flight = navbake.VoxelFinder(voxels, 0.25).find_path((0.0, -4.4, 1.5), (-3.0, 3.0, 4.2))
    return draw_flight(voxels, flight, "house")


ROLES_SCENE = """
<mujoco><worldbody>
  <geom type="box" pos="3 2 -0.05" size="3.1 2.1 0.05"/>
  <geom type="box" pos="3 -0.05 1.25" size="3.1 0.05 1.25"/>
  <geom type="box" pos="3 4.05 1.25" size="3.1 0.05 1.25"/>
  <geom type="box" pos="-0.05 2 1.25" size="0.05 2 1.25"/>
  <geom type="box" pos="6.05 0.5 1.25" size="0.05 0.5 1.25"/>
  <geom type="box" pos="6.05 2.95 1.25" size="0.05 1.05 1.25"/>
  <geom type="box" pos="3.6 0.8 1.25" size="0.05 0.8 1.25"/>
  <geom type="box" pos="3.6 3.25 1.25" size="0.05 0.75 1.25"/>
  <body name="door" pos="3.6 1.6 0"><joint axis="0 0 1" range="0 90"/>
    <geom type="box" pos="0 0.45 1" size="0.02 0.44 1"/></body>
  <body name="front door" pos="6.05 1 0"><joint axis="0 0 1" range="0 90"/>
    <geom type="box" pos="0 0.45 1" size="0.02 0.44 1"/></body>
  <body name="table" pos="1.8 2.9 0"><geom type="box" pos="0 0 0.7" size="0.8 0.4 0.03"/></body>
  <body name="chair 1" pos="1.3 2.2 0"><freejoint/>
    <geom type="box" pos="0 0 0.4" size="0.22 0.22 0.4"/></body>
  <body name="chair 2" pos="2.4 2.3 0"><freejoint/>
    <geom type="box" pos="0 0 0.4" size="0.22 0.22 0.4" euler="0 0 30"/></body>
  <body name="ball" pos="0.6 0.8 0.2"><freejoint/><geom type="sphere" size="0.2"/></body>
  <body name="robot" mocap="true" pos="4.8 2.6 0.4"><geom type="cylinder" size="0.25 0.4"/></body>
</worldbody></mujoco>
"""


def draw_roles() -> bytes:
    """What of a scene stands, what can move, what is a leaf; and what becomes of each."""
    scene = mujoco.MjModel.from_xml_string(ROLES_SCENE)
    stages = bake_stages(scene, grid={"cell_size": 0.05})
    grid = navbake.bake(scene, grid={"cell_size": 0.05})
    (level,) = grid.levels
    titles = ["roles", "rooms: by structure and closed leaves", "occupied: by all, doors closed"]
    figure, (of_roles, of_rooms, of_cells) = make_maps(titles, level.lattice.bounds, 8.3)
    color_of_role = {"structure": colors.OCCUPIED, "movable": colors.MARKS[0], "leaf": colors.DOOR}
    for geom in stages.scene.geoms[1:]:  # the first is the floor
        place = stages.scene.data.geom_xpos[geom.id][:2]
        turn = stages.scene.data.geom_xmat[geom.id].reshape(3, 3)[:2, :2]
        half = scene.geom_size[geom.id]
        if geom.type == "box":
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half[:2]
            patch = Polygon(corners @ turn.T + place, color=color_of_role[geom.role])
        else:
            patch = Circle(place, half[0], color=color_of_role[geom.role])
        of_roles.add_patch(patch)
    show_cells(of_rooms, paint(make_panel(grid, "rooms", 0)), level.lattice.bounds)
    show_cells(of_cells, paint(make_panel(grid, "occupancy", 0)), level.lattice.bounds)
    legend = {**color_of_role, "free": colors.FREE, "occupied in a room": colors.ROOM_LEGEND}
    handles = [
        Patch(facecolor=color, edgecolor="#777777", linewidth=0.5, label=meaning)
        for meaning, color in legend.items()
    ]
    add_legend(figure, handles)
    return as_png(figure)


def draw_in_mujoco() -> bytes:
    """The apartment in MuJoCo's own renderer: rooms, poses before the sofa, and a path."""
    scene = ROOT / "configs" / "scenes" / "apartment.xml"
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    grid = bake("apartment")
    finder = navbake.PathFinder(grid.inflate(0.2))
    model.vis.global_.offwidth, model.vis.global_.offheight = 1000, 640
    renderer = mujoco.Renderer(model, 640, 1000)
    camera = mujoco.MjvCamera()
    camera.lookat = (0.0, -0.8, 0.0)
    camera.distance, camera.azimuth, camera.elevation = 9.5, 93.0, -68.0
    renderer.update_scene(data, camera)
    navbake.draw(renderer.scene, grid, layer="rooms")
    navbake.draw(renderer.scene, finder.find_path((-4.0, -1.8, 0.0), (3.0, -0.7, 0.0)))
    navbake.draw(renderer.scene, finder.stand_poses("object:sofa", count=4))
    content = io.BytesIO()
    Image.fromarray(renderer.render()).save(content, format="png")
    return content.getvalue()


def draw_film() -> bytes:
    """Four frames of the film that `examples/draw_in_mujoco.py` makes."""
    with tempfile.TemporaryDirectory() as folder:
        example = ROOT / "examples" / "draw_in_mujoco.py"
        subprocess.run([sys.executable, str(example)], cwd=folder, check=True)
        with Image.open(Path(folder) / "film.gif") as film:
            width, height = film.size
            sheet = Image.new("RGB", (2 * width, 2 * height))
            for number in range(4):
                film.seek(number * film.n_frames // 5)
                place = (number % 2 * width, number // 2 * height)
                sheet.paste(film.convert("RGB"), place)
    content = io.BytesIO()
    sheet.save(content, format="png")
    return content.getvalue()


def draw_page(name: str) -> bytes:
    """The page of `navbake view`, or one that `navbake report` writes."""
    # imports the tests' browser, which the other pictures do without
    from docs_pages import pictures

    missing = pictures.why_no_browser()
    if missing:
        raise SystemExit(f"cannot take the picture of a page: {missing}")
    taken: bytes = getattr(pictures, name)()
    return taken


def draw_stand() -> bytes:
    """Take the picture that `examples/reach_a_mug.py` draws."""
    example = ROOT / "examples" / "reach_a_mug.py"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, example], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        return (Path(folder) / "mug.png").read_bytes()


PICTURE_MAKERS: dict[str, Callable[[], bytes]] = {
    **{name: partial(draw_plain, name) for name in PLAIN},
    "inflated": draw_inflated,
    "path": draw_path,
    "rooms": draw_rooms,
    "stand": draw_stand,
    "roles": draw_roles,
    "scan": partial(draw_scan, True),
    "scan_holes": partial(draw_scan, False),
    "voxels": draw_voxels,
    "fly": draw_fly,
    "baselines": draw_baselines,
    "draw": draw_in_mujoco,
    "film": draw_film,
    "viewer": partial(draw_page, "take_viewer"),
    "report": partial(draw_page, "take_report"),
}


def shrink(png: bytes) -> Image.Image:
    """Scale a picture to `SIZE` and reduce it to a palette, so that a clone stays small."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    image.thumbnail(SIZE, Image.Resampling.LANCZOS)
    return image.quantize(COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)


def main() -> None:
    """Draw the pictures asked for."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("names", nargs="*", help=f"some of {', '.join(PICTURE_MAKERS)}; all")
    names = parser.parse_args().names or list(PICTURE_MAKERS)
    unknown = [name for name in names if name not in PICTURE_MAKERS]
    if unknown:
        parser.error(f"no picture {', '.join(unknown)}: there are {', '.join(PICTURE_MAKERS)}")
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names:
        path = PICTURES / f"{name}.png"
        shrink(PICTURE_MAKERS[name]()).save(path, optimize=True)
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
