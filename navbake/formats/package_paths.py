"""Lists where the files of ROS packages and of Gazebo's Fuel may be on this machine.

Sources: ament/ament_index, packages.py (AMENT_PREFIX_PATH: a package is in ``share`` of a prefix);
ros/rospack, rospack.cpp (ROS_PACKAGE_PATH: folders are searched at any depth, down to a
package.xml); gazebosim/gz-fuel-tools, FuelClient.cc and LocalCache.cc (addresses of models, and
``<cache>/<server>/<owner>/models/<name>/<version>`` in lower case).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

ROS_PACKAGE_PATH = "ROS_PACKAGE_PATH"
AMENT_PREFIX_PATH = "AMENT_PREFIX_PATH"
PACKAGE_FILE = "package.xml"
PACKAGE_NAME = re.compile(rb"<name>\s*([\w.-]+)\s*</name>")
MAX_FOLDERS = 20_000  # folders of ROS_PACKAGE_PATH that are searched for packages
# Environment variables with the folder of Fuel's cache, the newest first, and where it is without
FUEL_CACHE_PATHS = ("GZ_FUEL_CACHE_PATH", "IGN_FUEL_CACHE_PATH")
FUEL_CACHES = (Path(".gz", "fuel"), Path(".ignition", "fuel"))
# Fuel's server had another name before; its models are in the cache under either name
FUEL_SERVERS = ("fuel.gazebosim.org", "fuel.ignitionrobotics.org")
FUEL_ADDRESS = re.compile(
    r"(?:https?|fuel)://(?P<server>[^/]+)/(?:\d+(?:\.\d+)*/)?(?P<owner>[^/]+)/models/"
    r"(?P<name>[^/]+)(?:/(?P<version>\d+|tip)(?=/|$))?(?:/files(?=/|$))?(?:/(?P<path>.*))?",
    re.IGNORECASE,
)
# A file in a cache, as Gazebo writes it where it saves a world: the cache of another user, maybe
FUEL_CACHE_FILE = re.compile(
    r"(?:file://)?/.*/fuel/(?P<server>[^/]+)/(?P<owner>[^/]+)/models/(?P<name>[^/]+)"
    r"/(?P<version>\d+)(?:/(?P<path>.*))?",
    re.IGNORECASE,
)


class RosPackages:
    """Finds the folders of ROS packages by the packages' names.

    Args:
        folders: the folders of the setting `scene.model_path`: each one contains packages, or is
            itself the folder of a package.
    """

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        self._folders = folders

    def list_stated_folders(self, name: str) -> Iterator[Path]:
        """Yield the folders where a package may be, by the setting `scene.model_path`.

        Args:
            name: the package's name.
        """
        for folder in self._folders:
            yield from _list_package_folders(folder, name)

    def list_installed_folders(self, name: str) -> Iterator[Path]:
        """Yield the folders where a package may be, by ROS's environment variables, in ROS's order.

        Args:
            name: the package's name.
        """
        for prefix_folder in _folders_of(AMENT_PREFIX_PATH):
            yield prefix_folder / "share" / name
        for folder in _folders_of(ROS_PACKAGE_PATH):
            yield from _list_package_folders(folder, name)
        if name in self._nested_packages:
            yield self._nested_packages[name]

    @cached_property
    def _nested_packages(self) -> dict[str, Path]:
        """Name -> folder, of packages at any depth in the folders of ROS_PACKAGE_PATH."""
        folder_of_package = dict[str, Path]()
        unread_folders = _folders_of(ROS_PACKAGE_PATH)[::-1]
        num_folders = 0
        while unread_folders and num_folders < MAX_FOLDERS:
            folder = unread_folders.pop()
            num_folders += 1
            package_file = folder / PACKAGE_FILE
            if package_file.is_file():
                try:
                    name_match = PACKAGE_NAME.search(package_file.read_bytes())
                except OSError:
                    name_match = None
                name = folder.name if name_match is None else name_match[1].decode()
                folder_of_package.setdefault(name, folder)
                continue  # there are no packages in packages
            unread_folders += _list_subfolders(folder)[::-1]
        return folder_of_package


def _folders_of(variable: str) -> list[Path]:
    """Return the folders that an environment variable lists."""
    return [Path(name) for name in os.environ.get(variable, "").split(os.pathsep) if name]


def _list_package_folders(folder: Path, name: str) -> list[Path]:
    """Return the folders that may be a package: the subfolder of its name, or `folder` itself."""
    return [folder / name, *([folder] if folder.name == name else [])]


def _list_subfolders(folder: Path) -> list[Path]:
    """Return the folders in a folder, sorted; links and hidden ones are left out."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(
                entry.name
                for entry in entries
                if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)
            )
    except OSError:
        return []
    return [folder / name for name in names]


