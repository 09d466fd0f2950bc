"""The commands `navbake convert` and `navbake extrude`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

from typer import Argument, BadParameter, Option

from navbake.cli.options import STDOUT, check_output, write_stdout
from navbake.cli.printing import say_unless_quiet
from navbake.errors import FormatError
from navbake.formats.convert import FORMATS, Format, encode_as, find_format, list_files, read_as
from navbake.formats.source import write_files

# Options of formats. A field is called as the option of the format's functions is, and None stands
# for one that isn't given.


class MapOptions(NamedTuple):
    """Options of maps."""

    level: int | None = Option(None, metavar="N", min=0, help="Only this level; 0 is the lowest.")
    radius: float | None = Option(
        None, metavar="METRES", help="Inflate for an agent of this radius first [m]."
    )
    mode: str | None = Option(
        None,
        metavar="trinary|scale|raw",
        help="trinary (free, occupied, unknown), scale or raw (with costs).  [default: trinary]",
    )
    image: str | None = Option(
        None,
        metavar="pgm|png",
        help="pgm or png.  [default: pgm; png with --mode scale, which needs transparency]",
    )
    inflation: float | None = Option(
        None,
        metavar="METRES",
        help="Costs by nav2's formula, up to this distance from obstacles [m].",
    )
    zone: list[str] | None = Option(
        None,
        metavar="NAME[=PERCENT]",
        help="Room (name, id or number) or polygon of a mask. May be repeated.",
    )
    zones: Path | None = Option(
        None, metavar="GEOJSON", help="Polygons of a mask; all of them unless --zone names some."
    )
    height: float | None = Option(
        None,
        metavar="METRES",
        help="How far walls rise over the highest floor [m].  [default: 2.5]",
    )
    flat: bool | None = Option(None, "--flat", help="Lay the floors of a level at its ground.")
    scaling: float | None = Option(
        None,
        metavar="FACTOR",
        help="How fast these costs fall, nav2's cost_scaling_factor [1/m].  [default: 10]",
    )


class ShapeOptions(NamedTuple):
    """Options of meshes and graphs."""

    tolerance: float | None = Option(
        None,
        metavar="METRES",
        min=0,
        help="How far a mesh may be off the floor [m].  [default: 0.001]",
    )
    up: str | None = Option(None, metavar="y|z", help="Upward axis of an OBJ.  [default: y]")
    cut_corners: bool | None = Option(
        None, "--cut-corners", help="Let diagonal steps of a graph pass blocked corners."
    )


def _list_formats() -> str:
    """The table of formats as a help text shows it."""
    lines = []
    for form in FORMATS:
        ways = [way for way, is_there in (("in", form.read), ("out", form.encode)) if is_there]
        lines.append(f"{form.name} ({', '.join(form.endings)}; {', '.join(ways)}): {form.meaning}.")
    return "\n\n".join(lines)


def convert(
    source: Annotated[Path, Argument(metavar="IN", help="The file to read.")],
    output: Annotated[Path, Argument(metavar="OUT", help="File to write, - for stdout; not IN.")],
    maps: MapOptions,
    shapes: ShapeOptions,
    to: str | None = Option(
        None, "--to", metavar="FORMAT", help="Format of OUT.  [default: by its ending]"
    ),
    origin: str | None = Option(
        None, "--from", metavar="FORMAT", help="Format of IN.  [default: by its ending]"
    ),
) -> None:
    if output == STDOUT and to is None:
        raise BadParameter("expected a format: stdout has no ending", param_hint="--to")
    reader, writer = _find(source, origin, False, "--from"), _find(output, to, True, "--to")
    _convert(source, output, reader, writer, maps._asdict() | shapes._asdict())


def extrude(
    source: Annotated[
        Path, Argument(metavar="IN", help="A grid or a map: any file that `convert` reads.")
    ],
    output: Annotated[
        Path,
        Option("-o", "--output", metavar="XML", help="Scene to write; its settings go beside it."),
    ],
    level: int | None = Option(None, metavar="N", min=0, help="Only this level; 0 is the lowest."),
    height: float | None = Option(
        None,
        metavar="METRES",
        help="How far walls rise over the highest floor [m].  [default: 2.5]",
    ),
    flat: bool = Option(False, "--flat", help="Lay the floors of a level at its ground."),
    origin: str | None = Option(
        None, "--from", metavar="FORMAT", help="Format of IN.  [default: by its ending]"
    ),
) -> None:
    """Make a MuJoCo scene of walls and floors from a map.

    Baked with the settings that are written beside it, a level gives its map again, cell for cell;
    docs/convert.md says what does not come back of several levels in one scene.

    Example: navbake extrude map.yaml -o scene.xml
    """
    check_output(output, ".xml", inputs=[source])
    if output == STDOUT:
        raise BadParameter("expected a name: there are two files", param_hint="-o")
    reader, writer = _find(source, origin, False, "--from"), find_format("", "mjcf", writing=True)
    _convert(source, output, reader, writer, {"level": level, "height": height, "flat": flat})


def _convert(
    source: Path, output: Path, reader: Format, writer: Format, options: dict[str, Any]
) -> None:
    read_options, write_options = _share_out(options, reader, writer)
    inputs = [source, *(value for value in options.values() if isinstance(value, Path))]
    check_output(output, inputs=inputs)
    inputs += list_files(source, reader)
    grid = read_as(source, reader.name, **read_options)
    target = Path(f"stdout{writer.endings[0]}") if output == STDOUT else output
    files = encode_as(grid, target, writer.name, **write_options)
    if output == STDOUT:
        if len(files) > 1:
            raise BadParameter(f"{writer.name} is {len(files)} files", param_hint="OUT")
        (content,) = files.values()
        write_stdout(content if isinstance(content, bytes) else b"".join(content))
        return
    for path in files:
        check_output(path, inputs=inputs)
    for path in write_files(files):
        say_unless_quiet(path)


convert.__doc__ = f"""Convert a grid from one format to another.

Example: navbake convert house.grid.json map.yaml

Formats:

{_list_formats()}
"""


def _find(path: Path, name: str | None, writing: bool, option: str) -> Format:
    try:
        return find_format(path, name, writing=writing)
    except FormatError as error:
        hint = option if name is not None else ("OUT" if writing else "IN")
        raise BadParameter(str(error), param_hint=hint) from error


def _share_out(
    options: dict[str, Any], reader: Format, writer: Format
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The options that are given, for the reader and for the writer; one of neither is refused."""
    given = {
        name: value
        for name, value in options.items()
        if value is not None and value is not False and value != []
    }
    for name in given:
        if name not in (*reader.read_options, *writer.write_options):
            takers = [f"{form.name} as OUT" for form in FORMATS if name in form.write_options]
            takers += [f"{form.name} as IN" for form in FORMATS if name in form.read_options]
            flag = f"--{name.replace('_', '-')}"
            raise BadParameter(f"does nothing here: it is for {', '.join(takers)}", param_hint=flag)
    for_reader = {name: value for name, value in given.items() if name in reader.read_options}
    for_writer = {name: value for name, value in given.items() if name in writer.write_options}
    return for_reader, for_writer
