"""The command `navbake warm-up`: compiles the kernels, so that no first bake or query waits.

It bakes a small scene and uses the grid: the command line is above the baker and the run time.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import navbake
from navbake.cli.printing import VOLUME, say_unless_quiet

# Two storeys joined by stairs, with geoms of all kinds and a door
SCENE = """<mujoco model="warm-up">
<asset>
  <mesh name="wedge" vertex="0 0 0 .4 0 0 0 .4 0 0 0 .6" face="0 2 1 0 1 3 1 2 3 0 3 2"/>
  <hfield name="hill" nrow="3" ncol="3" size=".5 .5 .2 .1" elevation="0 0 0 0 1 0 0 0 0"/>
</asset>
<worldbody>
  <geom type="plane" size="0 0 1" pos="0 0 -.2"/>
  <geom type="box" size="4 3 .1" pos="0 0 -.1"/>
  <geom type="box" size="1.5 3 .1" pos="-2.5 0 1.9"/>
  <replicate count="9" offset="-.3 0 .2">
    <geom type="box" size=".15 .6 .1" pos=".9 0 .1"/>
  </replicate>
  <geom type="box" size=".05 1.2 1.2" pos="2.4 1.8 1.2"/>
  <geom type="box" size=".05 1.2 1.2" pos="2.4 -1.8 1.2"/>
  <geom type="sphere" size=".3" pos="1.5 2 .3"/>
  <geom type="capsule" size=".2 .3" pos="1.5 -2 .4" euler="80 10 0"/>
  <geom type="cylinder" size=".2 .3" pos=".5 2 .4" euler="10 10 0"/>
  <geom type="ellipsoid" size=".2 .3 .4" pos=".5 -2 .4"/>
  <geom type="mesh" mesh="wedge" pos="3 2 0"/>
  <geom type="mesh" mesh="wedge" pos="3 -2 0" contype="0" conaffinity="0"/>
  <geom type="hfield" hfield="hill" pos="3.3 0 0"/>
  <body name="door" pos="2.4 -.6 1">
    <joint type="hinge" axis="0 0 1" range="0 90"/>
    <geom type="box" size=".02 .55 1" pos="0 .6 0"/>
  </body>
</worldbody></mujoco>"""


def warm_up() -> None:
    """Compile all kernels for this machine, once.

    It takes a minute or two. Without it, the first bake and the first query compile what they
    use.
    """
    from navbake.cli.progress import stage_progress  # loads rich

    with stage_progress(title="compiling", hidden=VOLUME.quiet) as progress:
        compile_all(progress)
    say_unless_quiet("compiled: bakes and queries start at once from now on")


def tell_if_cold() -> None:
    """Print on a terminal that the first bake waits for the compiler."""
    if sys.stderr.isatty() and not is_warm():
        print("navbake: compiling for this machine, once: about a minute", file=sys.stderr)


def is_warm() -> bool:
    """Whether a bake has been compiled for this machine before."""
    from navbake.baker.kernels.rays import cast_lines  # loads numba

    folder = cast_lines.stats.cache_path
    return folder is not None and any(Path(folder).glob("*cast_lines-*.nbc"))


def compile_all(progress: Callable[[str, float], None]) -> None:
    """Compile what a bake, the run time and voxel grids need, and keep it on disk.

    numba keeps it beside the package, or in ``NUMBA_CACHE_DIR``. It is compiled again for another
    version of navbake or numba, and for another processor. `progress` is called with the name of
    each part, and 0 and 1 as it begins and ends.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "warm-up.xml"
        path.write_text(SCENE, encoding="utf-8")
        settings = {"scene": {"path": path, "geoms": "all"}, "attributes": ["island", "clearance"]}
        progress("bake", 0.0)
        grid = navbake.bake(settings)
        grid.save(Path(folder) / "warm-up.json")
        progress("bake", 1.0)
        progress("run time", 0.0)
        _use_run_time(grid)
        progress("run time", 1.0)
        progress("voxels", 0.0)
        voxelizer = navbake.Voxelizer(path)
        voxelizer.create((0.0, 0.0, 1.0), (20, 20, 20), res=0.1)
        voxelizer.create((0.0, 0.0, 1.0), (20, 20, 20), res=0.1, segments="top")
        progress("voxels", 1.0)


def _use_run_time(grid: navbake.SceneGrid2D | navbake.MultiLevelGrid) -> None:
    """Call whatever of the run time has kernels."""
    import numpy as np  # --help does without it

    rng = np.random.default_rng(0)
    grid.with_doors("open")
    grid.inflate(0.1, clearance=0.1)
    grid.inflate(0.1, costs="nav2")
    grid.inflate(0.1, clearance=0.1, mode="minos")
    grid.inflate_footprint([(0.2, 0.1), (-0.2, 0.1), (0.0, -0.2)], 4)
    finder = navbake.PathFinder(grid)
    start, goal = finder.random_point(rng, level=0), finder.random_point(rng, level=1)
    finder.find_path(start, goal)
    finder.why_not(start, (100.0, 0.0, 0.0))
    finder.distance_field(goal)
    finder.random_point_near(rng, start, 2.0)
    finder.are_navigable(np.stack([start, goal]))
    finder.snap(start + 0.2, in_sight=True)
    finder.try_step(start, start + np.array([0.3, 0.2, 0.0]))
    finder.line_of_sight(start, goal)
    finder.nearest_obstacle(start)
    both = np.stack([start, goal])
    finder.many.snap(both)
    finder.many.clearance(both)
    finder.many.try_step(both, both + np.array([0.3, 0.2, 0.0]))
    with grid.block(disc=(start, 0.3)):
        finder.find_path(start, goal)
