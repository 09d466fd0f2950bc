"""Arguments and options that several commands share, and their checks.

Places have one syntax in all commands: ``x,y``, ``x,y,z`` or ``x,y,L1``.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Argument, BadParameter, Exit, Option
from typer.core import TyperCommand

from navbake import files, samples
from navbake.cli import printing
from navbake.cli.completion import list_door_states, list_levels, list_scenes
from navbake.cli.printing import VERBOSITY, print_error, use_verbosity
from navbake.errors import ConfigError, NavbakeError, printable
from navbake.formats.source import write_bytes
from navbake.known_names import find_similar_names
from navbake.lengths import format_coordinate, format_position

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.paths import Path as Route
    from navbake.runtime.stand import StandPoses
    from navbake.types import Bool
    from navbake.views.plot import Mark

Completion = Callable[..., list[str]]
"""A function of `navbake.cli.completion`, as typer takes it."""
CHOICES = re.compile(r"[a-z]\w*(\|[a-z]\w*)+")
"""The placeholder of an option that takes one of some words, such as ``cost|time``."""


def option(
    metavar: str,
    text: str,
    *names: str,
    default: Any = None,
    choices: str | None = None,
    completion: Completion | None = None,
    **limits: Any,
) -> Any:
    """Return typer's declaration of an option that takes a value.

    Args:
        metavar: the placeholder for the value in the help, such as ``FILE``.
        text: the option's help.
        names: the option's names, such as ``--name`` and ``-n``; by default typer derives one from
            the parameter's name.
        default: the value if the option isn't given; ``...`` if it has to be given.
        choices: the words of which the value has to be one, as in ``cost|time``; None for those of
            `metavar` if it has this form, else for any value. A shell completes them.
        completion: lists the values that a shell completes; None for the choices, or files.
        limits: the smallest (`min`) and the largest (`max`) number that is accepted.
    """
    if choices is None and CHOICES.fullmatch(metavar):
        choices = metavar
    if choices is None:
        return Option(
            default, *names, metavar=metavar, help=text, autocompletion=completion, **limits
        )
    words = choices.split("|")

    def check_word(value: str | None) -> str | None:
        if value is not None and value not in words:
            raise BadParameter(f"expected {' or '.join(words)}, got {value!r}")
        return value

    return Option(
        default,
        *names,
        metavar=metavar,
        help=text,
        autocompletion=lambda: words,
        callback=check_word,
        **limits,
    )


def argument(
    metavar: str, text: str, default: Any = ..., completion: Completion | None = None
) -> Any:
    """Return typer's declaration of an argument, which is required unless it has a default."""
    return Argument(default, metavar=metavar, help=text, autocompletion=completion)


def flag(name: str, text: str, *names: str) -> Any:
    """Return typer's declaration of an option without a value, off by default."""
    return Option(False, name, *names, help=text)


def check_overrides(overrides: list[str] | None) -> list[str]:
    """Check that each override has the form KEY=VALUE; the keys are checked later.

    Raises a BadParameter for another form.
    """
    for override in overrides or []:
        if "=" not in override:
            raise BadParameter(f"expected KEY=VALUE, got {override!r}")
    return overrides or []


def override_sizes(radius: float | None, cell_size: float | None) -> list[str]:
    """Convert the values of `--radius` and `--cell-size` to overrides of settings.

    Raises:
        ConfigError: a value is out of the setting's range; the message names the option.
    """
    from navbake.config.settings import parse_config  # loads numpy and pydantic

    overrides = []
    for option_name, section, key, size in (
        ("--radius", "agent", "radius", radius),
        ("--cell-size", "grid", "cell_size", cell_size),
    ):
        if size is not None:
            # an error of the bake would name `--set`, which the user did not type
            settings = {"scene": {"path": "scene"}, section: {key: size}}
            parse_config(settings, f"{option_name} {size:g}")
            overrides.append(f"{section}.{key}={size}")
    return overrides


def read_pairs(texts: Iterable[str] | None, option: str, pair_form: str) -> dict[str, str]:
    """Read a mapping from texts of the form ``KEY=VALUE``.

    Args:
        texts: the values of an option that may be repeated.
        option: the option's name, for errors.
        pair_form: the form for errors, such as ``NAME=COLUMN``.

    Returns:
        Key -> value.

    Raises:
        BadParameter: a text has no ``=``.
    """
    value_by_key = {}
    for text in texts or ():
        key, equals_sign, value = text.partition("=")
        if not equals_sign:
            raise BadParameter(f"expected {pair_form}, got {key!r}", param_hint=option)
        value_by_key[key] = value
    return value_by_key