class FuelFile(NamedTuple):
    """A model of Gazebo's Fuel, or a file of it.

    Attributes:
        server: the server's name.
        owner: the owner of the model.
        name: the model's name.
        version: the version as the address states it; empty for the latest.
        path: the path of the file in the model's folder; empty for the model.
    """

    server: str
    owner: str
    name: str
    version: str
    path: str

    def list_paths_in_folder(self, folder: Path) -> Iterator[Path]:
        """Yield the possible paths of the file in a folder of models.

        The model's folder is found whatever the case of its name.

        Args:
            folder: a folder that contains the folders of models.
        """
        for model_folder in _list_equal_names(folder, self.name):
            yield model_folder / self.path

    def list_paths_in_caches(self) -> Iterator[Path]:
        """Yield the possible paths of the file in the caches of Fuel, latest versions first."""
        cache_folders = [
            folder for variable in FUEL_CACHE_PATHS for folder in _folders_of(variable)
        ]
        cache_folders += [Path.home() / cache_folder for cache_folder in FUEL_CACHES]
        servers = dict.fromkeys((self.server.lower(), *FUEL_SERVERS))
        for cache_folder in cache_folders:
            for server in servers:
                models_folder = cache_folder / server / self.owner.lower() / "models"
                for model_folder in _list_equal_names(models_folder, self.name):
                    for version_folder in self._list_versions(model_folder):
                        yield version_folder / self.path

    def _list_versions(self, model_folder: Path) -> list[Path]:
        if self.version.isdecimal():
            return [model_folder / self.version]
        version_folders = [
            folder for folder in _list_subfolders(model_folder) if folder.name.isdecimal()
        ]
        return sorted(version_folders, key=lambda folder: int(folder.name), reverse=True)


def parse_fuel_address(uri: str) -> FuelFile | None:
    """Return the model or the file of Fuel that an address names; None for any other address.

    Args:
        uri: such as ``https://fuel.gazebosim.org/1.0/openrobotics/models/drawer/1/files/a.obj``,
            or the path of a file in a cache of Fuel.
    """
    for pattern in (FUEL_ADDRESS, FUEL_CACHE_FILE):
        address_match = pattern.fullmatch(uri)
        if address_match is not None:
            fields = {key: unquote(value or "") for key, value in address_match.groupdict().items()}
            if "\0" in uri or "%00" in uri:
                return None
            return FuelFile(**{**fields, "path": fields["path"].strip("/")})
    return None


def is_same_model_name(name: str, other_name: str) -> bool:
    """Return whether two names stand for the same model on Fuel.

    Upper and lower case are equal, and so are a blank and ``_``.
    """
    return _normalize(name) == _normalize(other_name)


def _normalize(name: str) -> str:
    return name.lower().replace(" ", "_")


def _list_equal_names(folder: Path, name: str) -> list[Path]:
    """Return the paths in a folder by a model's name: as written, then by any case, sorted."""
    if "/" in name or name in ("", os.curdir, os.pardir):
        return []
    try:
        names = sorted(entry for entry in os.listdir(folder) if is_same_model_name(entry, name))
    except OSError:
        names = []
    return [folder / equal_name for equal_name in dict.fromkeys((name, *names))]
