"""Sample scenes with their settings, to try navbake with.

They are the folder `configs/` of a checkout; an installed navbake has a copy of it.
"""

from os import PathLike
from pathlib import Path

from navbake.errors import ConfigError
from navbake.files import write_whole
from navbake.known_names import suggest

_PACKAGE = Path(__file__).parent
_FOLDERS = (_PACKAGE / "sample_files", _PACKAGE.parent / "configs")
"""Where the samples may be: first the folder in an installed package, then that in a checkout."""


def names() -> list[str]:
    """Return the names of the samples: apartment, clutter, house, terrain, tower and warehouse."""
    return sorted(file.stem for file in _folder().glob("*.yaml"))


def path(name: str) -> Path:
    """Return the path of a sample's settings, a YAML file that `navbake.bake` takes.

    Raises:
        ConfigError: There is no such sample.

    Example:
        >>> grid = navbake.bake(navbake.samples.path("apartment"))
    """
    if name not in names():
        hint = suggest(name, names())
        raise ConfigError(f"no sample {name!r}: {hint}", value=name, hint=hint)
    return _folder() / f"{name}.yaml"


def find(scene: str | PathLike[str]) -> Path:
    """Return the path of the settings of a sample; any other path is returned as it is.

    Args:
        scene: The name of a sample, or a path. If there is a file with the name, it is a path. Else
            the name stands for ``NAME.yaml`` in the current folder, or if that doesn't exist, for
            the settings of the installed sample.
    """
    as_path = Path(scene)
    is_name = not as_path.suffix and as_path.name == str(scene)
    if not is_name or as_path.exists() or as_path.name not in names():
        return as_path
    local_settings = Path(f"{as_path.name}.yaml")
    return local_settings if local_settings.exists() else path(as_path.name)


def copy(name: str, folder: Path | str = ".") -> list[Path]:
    """Copy a sample to a folder, to change it: its settings and the files of its scene.

    Args:
        name: The name of the sample.
        folder: The folder, which is made if it does not exist.

    Returns:
        The paths of the copied files, the settings first. A file that is there already with the
        same content is not written, but listed.

    Raises:
        ConfigError: There is no such sample, a file cannot be written, or a file is there already
            with different content.
    """
    settings = path(name)
    target = Path(folder)
    scenes = _folder() / "scenes"
    scene_files = sorted(scenes.glob(f"{name}.*"))
    mjcf_files = [file for file in scene_files if file.suffix == ".xml"]
    mjcf = "".join(file.read_text(encoding="utf-8") for file in mjcf_files)
    assets = [file for file in sorted((scenes / "assets").iterdir()) if file.name in mjcf]
    sources = [settings, *scene_files, *assets]
    copies = {source: target / source.relative_to(settings.parent) for source in sources}
    contents = {source: source.read_bytes() for source in sources}
    try:
        for source, copied in copies.items():
            if copied.exists() and copied.read_bytes() != contents[source]:
                hint = "move it, or copy elsewhere"
                raise ConfigError(f"another {copied} is there: {hint}", path=str(copied), hint=hint)
        for source, copied in copies.items():
            if not copied.exists():
                copied.parent.mkdir(parents=True, exist_ok=True)
                write_whole(contents[source], copied)
    except OSError as error:
        file = str(error.filename or target)
        raise ConfigError(f"cannot write {file}: {error.strerror}", path=file) from error
    return list(copies.values())


def _folder() -> Path:
    """Return the folder of the samples."""
    for folder in _FOLDERS:
        if folder.is_dir():
            return folder
    raise ConfigError(f"the samples are not in {_FOLDERS[0]}: reinstall navbake")