GridFile = Annotated[Path, Argument(metavar="GRID", help="A NavGrid file.")]
SceneOrConfig = Annotated[
    Path,
    Argument(
        metavar="SCENE|CONFIG",
        help="A scene file, settings (YAML), or a sample's name.",
        autocompletion=list_scenes,
    ),
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
AgentRadius = Annotated[
    float | None,
    Option("--radius", metavar="METRES", help="The same as --set agent.radius=METRES [m]."),
]
CellSize = Annotated[
    float | None,
    Option("--cell-size", metavar="METRES", help="The same as --set grid.cell_size=METRES [m]."),
]
ModelPath = Annotated[
    list[Path] | None,
    Option(
        "--model-path",
        metavar="FOLDER",
        help="Models of an SDF, packages of a URDF. May be repeated.",
    ),
]


@dataclasses.dataclass(frozen=True)
class SceneFiles:
    """The options of the settings, and of the files that a scene names."""

    overrides: Overrides = None
    model_path: ModelPath = None
    strict: bool = flag(
        "--strict", "Refuse an SDF that names models or meshes that aren't there (scene.strict)."
    )

    def list_overrides(self) -> list[str]:
        """Return all of them as overrides of settings, with absolute paths.

        Raises:
            BadParameter: a folder of `--model-path` isn't there.
        """
        overrides = list(self.overrides or ())
        folders = list_model_folders(self.model_path)
        if folders:
            overrides.append(f"scene.model_path={json.dumps(folders)}")
        if self.strict:
            overrides.append("scene.strict=true")
        return overrides


def list_model_folders(folders: list[Path] | None) -> list[str]:
    """Return the absolute paths of the folders of `--model-path`.

    Raises:
        BadParameter: a folder isn't there.
    """
    for folder in folders or ():
        if not folder.is_dir():
            raise BadParameter(f"no folder {folder}", param_hint="--model-path")
    return [str(folder.absolute()) for folder in folders or ()]


SCENE_OPTION = option(
    "SCENE|CONFIG",
    "The scene of GRID, or the settings of its bake (YAML).  [default: the file that GRID names, "
    "beside it or in the current folder, or in `scenes` there]",
)
QUIET_OPTION = flag("-q", "Print only what was asked for, warnings and errors.", "--quiet")
JSON_OPTION = flag("--json", "Print one JSON object in place of the lines.")
VERBOSE_OPTION = flag("-v", "Print on stderr what is read, done and written, too.", "--verbose")
OUTPUT_FLAGS = "-o", "--output"
"""The names of the option for the output file."""
PICTURE_OPTION = option("PNG|SVG|PDF", "Draw the places; - for a PNG on stdout.", *OUTPUT_FLAGS)
LEVEL_OPTION = option(
    "N|NAME", "Only this level, by number or name; 0 is the lowest.", completion=list_levels
)
STDOUT = Path("-")
"""The output that stands for stdout."""
PICTURE_SUFFIXES = (".png", ".svg", ".pdf")
"""Endings of pictures."""
GRID_SUFFIXES = (".json", ".json.gz")
"""Endings of NavGrid files."""
PLACE = "X,Y[,Z|,LEVEL]"
"""How help texts show a place."""
PLACE_HELP = "in metres; a third number is z, L0 is the lowest level"
NUMBER_PATTERN = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
PLACE_PATTERN = re.compile(  # also 1.5 -2, (1.5, -2) and 1.5, -2, level 1
    rf"[(\[]?({NUMBER_PATTERN})[\s,;]+({NUMBER_PATTERN})(?:[\s,;]+(?:({NUMBER_PATTERN})|(?i:l|level)\s*(\d+)))?[)\]]?"
)
PYTHON_TYPE = re.compile(r" <[^<>]*>$")
"""The Python type that typer adds to the name of an argument in the help."""


def check_door_states(texts: list[str] | None) -> list[str] | None:
    """Check that each value of `--doors` is a state, or has the form NAME=STATE.

    Whether there is such a door is checked later, by `set_doors`.

    Raises:
        BadParameter: a value has another form, or its state is none.
    """
    if not texts:
        return None
    from navbake.navgrid.rooms import DOOR_STATES  # loads numpy

    for text in texts:
        name, equals_sign, state = text.rpartition("=")
        if state not in DOOR_STATES or (equals_sign and not name):
            states_text = " or ".join(DOOR_STATES)
            raise BadParameter(f"expected {states_text}, or NAME=STATE of one door, got {text!r}")
    return texts


DoorStates = Annotated[
    list[str] | None,
    Option(
        "--doors",
        metavar="STATE|NAME=STATE",
        callback=check_door_states,
        autocompletion=list_door_states,
        help="State of all doors, or of the door NAME: modelled, open, closed or removed. May be "
        "repeated; the last one that is about a door counts.  [default: as in the grid]",
    ),
]


def set_doors(grid: NavGrid, texts: list[str] | None) -> NavGrid:
    """Return a grid with its doors in the states that `--doors` gives.

    Args:
        grid: the grid, which is not changed.
        texts: values of `--doors`, applied in this order: a state of all doors, or NAME=STATE of
            one. None to leave the doors as they are.

    Raises:
        QueryError: a door does not exist or can't be in its state, or the grid was inflated.
    """
    if not texts:
        return grid
    state_by_door: dict[str, str] = {}
    for text in texts:
        name, _, state = text.rpartition("=")
        state_by_door |= {name: state} if name else {door.id: state for door in grid.doors}
    return grid.with_doors(state_by_door)


def find_level(grid: NavGrid, text: str | None) -> int | None:
    """Return the number of the level that `--level` names.

    Args:
        grid: the grid.
        text: the level's number, or its name; None for no level.

    Raises:
        ConfigError: the grid has no such level.
    """
    if text is None:
        return None
    names = grid.level_names
    if text.isdecimal() and int(text) < len(names):
        return int(text)
    if text in names:
        return names.index(text)
    levels_text = ", ".join(f"{number} ({name})" for number, name in enumerate(names))
    raise ConfigError(f"no level {text} in {grid.scene_id!r}: it has {levels_text}")


def check_output(
    path: Path,
    *suffixes: str,
    inputs: Iterable[Path] = (),
    may_make_folder: bool = False,
    option: str = "-o",
) -> None:
    """Check, before any work is done, that an output can be written and overwrites no input.

    Args:
        path: the output file; ``-``, which is stdout, is always valid.
        suffixes: the suffixes that its name may end in.
        inputs: the files that it must not be.
        may_make_folder: whether its folder may be missing.
        option: the name of the option that gives the path, for errors.

    Raises:
        BadParameter: the name has a suffix that isn't allowed.
        ConfigError: the output is an input, or can't be written.
    """
    if path == STDOUT:
        return
    real_path = os.path.realpath(path)
    real_inputs = [os.path.realpath(file) for file in inputs]
    is_input = real_path in real_inputs
    if os.path.exists(real_path):  # it may be a hard link
        present_inputs = filter(os.path.exists, real_inputs)
        is_input = is_input or any(os.path.samefile(real_path, file) for file in present_inputs)
    if is_input:
        raise ConfigError(f"expected an output apart from the inputs, got {path}")
    if suffixes and not path.name.lower().endswith(suffixes):
        endings_text = ", ".join(suffixes)
        raise BadParameter(
            f"expected a name that ends in {endings_text}, got {path}", param_hint=option
        )
    probe_path = path
    while may_make_folder and not os.path.exists(probe_path.parent):
        probe_path = probe_path.parent
    try:
        files.check_writable(probe_path)
    except OSError as error:
        hint = ""
        if not probe_path.parent.exists():
            hint = f": make the folder {probe_path.parent} first"
        raise ConfigError(f"cannot write {path}: {error.strerror}{hint}") from error


def write_picture(
    grid: NavGrid,
    output: Path,
    *,
    route: Route | None = None,
    marks: Sequence[Mark] = (),
    poses: StandPoses | None = None,
    region: Sequence[Bool] | None = None,
    **content: Any,
) -> None:
    """Write a picture of a grid, and print its name unless it is stdout.

    Args:
        grid: the grid.
        output: a file, SVG or PDF if its name says so, else PNG; or stdout, which gets a PNG.
        route: a path to draw on top.
        marks: places to mark.
        poses: poses of a base to draw as arrows.
        region: cells to shade, a mask for each level.
        content: other arguments of `navbake.views.plot.render_picture`.
    """
    from navbake.views.plot import Overlays, find_picture_format, render_picture  # loads numpy

    overlays = Overlays(route, marks, poses, region)
    picture_format = "png" if output == STDOUT else find_picture_format(output)
    picture = render_picture(grid, picture_format, overlays=overlays, **content)
    write_output(picture, output)
    if output != STDOUT:
        printing.say_unless_quiet(output)


def write_output(content: bytes, output: Path) -> None:
    """Write content to a file, whole or not at all, or to stdout.

    The file is added to the object that --json prints; if stdout has the content, the object goes
    to stderr.
    """
    if output != STDOUT:
        write_bytes(content, output)
        printing.add_files(output)
        return
    printing.take_stdout()
    if sys.stdout is None:
        raise NavbakeError("cannot write to stdout: it is closed")
    sys.stdout.buffer.write(content)
    sys.stdout.buffer.flush()


def keep_stdout_for(path: Path | None) -> AbstractContextManager[object]:
    """Return a context in which prints go to stderr if `path`, the output file, is stdout."""
    return redirect_stdout(sys.stderr) if path == STDOUT else nullcontext()


def say_if_sample(path: Path) -> None:
    """Print a line on stderr if a path is the name of an installed sample.

    With --quiet, print nothing.
    """
    if VERBOSITY.quiet:
        return
    sample = samples.find(path)
    if sample not in (path, Path(f"{path}.yaml")):
        print_error(f"{path} is the installed sample {sample}: `navbake samples {path}` copies it")


def refuse_unused(name: str, is_given: bool, *, has_effect: bool, purpose: str) -> None:
    """Refuse an option that is given but would have no effect.

    Args:
        name: the option's name, as typed.
        is_given: whether it is given.
        has_effect: whether it has an effect beside the other arguments.
        purpose: what it is for, for the error.

    Raises:
        BadParameter: the option is given and has no effect.
    """
    if is_given and not has_effect:
        raise BadParameter(f"does nothing here: it is for {purpose}", param_hint=name)


def _expect_words(not_one_of: re.Match[str]) -> str:
    words = re.findall(r"'([^']*)'", not_one_of["words"])
    return f"expected {' or '.join(words)}, got {not_one_of['value']}"


# What typer says of a value of a wrong type, in pydantic's words -> the same in ours
TYPE_ERRORS: dict[str, str | Callable[[re.Match[str]], str]] = {
    r"(?:Value error, )?(?P<value>'[^']*') is not one of (?P<words>'.*')\.?": _expect_words,
    r"Input should be a valid number\b[^']*?(?=, got|$)": "expected a number",
    r"Input should be a valid integer\b[^']*?(?=, got|$)": "expected a whole number",
    r"Input should be greater than or equal to": "expected a number >=",
    r"Input should be greater than": "expected a number >",
    r"Input should be less than or equal to": "expected a number <=",
}


class NavbakeCommand(TyperCommand):
    """A command whose help lists --output first and shows no Python types.

    If the value of an option is wrong, the error quotes the value.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            return list(super().parse_args(ctx, args))
        except BadParameter as error:
            from pydantic import ValidationError  # typer has loaded it by now

            for pattern, plain_text in TYPE_ERRORS.items():
                error.message = re.sub(pattern, plain_text, error.message)
            if isinstance(error.__cause__, ValidationError):
                value = error.__cause__.errors()[0]["input"]
                if repr(value) not in error.message:
                    error.message += f", got {value!r}"
            if error.param is not None and error.param.nargs > 1:
                error.message += f": it takes {error.param.nargs} values"
            raise

    def format_options(self, ctx: Any, formatter: Any) -> None:
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            parameters = [
                parameter for parameter in self.get_params(ctx) if parameter.param_type_name == kind
            ]
            parameters.sort(key=lambda parameter: "--output" not in parameter.opts)
            records = [parameter.get_help_record(ctx) for parameter in parameters]
            lines = [(PYTHON_TYPE.sub("", record[0]), record[1]) for record in records if record]
            if lines:
                with formatter.section(title):
                    formatter.write_dl(lines)


def prepare_command(command: Callable[..., None]) -> Callable[..., None]:
    """Wrap a command so that typer can read its options from its signature.

    The options -q, -v and --json are added; a command that has --json itself receives it. With
    --json, the facts of the command are printed at its end, unless an error ends it. A parameter
    whose type is a dataclass is a group of options: the dataclass's fields become options, and the
    command receives the dataclass.
    """
    # `get_type_hints` of Python 3.10 would hide the options whose default is None
    type_hints = inspect.get_annotations(command, eval_str=True)
    option_groups: dict[str, Any] = {
        name: hint for name, hint in type_hints.items() if dataclasses.is_dataclass(hint)
    }

    @wraps(command)
    def run_command(
        quiet: bool, verbose: bool, prints_facts: bool = False, **values: object
    ) -> None:
        if quiet and verbose:
            raise BadParameter("expected one of them", param_hint="--quiet, --verbose")
        for name, group in option_groups.items():
            field_values = {
                field.name: values.pop(field.name) for field in dataclasses.fields(group)
            }
            values[name] = group(**field_values)
        with use_verbosity(quiet=quiet, verbose=verbose, as_json=prints_facts):
            try:
                command(**values)
            except Exit:  # the answer is no, and the facts say why
                printing.print_facts()
                raise
            printing.print_facts()

    parameters = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name in option_groups:
            parameters += _parameters_of(option_groups[parameter.name])
        else:
            parameters.append(
                _keyword(parameter.name, parameter.default, type_hints[parameter.name])
            )
    option_names: list[str] = []
    for parameter in parameters:
        option_names += getattr(parameter.default, "param_decls", None) or ()
    if "--json" not in option_names:
        parameters.append(_keyword("prints_facts", JSON_OPTION, bool))
    parameters.append(_keyword("quiet", QUIET_OPTION, bool))
    parameters.append(_keyword("verbose", VERBOSE_OPTION, bool))
    run_command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run_command


def _parameters_of(group: Any) -> list[inspect.Parameter]:
    """Return a parameter for each field of a group of options, which is a dataclass."""
    type_hints = inspect.get_annotations(group, eval_str=True)
    return [
        _keyword(field.name, field.default, type_hints[field.name])
        for field in dataclasses.fields(group)
    ]


def _keyword(name: str, default: object, annotation: object) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


# --- places -----------------------------------------------------------------------------------


def parse_pair(text: str, option: str) -> tuple[float, float]:
    """Parse two lengths.

    Args:
        text: two numbers >= 0 with a comma in between.
        option: the name of the option that gives the text, for errors.

    Raises:
        BadParameter: the text has another form.
    """
    match = re.fullmatch(rf"({NUMBER_PATTERN}),({NUMBER_PATTERN})", text.replace(" ", ""))
    lengths = (float(match[1]), float(match[2])) if match else (-1.0, -1.0)
    if not all(0.0 <= length < math.inf for length in lengths):
        raise BadParameter(
            f"expected two lengths in metres as in 0.3,0.8, got {text!r}", param_hint=option
        )
    return lengths


def parse_length(text: str, option: str) -> float:
    """Parse a length.

    Args:
        text: a number >= 0.
        option: the name of the option that gives the text, for errors.

    Raises:
        BadParameter: the text has another form.
    """
    is_number = re.fullmatch(NUMBER_PATTERN, text.strip()) is not None
    if not is_number or not 0.0 <= float(text) < math.inf:
        raise BadParameter(
            f"expected a length in metres as in 0.5, got {text!r}", param_hint=option
        )
    return float(text)


def parse_rectangle(text: str, option: str) -> list[tuple[float, float]]:
    """Parse length and width, and return the corners of a rectangle round the origin.

    Args:
        text: two numbers >= 0 with a comma in between.
        option: the name of the option that gives the text, for errors.

    Returns:
        x ahead and y to the left of each of the four corners [m].

    Raises:
        BadParameter: the text has another form.
    """
    length, width = parse_pair(text, option)
    half_length = length / 2.0
    half_width = width / 2.0
    return [
        (half_length, half_width),
        (-half_length, half_width),
        (-half_length, -half_width),
        (half_length, -half_width),
    ]


class TypedPlace(NamedTuple):
    """A place that a user typed: x and y, and either z, a level, or neither."""

    x: float  # world x [m]
    y: float  # world y [m]
    z: float | None  # world z [m]
    level: int | None  # number of the level, 0 is the lowest


def parse_place(
    text: str,
    option: str,
    load_grid: Callable[[], NavGrid] | None = None,
    *,
    with_objects: bool = False,
) -> TypedPlace:
    """Parse a place.

    Args:
        text: ``x,y``, ``x,y,z`` or ``x,y,L1``.
        option: the name of the option that gives the text, for errors.
        load_grid: returns the grid whose rooms the error offers. It is called for the error alone,
            as loading takes seconds, and not for a text with a comma, which was meant as numbers.
            None where the option takes places alone.
        with_objects: whether the option also takes objects, so that the error offers them, too.

    Raises:
        BadParameter: the text has another form, or a number is not finite.
    """
    place_match = PLACE_PATTERN.fullmatch(text)
    if not place_match:
        hint = ""
        if load_grid is not None and "," not in text:
            hint = _hint_at_name(text, load_grid(), with_objects)
        message = f"expected {PLACE} as in 1.5,-2 or 1.5,-2,0.3 or 1.5,-2,L1, got {text!r}{hint}"
        raise BadParameter(message, param_hint=option)
    x = float(place_match[1])
    y = float(place_match[2])
    z = None if place_match[3] is None else float(place_match[3])
    level = None if place_match[4] is None else int(place_match[4])
    if not all(map(math.isfinite, (x, y, z or 0.0))):
        raise BadParameter(f"expected finite numbers, got {text!r}", param_hint=option)
    return TypedPlace(x or 0.0, y or 0.0, z, level)  # no -0.0


def _hint_at_name(text: str, grid: NavGrid, with_objects: bool) -> str:
    """Write a hint for a text that is no place, such as ``; did you mean room:hall?``."""
    from navbake.navgrid.names import list_object_names, list_room_names  # loads numpy

    names_by_place = {f"room:{name}": name for name in list_room_names(grid)}
    written_text = "a room is written room:NAME"
    if with_objects:
        names_by_place |= {f"object:{name}": name for name in list_object_names(grid)}
        written_text += ", an object object:NAME"
    similar_names = find_similar_names(text, names_by_place.values())
    for place_text, name in names_by_place.items():
        if name in similar_names:
            return f"; did you mean {printable(place_text)}? {written_text}"
    return f"; {written_text}"


def position_of_place(grid: NavGrid, place: TypedPlace, option: str) -> list[float]:
    """Return the position of a place that a user typed.

    A place without z gets the z of the floor on its level. A place without z and level gets the z
    of the only floor at its x, y; on a grid of one level it stays x, y.

    Args:
        grid: the grid.
        place: the place.
        option: the name of the option that gives the place, for errors.

    Returns:
        World x, y and maybe z [m].

    Raises:
        BadParameter: the place has neither z nor level, and there is a floor on no level or on
            several; or its level has no floor there, and the height of that level's ground is on
            another level there.
        QueryError: the grid has no such level.
    """
    x, y, z, level = place
    if z is not None:
        return [x, y, z]
    if level is None and len(grid.levels) == 1:
        return [x, y]
    floor_by_level = {}
    for level_number in range(len(grid.levels)) if level is None else [level]:
        cell = grid.at((x, y), level_number)
        if cell and cell.floor is not None:
            floor_by_level[level_number] = cell.floor
    if level is None and not floor_by_level:
        raise BadParameter(f"no level has a floor at {format_position((x, y))}", param_hint=option)
    if level is None and len(floor_by_level) > 1:
        place_text = f"{format_coordinate(x)},{format_coordinate(y)}"
        got_text = f"{place_text}, where {len(floor_by_level)} levels have a floor"
        hint = " or ".join(f"{place_text},L{level_number}" for level_number in floor_by_level)
        message = f"expected a place with a level or z, got {got_text}: write {hint}"
        raise BadParameter(message, param_hint=option)
    if level is None:
        level = next(iter(floor_by_level))
    z = float(floor_by_level.get(level, grid.levels[level].ground))
    cell_at_floor = grid.cell_at((x, y, z))
    if cell_at_floor is not None and cell_at_floor.level != level:
        raise BadParameter(
            f"level {level} has no floor at {format_position((x, y))}", param_hint=option
        )
    return [x, y, z]
