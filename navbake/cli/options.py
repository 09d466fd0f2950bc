"""Arguments and options that several commands share, and what checks them."""

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from typer import Argument, BadParameter, Option

from navbake import files
from navbake.errors import ConfigError


def check_overrides(overrides: list[str] | None) -> list[str]:
    """Refuse what is not KEY=VALUE; the settings refuse unknown keys."""
    for override in overrides or []:
        if "=" not in override:
            raise BadParameter(f"expected KEY=VALUE, got {override!r}")
    return overrides or []


GridFile = Annotated[Path, Argument(metavar="GRID", help="A NavGrid file.")]
SceneOrConfig = Annotated[
    Path, Argument(metavar="SCENE|CONFIG", help="A scene file, or settings (YAML).")
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
AsJson = Annotated[bool, Option("--json", help="Print JSON.")]


def check_output(path: Path, *suffixes: str, may_make_folder: bool = False) -> None:
    """Refuse a file that can't be written, or has none of the suffixes, before any work is done.

    With `may_make_folder`, its folder may be missing, as long as it can be made.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise BadParameter(
            f"expected a name that ends in {', '.join(suffixes)}, got {path}", param_hint="-o"
        )
    probe = path
    while may_make_folder and not probe.parent.exists():
        probe = probe.parent
    try:
        files.check_writable(probe)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Let a command take options that belong together as one NamedTuple.

    typer makes an option of each parameter. So what it sees in place of a NamedTuple are the
    NamedTuple's fields, with their annotations and defaults.
    """
    groups = {p.name: p.annotation for p in _parameters(command) if hasattr(p.annotation, "_make")}

    @wraps(command)
    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field: values.pop(field) for field in group._fields})
        command(**values)

    parameters: list[inspect.Parameter] = []
    for parameter in _parameters(command):
        is_group = parameter.name in groups
        parameters += _parameters(parameter.annotation) if is_group else [parameter]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Parameters of a function or fields of a NamedTuple, with their annotations evaluated.

    They are keyword-only, so that one with a default may precede one without.
    """
    hints = get_type_hints(function, include_extras=True)
    return [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[name])
        for name, parameter in inspect.signature(function).parameters.items()
    ]
