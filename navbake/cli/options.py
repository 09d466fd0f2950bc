"""Arguments and options that several commands share, and their checks.

Places have one syntax in all commands: ``x,y``, ``x,y,z`` or ``x,y,L1``.
"""

from __future__ import annotations

import inspect
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from typer import Argument, BadParameter, Option
from typer.core import TyperCommand

from navbake import files, samples
from navbake.cli.printing import VOLUME, print_error, volume
from navbake.errors import ConfigError, NavbakeError
from navbake.formats.source import write_bytes

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid


def option(metavar: str, text: str, *names: str, default: Any = None, **more: Any) -> Any:
    """An option with a value, None unless given; `metavar` and `text` are for its help."""
    return Option(default, *names, metavar=metavar, help=text, **more)


def argument(metavar: str, text: str, default: Any = ...) -> Any:
    """An argument, which has to be given unless it has a default."""
    return Argument(default, metavar=metavar, help=text)


def flag(name: str, text: str, *names: str) -> Any:
    """An option without a value."""
    return Option(False, name, *names, help=text)


def check_overrides(overrides: list[str] | None) -> list[str]:
    """Refuse overrides that are not KEY=VALUE; the settings refuse unknown keys."""
    for override in overrides or []:
        if "=" not in override:
            raise BadParameter(f"expected KEY=VALUE, got {override!r}")
    return overrides or []


def override_model_path(folders: list[Path] | None) -> list[str]:
    """The override of `--model-path`, relative to the current folder."""
    listed = [str(folder.absolute()) for folder in folders or []]
    return [f"scene.model_path={json.dumps(listed)}"] if listed else []


def read_pairs(texts: Iterable[str] | None, option: str, form: str) -> dict[str, str]:
    """Values by key, from texts as ``KEY=VALUE``."""
    pairs = [text.partition("=") for text in texts or ()]
    for key, mark, _ in pairs:
        if not mark:
            raise BadParameter(f"expected {form}, got {key!r}", param_hint=option)
    return {key: value for key, _, value in pairs}


GridFile = Annotated[Path, Argument(metavar="GRID", help="A NavGrid file.")]
SceneOrConfig = Annotated[
    Path,
    Argument(metavar="SCENE|CONFIG", help="A scene file, settings (YAML), or a sample's name."),
]
Overrides = Annotated[
    list[str] | None,
    Option(
        "--set",
        metavar="KEY=VALUE",
        callback=check_overrides,
        help="Override a setting, e.g. grid.cell_size=0.05. May be repeated.",
    ),
]
ModelPath = Annotated[
    list[Path] | None,
    Option("--model-path", metavar="FOLDER", help="Models of an SDF scene. May be repeated."),
]
BAKED_SCENE = option(
    "SCENE|CONFIG",
    "The scene of GRID, or the settings of its bake (YAML).  [default: the file that GRID names, "
    "beside it or in the current folder, or in `scenes` there]",
)
AsJson = Annotated[bool, Option("--json", help="Print JSON.")]
QUIET = flag("-q", "Print only what was asked for, warnings and errors.", "--quiet")
VERBOSE = flag("-v", "Print on stderr what is read, done and written, too.", "--verbose")
OUTPUT = "-o", "--output"
"""The names of the option."""
PICTURE = option("PNG|SVG", "Draw the places; - for a PNG on stdout.", *OUTPUT)
LEVEL = option("N", "Only this level; 0 is the lowest.", min=0)
STDOUT = Path("-")
"""The output that stands for stdout."""
GRIDS = (".json", ".json.gz")
"""Endings of NavGrid files."""
PLACE = "X,Y[,Z|,LEVEL]"
"""How help texts show a place."""
PLACE_HELP = "in metres; a third number is z, L0 is the lowest level"
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
SPELLED = re.compile(  # also 1.5 -2, (1.5, -2) and 1.5, -2, level 1
    rf"[(\[]?({NUMBER})[\s,;]+({NUMBER})(?:[\s,;]+(?:({NUMBER})|(?i:l|level)\s*(\d+)))?[)\]]?"
)
PYTHON_TYPE = re.compile(r" <[^<>]*>$")
"""What typer adds to the name of an argument."""


def check_output(
    path: Path,
    *suffixes: str,
    inputs: Iterable[Path] = (),
    may_make_folder: bool = False,
    option: str = "-o",
) -> None:
    """Refuse an output that can't be written, or would do harm, before any work is done.

    Its name must end in one of `suffixes`, it must be none of `inputs`, and its folder may be
    missing only with `may_make_folder`. ``-``, which is stdout, is always valid. `option` is for
    messages.
    """
    if path == STDOUT:
        return
    own = os.path.realpath(path)
    others = [os.path.realpath(file) for file in inputs]
    there = filter(os.path.exists, others if os.path.exists(own) else [])  # hard links
    if own in others or any(os.path.samefile(own, file) for file in there):
        raise ConfigError(f"expected an output apart from the inputs, got {path}")
    if suffixes and not path.name.lower().endswith(suffixes):
        endings = ", ".join(suffixes)
        raise BadParameter(f"expected a name that ends in {endings}, got {path}", param_hint=option)
    probe = path
    while may_make_folder and not os.path.exists(probe.parent):
        probe = probe.parent
    try:
        files.check_writable(probe)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error


def write_picture(grid: NavGrid, output: Path, **drawn: Any) -> None:
    """Write a picture of a grid, or a PNG to stdout; for the arguments see `render_picture`."""
    from navbake.views.plot import render_picture  # loads numpy

    form = "svg" if output.name.lower().endswith(".svg") else "png"
    write_output(render_picture(grid, form, **drawn), output)


