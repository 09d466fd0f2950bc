"""The sample scenes with their settings, to try navbake with.

They are the folder `configs/` of a checkout; an installed navbake carries a copy of it.
"""

from os import PathLike
from pathlib import Path

from navbake.errors import ConfigError
from navbake.files import write_whole
from navbake.known_names import suggest

_PACKAGE = Path(__file__).parent
_FOLDERS = (_PACKAGE / "sample_files", _PACKAGE.parent / "configs")
"""In an installed package, as `pyproject.toml` has it; and in a checkout."""


def names() -> list[str]:
    """The names of the samples: apartment, clutter, house, terrain, tower and warehouse."""
    return sorted(file.stem for file in _folder().glob("*.yaml"))


def path(name: str) -> Path:
    """The settings of a sample, a YAML file that `navbake.bake` takes.

    Raises a ConfigError for a name that isn't one of `names`.
    """
    if name not in names():
        raise ConfigError(f"no sample {name!r}: {suggest(name, names())}")
    return _folder() / f"{name}.yaml"


def find(given: str | PathLike[str]) -> Path:
    """What a path means that is the bare name of a sample and no file; else the path itself.

    That is ``NAME.yaml`` in the current folder, or else the settings of the installed sample.
    """
    found = Path(given)
    if found.suffix or found.name != str(given) or found.exists() or found.name not in names():
        return found
    own = Path(f"{found.name}.yaml")
    return own if own.exists() else path(found.name)


def copy(name: str, folder: Path | str = ".") -> list[Path]:
    """Copy a sample to a folder, to change it: its settings and the files of its scene.

    Returns the files, the settings first; those that were there with the same content stay. Raises
    a ConfigError if there is no such sample, or another file is there by one of the names.
    """
    settings = path(name)
    target = Path(folder)
    scenes = _folder() / "scenes"
    own = sorted(scenes.glob(f"{name}.*"))
    text = "".join(file.read_text(encoding="utf-8") for file in own if file.suffix == ".xml")
    assets = [file for file in sorted((scenes / "assets").iterdir()) if file.name in text]
    files = [settings, *own, *assets]
    copies = {file: target / file.relative_to(settings.parent) for file in files}
    contents = {file: file.read_bytes() for file in files}
    try:
        for file, written in copies.items():
            if written.exists() and written.read_bytes() != contents[file]:
                raise ConfigError(f"another {written} is there: move it, or copy elsewhere")
        for file, written in copies.items():
            if not written.exists():
                written.parent.mkdir(parents=True, exist_ok=True)
                write_whole(contents[file], written)
    except OSError as error:
        raise ConfigError(f"cannot write {error.filename or target}: {error.strerror}") from error
    return list(copies.values())


def _folder() -> Path:
    for folder in _FOLDERS:
        if folder.is_dir():
            return folder
    raise ConfigError(f"the samples are not in {_FOLDERS[0]}: reinstall navbake")
