"""The command `fly`, which plans through voxels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from typer import BadParameter, Exit

import navbake
from navbake.cli import options
from navbake.cli.options import OUTPUT_FLAGS, AsJson, Overrides, argument, option
from navbake.cli.printing import print_json, print_warnings, say, say_unless_quiet
from navbake.formats.format_table import VOXEL_SUFFIXES

if TYPE_CHECKING:
    from navbake.types import Json
    from navbake.voxels.finder import FlightPath
    from navbake.voxels.grid import VoxelGrid

Triple = tuple[float, float, float]  # navbake.types would load numpy

FLIGHT_SUFFIXES = (".json", ".png", ".mcap", ".npz")
"""Endings of the files that `fly` writes."""

# Functions import what reads scenes only when they run, so that --help loads no MuJoCo or numpy.


def fly(
    scene: Path = argument("SCENE|VOXELS", "Scene, settings (YAML), sample's name, or voxels."),
    start: str = option("X,Y,Z", "Start of the ball's middle [m].", "--from", default=...),
    goal: str = option("X,Y,Z", "Goal of the ball's middle [m].", "--to", default=...),
    radius: float = option("METRES", "Radius of the ball [m].", default=...),
    res: float | None = option("METRES", "Edge of a voxel [m].  [default: 0.1]"),
    margin: float | None = option(
        "METRES", "Voxels round the scene's box, to fly outside of it [m].  [default: 1]", min=0.0
    ),
    min_height: float | None = option("METRES", "Least z of the ball's middle [m]."),
    max_height: float | None = option("METRES", "Greatest z of the ball's middle [m]."),
    clearance: float = option(
        "METRES", "What a metre costs more at 1 m from things [m].", default=0.0, min=0.0
    ),
    unknown: Literal["occupied", "free"] = option(
        "occupied|free", "What unknown voxels count as.", default="occupied"
    ),
    outputs: list[Path] | None = option(
        "FILE",
        "Path: .json, .png or .mcap; signed distances: .npz. May be repeated.",
        *OUTPUT_FLAGS,
    ),
    as_json: AsJson = False,
    overrides: Overrides = None,
) -> None:
    """Plan a flight through a scene's voxels, or say why there is none.

    The exit status is 1 if there is none.

    Example: navbake fly house --from 0,-4.4,1.5 --to -3,3,4.2 --radius 0.25 -o flight.png
    """
    begin = _parse_position(start, "--from")
    end = _parse_position(goal, "--to")
    is_voxel_file = scene.suffix.lower() in VOXEL_SUFFIXES
    options.refuse_unused(
        ("--res", res is not None, not is_voxel_file, "scenes"),
        ("--margin", margin is not None, not is_voxel_file, "scenes"),
        ("--set", bool(overrides), not is_voxel_file, "scenes"),
    )
    for output in outputs or ():
        if output == options.STDOUT:
            message = "expected a name: its ending says which format"
            raise BadParameter(message, param_hint="-o")
        options.check_output(output, *FLIGHT_SUFFIXES, inputs=[scene])
    if is_voxel_file:
        voxels = navbake.load_voxels(scene)
    else:
        voxels = _voxelize_box(
            scene, 0.1 if res is None else res, 1.0 if margin is None else margin, overrides or []
        )
    finder = navbake.VoxelFinder(voxels, radius, min_height, max_height, clearance, unknown=unknown)
    flight = finder.find_path(begin, end)
    reason = finder.why_not(begin, end) if flight is None else None
    if as_json:
        print_json({"path": None if flight is None else _list_facts(flight), "reason": reason})
    elif flight is None:
        say(f"no path: {reason}")
    else:
        print(f"length  {flight.length:.3f} m")
        print(f"cost    {flight.cost:.3f}")
        print("      x       y       z")
        for x, y, z in flight.positions.round(3) + 0.0:  # no -0.000
            print(f"{x:7.3f} {y:7.3f} {z:7.3f}")
    for output in outputs or ():
        _write_output(output, voxels, flight)
    if flight is None:
        raise Exit(1)


def _parse_position(text: str, option_name: str) -> Triple:
    """Return x, y and z of a place that a user typed; raise a BadParameter for another form."""
    place = options.parse_place(text, option_name)
    if place.z is None:
        message = f"expected X,Y,Z as in 1.5,-2,1.2, got {text!r}"
        raise BadParameter(message, param_hint=option_name)
    return place.x, place.y, place.z


def _voxelize_box(scene: Path, res: float, margin: float, overrides: list[str]) -> VoxelGrid:
    """Make the voxels of a scene's box, and of a margin round it.

    Args:
        scene: a scene, settings, or a sample's name.
        res: edge of a voxel [m].
        margin: what the voxels cover beside the box, on each side [m].
        overrides: settings in place of the scene's, as ``KEY=VALUE``.
    """
    from navbake.config.settings import load_config  # loads numpy

    settings = load_config(scene, overrides)
    options.say_if_sample(scene)
    voxelizer = navbake.Voxelizer(settings)
    print_warnings(voxelizer.scene.warnings)
    bounds = voxelizer.shapes.bounds
    if bounds is None or not margin:
        return voxelizer.create(res=res)
    lower, upper = bounds
    size = (upper - lower + 2.0 * margin).tolist()
    return voxelizer.create((lower + upper) / 2.0, res=res, size=size, align=True)


def _list_facts(flight: FlightPath) -> Json:
    """List what --json prints of a path."""
    return {
        "positions": flight.positions,
        "length": flight.length,
        "cost": flight.cost,
        "radius": flight.radius,
    }


def _write_output(output: Path, voxels: VoxelGrid, flight: FlightPath | None) -> None:
    """Write one of the files; of those of a path, nothing if there is none."""
    suffix = output.suffix.lower()
    if suffix == ".npz":
        voxels.distances(signed=True).save(output)
    elif flight is None:
        return
    elif suffix == ".png":
        from navbake.views.flight import draw_flight  # loads numpy

        options.write_output(draw_flight(voxels, flight), output)
    else:
        flight.save(output, voxels=voxels if suffix == ".mcap" else None)
    say_unless_quiet(output)