def write_output(content: bytes, output: Path) -> None:
    """Write a file, whole or not at all, or to stdout."""
    if output != STDOUT:
        write_bytes(content, output)
        return
    if sys.stdout is None:
        raise NavbakeError("cannot write to stdout: it is closed")
    sys.stdout.buffer.write(content)
    sys.stdout.buffer.flush()


def beside_output(path: Path | None) -> AbstractContextManager[Any]:
    """Redirect a command's prints to stderr if its output goes to stdout."""
    return redirect_stdout(sys.stderr) if path == STDOUT else nullcontext()


def say_if_sample(path: Path) -> None:
    """Print on stderr that a bare name is an installed sample's; with --quiet nothing."""
    if not VOLUME.quiet and (found := samples.find(path)) not in (path, Path(f"{path}.yaml")):
        print_error(f"{path} is the installed sample {found}: `navbake samples {path}` copies it")


def refuse_unused(*uses: tuple[str, bool, bool, str]) -> None:
    """Refuse options without effect: name, whether it is given, whether it applies, its purpose."""
    for name, is_given, applies, purpose in uses:
        if is_given and not applies:
            raise BadParameter(f"does nothing here: it is for {purpose}", param_hint=name)


class Command(TyperCommand):
    """A command whose help has plain metavars, without Python types, and --output first.

    Errors of values that are no numbers name the value.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        words = [part for word in args for part in word.split("=", 1)]
        try:
            return list(super().parse_args(ctx, args))
        except BadParameter as error:
            for name in error.param.opts if error.param else ():
                given = words[words.index(name) + 1] if name in words[:-1] else ""
                if given not in error.message:
                    error.message += f", got {given!r}"
            raise

    def format_options(self, ctx: Any, formatter: Any) -> None:
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            shown = [each for each in self.get_params(ctx) if each.param_type_name == kind]
            shown.sort(key=lambda each: "--output" not in each.opts)
            records = filter(None, (each.get_help_record(ctx) for each in shown))
            lines = [(PYTHON_TYPE.sub("", name), text) for name, text in records]
            if lines:
                with formatter.section(title):
                    formatter.write_dl(lines)


def prepared(command: Callable[..., None]) -> Callable[..., None]:
    """Prepare a command for typer, which makes an option of each parameter: add -q and -v."""

    @wraps(command)
    def run(quiet: bool, verbose: bool, **values: Any) -> None:
        if quiet and verbose:
            raise BadParameter("expected one of them", param_hint="--quiet, --verbose")
        with volume(quiet=quiet, verbose=verbose):
            command(**values)

    # `get_type_hints` of Python 3.10 would hide the options whose default is None
    hints = inspect.get_annotations(command, eval_str=True) | {"quiet": bool, "verbose": bool}
    kind = inspect.Parameter.KEYWORD_ONLY
    parameters = [*inspect.signature(command).parameters.values()]
    parameters += [inspect.Parameter("quiet", kind, default=QUIET)]
    parameters += [inspect.Parameter("verbose", kind, default=VERBOSE)]
    parameters = [each.replace(kind=kind, annotation=hints[each.name]) for each in parameters]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


# --- places -----------------------------------------------------------------------------------


GivenPlace: TypeAlias = tuple[float, float, float | None, int | None]
"""A place as it was given: world x, y [m], and either z [m], or a level, or neither."""


def parse_place(text: str, option: str) -> GivenPlace:
    """Parse a place given to an option; raises a BadParameter."""
    found = SPELLED.fullmatch(text)
    if not found:
        name = text if text.isidentifier() else "NAME"
        hint = f"; a room is written room:{name}" if option != "--at" else ""
        message = f"expected {PLACE} as in 1.5,-2 or 1.5,-2,0.3 or 1.5,-2,L1, got {text!r}{hint}"
        raise BadParameter(message, param_hint=option)
    x, y, z = (None if number is None else float(number) for number in found.groups()[:3])
    if not all(math.isfinite(number or 0.0) for number in (x, y, z)):
        raise BadParameter(f"expected finite numbers, got {text!r}", param_hint=option)
    return x or 0.0, y or 0.0, z, None if found[4] is None else int(found[4])


def position_of_place(grid: NavGrid, given: GivenPlace, option: str) -> list[float]:
    """World x, y, z [m] of a place, on the floor of its level if it has no z.

    A place without a level is on the only level with a floor there; with none or several, it is a
    BadParameter, as is one on a level that is open to the one below. On a grid of one level it
    stays x, y. An unknown level is a QueryError.
    """
    x, y, z, level = given
    if z is not None or (level is None and len(grid.levels) == 1):
        return [x, y] if z is None else [x, y, z]
    asked = range(len(grid.levels)) if level is None else [level]
    places = {number: grid.at((x, y), number) for number in asked}
    floors = {number: at.floor for number, at in places.items() if at and at.floor is not None}
    if level is None and not floors:
        raise BadParameter(f"no level has a floor at {x:g}, {y:g}", param_hint=option)
    if level is None and len(floors) > 1:
        got = f"{x:g},{y:g}, where {len(floors)} levels have a floor"
        hint = " or ".join(f"{x:g},{y:g},L{number}" for number in floors)
        message = f"expected a place with a level or z, got {got}: write {hint}"
        raise BadParameter(message, param_hint=option)
    level = next(iter(floors)) if level is None else level
    z = float(floors.get(level, grid.levels[level].ground))
    found = grid.cell_at((x, y, z))
    if found is not None and found.level != level:
        raise BadParameter(f"level {level} has no floor at {x:g}, {y:g}", param_hint=option)
    return [x, y, z]
