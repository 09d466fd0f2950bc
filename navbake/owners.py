"""Who else may change a file or a folder: another user than this one and root.

What such a user puts there must not run as this user. Where a system can't tell owners (Windows),
nobody else is found.
"""

from __future__ import annotations

import os
import stat
from functools import cache
from pathlib import Path

ROOT_ID = 0  # the user ID of root
WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
SEARCHABLE_BY_OTHERS = stat.S_IXGRP | stat.S_IXOTH


def find_other_writer(path: str | os.PathLike[str]) -> str:
    """Say which other user may replace a file or folder, or write into it.

    A folder above it lets others replace it if they may write there, unless that folder is sticky,
    as ``/tmp`` is: there, they can't replace what isn't theirs.

    Args:
        path: The file or folder, absolute, with all links resolved; it need not exist. A link on
            it is reported, since it may have been put there after the path was resolved.

    Returns:
        What lets another user in, such as ``/tmp/kernels belongs to bob``; "" if nothing does.
    """
    if not hasattr(os, "geteuid"):  # Windows
        return ""
    for folder in (Path(path), *Path(path).parents):
        try:
            status = folder.lstat()
        except OSError:  # nothing is there, or this user can't look
            continue
        if stat.S_ISLNK(status.st_mode):
            return f"{folder} is a link"
        if problem := _describe_writer(str(folder), status, is_above=folder != Path(path)):
            return problem
    return ""


def find_other_writer_inside(folder: Path, depth: int) -> str:
    """Say which other user owns a folder or what lies in it, or may write there.

    The folders above it are not looked at: `find_other_writer` does that. But if other users can't
    enter the folder right above, they can't open what lies below. Then only owners count, and it is
    no fault that a group has the permission to write.

    Args:
        folder: The folder; it need not exist.
        depth: How many levels of folders to look into, at least 1.

    Returns:
        What lets another user in, such as ``/tmp/kernels belongs to bob``; "" if nothing does.
    """
    if not hasattr(os, "geteuid"):  # Windows
        return ""
    try:
        is_closed = not os.stat(folder.parent).st_mode & SEARCHABLE_BY_OTHERS
    except OSError:
        return ""
    return _describe_writer_inside(str(folder), depth, is_closed)


def _describe_writer_inside(path: str, depth: int, is_closed: bool) -> str:
    """As `find_other_writer_inside`; `is_closed` means that no other user can open the path."""
    try:
        status = os.lstat(path)
    except OSError:  # nothing is there
        return ""
    if stat.S_ISLNK(status.st_mode):
        # a link to another link is reported: that one may be changed by its owner
        problem = find_other_writer(os.path.join(os.path.dirname(path), os.readlink(path)))
    else:
        problem = _describe_writer(path, status, is_closed=is_closed)
    if problem or depth == 0:
        return problem
    try:
        names = os.listdir(path)
    except OSError:  # it is a file
        return ""
    for name in names:
        if problem := _describe_writer_inside(f"{path}/{name}", depth - 1, is_closed):
            return problem
    return ""


def _describe_writer(
    path: str, status: os.stat_result, *, is_above: bool = False, is_closed: bool = False
) -> str:
    """Say which other user may write a file or into a folder; "" if none.

    Args:
        path: The file or folder, which is no link.
        status: Its status.
        is_above: Whether it is a folder above the one in question; then it may be sticky.
        is_closed: Whether no other user can open it, whatever its own mode allows.
    """
    owner_id = status.st_uid
    if owner_id not in (ROOT_ID, os.geteuid()) and owner_id != _find_unmapped_user_id():
        return f"{path} belongs to {_name_user(owner_id)}"
    write_bits = status.st_mode & WRITABLE_BY_OTHERS
    if is_closed or not write_bits or (is_above and status.st_mode & stat.S_ISVTX):
        return ""
    if write_bits & stat.S_IWOTH:
        return f"all users may write {path}"
    if owner_id != ROOT_ID and _is_group_of(status.st_gid, owner_id):
        return ""
    return f"the group of {path} may write it"


@cache
def _is_group_of(group_id: int, user_id: int) -> bool:
    """Whether a group is the one that many systems make for each user: its only member is the user.

    With such groups, files are made so that their group may write them. Root's group is none:
    users of containers are often in it.
    """
    import grp  # not on Windows
    import pwd  # not on Windows

    try:
        user = pwd.getpwuid(user_id)
        group = grp.getgrgid(group_id)
    except KeyError:  # a container need not have names
        return False
    has_name = group.gr_name == user.pw_name and user.pw_gid == group_id
    return has_name and {*group.gr_mem} <= {user.pw_name}


@cache
def _find_unmapped_user_id() -> int | None:
    """Return the user ID that a container without root's rights shows for all unknown owners.

    There, the files of root, of the container's image, too, have this owner. None elsewhere.
    Source: the man page user_namespaces(7), "Unmapped user and group IDs".
    """
    try:
        unmapped_id = int(Path("/proc/sys/kernel/overflowuid").read_text())
        map_lines = Path("/proc/self/uid_map").read_text().splitlines()
        for line in map_lines:
            first_id, _, num_ids = map(int, line.split())
            if first_id <= unmapped_id < first_id + num_ids:
                return None
    except (OSError, ValueError):  # not Linux
        return None
    return unmapped_id


def _name_user(user_id: int) -> str:
    """Return a user's name, or the number if the user has no name here."""
    import pwd  # not on Windows

    try:
        return pwd.getpwuid(user_id).pw_name
    except KeyError:
        return f"user {user_id}"
