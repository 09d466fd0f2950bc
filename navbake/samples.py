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
    return sorted(file.stem for file in _find_samples_folder().glob("*.yaml"))


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
    return _find_samples_folder() / f"{name}.yaml"


def find(scene: str | PathLike[str]) -> Path:
    """Return the path of a sample's settings; the path of another scene is returned unchanged.

    Args:
        scene: The name of a sample, or a path. If there is a file with the name, it is a path. Else
            the name stands for ``NAME.yaml`` in the current folder, or if that doesn't exist, for
            the settings of the installed sample.
    """
    scene_path = Path(scene)
    is_name = not scene_path.suffix and scene_path.name == str(scene)
    if not is_name or scene_path.exists() or scene_path.name not in names():
        return scene_path
    local_settings_path = Path(f"{scene_path.name}.yaml")
    return local_settings_path if local_settings_path.exists() else path(scene_path.name)


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
    settings_path = path(name)
    target_folder = Path(folder)
    scenes_folder = _find_samples_folder() / "scenes"
    scene_files = sorted(scenes_folder.glob(f"{name}.*"))
    mjcf_files = [scene_file for scene_file in scene_files if scene_file.suffix == ".xml"]
    mjcf_text = "".join(mjcf_file.read_text(encoding="utf-8") for mjcf_file in mjcf_files)
    asset_files = [
        asset_file
        for asset_file in sorted((scenes_folder / "assets").iterdir())
        if asset_file.name in mjcf_text
    ]
    source_files = [settings_path, *scene_files, *asset_files]
    copy_by_source = {
        source_file: target_folder / source_file.relative_to(settings_path.parent)
        for source_file in source_files
    }
    content_by_file = {source_file: source_file.read_bytes() for source_file in source_files}
    try:
        for source_file, copied_file in copy_by_source.items():
            if copied_file.exists() and copied_file.read_bytes() != content_by_file[source_file]:
                hint = "move it, or copy elsewhere"
                raise ConfigError(
                    f"another {copied_file} is there: {hint}", path=str(copied_file), hint=hint
                )
        for source_file, copied_file in copy_by_source.items():
            if not copied_file.exists():
                copied_file.parent.mkdir(parents=True, exist_ok=True)
                write_whole(content_by_file[source_file], copied_file)
    except OSError as error:
        error_path = str(error.filename or target_folder)
        raise ConfigError(
            f"cannot write {error_path}: {error.strerror}", path=error_path
        ) from error
    return list(copy_by_source.values())


def _find_samples_folder() -> Path:
    """Return the folder of the samples."""
    for folder in _FOLDERS:
        if folder.is_dir():
            return folder
    raise ConfigError(f"the samples are not in {_FOLDERS[0]}: reinstall navbake")
