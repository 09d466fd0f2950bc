"""Reads and writes whole files: paths, bytes or streams, JSON, YAML, and images by Pillow.

All formats read and write their files by these functions. Errors of the system and of libraries
become FormatErrors with the file's path.
"""

from __future__ import annotations

import bz2
import gzip
import importlib
import io
import logging
import math
import os
import warnings
import zlib
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType
from typing import IO, TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypeAlias, cast

import orjson

from navbake.errors import ConfigError, FormatError, MissingDependencyError
from navbake.files import write_together
from navbake.formats.allowance import (
    BYTES_PER_PIXEL,
    MAX_BYTES,
    MAX_HEADER_BYTES,
    Allowance,
    JsonPath,
    format_value,
)
from navbake.lazy import lazy

if TYPE_CHECKING:
    import numpy as np
    import PIL
    from numpy.typing import NDArray
    from PIL import Image, PngImagePlugin

    from navbake.types import JsonValue
else:  # the command line lists formats before it loads numpy
    np = lazy("numpy")
    PIL = lazy("PIL")
    Image = lazy("PIL.Image")
    PngImagePlugin = lazy("PIL.PngImagePlugin")

Source: TypeAlias = str | os.PathLike[str] | bytes | BinaryIO
"""A path, a file's content, or a file opened in binary mode."""
Files: TypeAlias = dict[Path, bytes]
"""Path -> content of files to be written, in this order."""

LOG = logging.getLogger("navbake")
FIRST_BYTES = 1 << 16  # bytes that are read first, to check how a file begins
CHUNK_BYTES = 16 << 20  # bytes that are read or unpacked at once where the size is not known
INCOMPLETE_HINT = "the file is incomplete: copy it again, or make it anew"
BOM = b"\xef\xbb\xbf"  # byte order mark of UTF-8
GZIP_MAGIC = b"\x1f\x8b"
# first two bytes of a packed file -> name of the packing, and function that opens the file
OPENERS: dict[bytes, tuple[str, Callable[[BinaryIO], IO[bytes]]]] = {
    GZIP_MAGIC: ("gzip", cast("Callable[[BinaryIO], IO[bytes]]", gzip.open)),
    b"BZ": ("bzip2", cast("Callable[[BinaryIO], IO[bytes]]", bz2.open)),
}
LUMA_SHARES = (306, 601, 117)  # of red, green and blue in a pixel's luma, of 1024
IMAGE_BEGINNINGS = {"PPM": (b"P2", b"P5", b"P3", b"P6"), "PNG": (b"\x89PNG",), "BMP": (b"BM",)}
VOXEL_ENDINGS = (".bt", ".ot", ".binvox")
NAVGRID_TEXT = "a NavGrid JSON object"
NAVGRID_REMEDY = (
    "navbake convert makes one of a map or an archive of a grid, navbake bake of a scene; "
    "navbake fly takes voxels"
)


def format_path(path: str | os.PathLike[str]) -> str:
    """Format a path for messages, on one line."""
    name = os.fsdecode(path)
    return name if name.isprintable() else repr(name)


def format_convert_command(path: str | os.PathLike[str]) -> str:
    """Format the command that makes a grid of a file: ``navbake convert map.bt map.grid.json``."""
    return f"navbake convert {format_path(path)} {format_path(f'{Path(path).stem}.grid.json')}"


def check_path(path: object) -> str:
    """Return a path as text.

    Raises:
        FormatError: the value is no path.
    """
    if not isinstance(path, str | os.PathLike):
        raise FormatError(
            f"expected a path, got {describe_type(path)}", value=path, expected="a path"
        )
    return os.fsdecode(path)


def describe_type(value: object) -> str:
    """Describe the type of a wrong value for messages."""
    return "None" if value is None else f"one of Python's type {type(value).__name__}"


def _format_system_error(error: Exception) -> str:
    """Return the operating system's message of an error, without its number."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def read_bytes(
    source: Source,
    *,
    beginnings: bytes | tuple[bytes, ...] = b"",
    expected: str = "",
    remedy: str = "",
) -> tuple[bytes, str]:
    """Read a whole file.

    Args:
        source: a path, the file's content, or the file opened in binary mode.
        beginnings: the first bytes that the file must have, or a tuple of possible ones; b"" for
            any. A file that begins differently is not read further than 64 KiB, as it may be a
            device that never ends.
        expected: a description of the expected file, for errors.
        remedy: what to do about a wrong file, for errors.

    Returns:
        The content, and the file's name for messages.

    Raises:
        FormatError: the file can't be read, begins differently, or has more than 4 GiB.
    """
    path = source if isinstance(source, str | os.PathLike) else None
    stream = source
    name = str(getattr(source, "name", "the stream given"))
    if path is not None:
        name = os.fsdecode(path)
        LOG.debug("reading %s", name)
    elif isinstance(source, bytes | bytearray | memoryview):
        stream = io.BytesIO(source)
        name = "the bytes given"
    elif not callable(getattr(source, "read", None)):
        expected_source = "a path, a file's content or a file opened in binary mode"
        raise FormatError(
            f"expected {expected_source}, got {describe_type(source)}",
            value=source,
            expected=expected_source,
        )
    try:
        if path is not None and os.path.isdir(path):
            raise FormatError(
                f"expected a file, got the folder {format_path(name)}", path=name, expected="a file"
            )
        with nullcontext(cast("BinaryIO", stream)) if path is None else open(path, "rb") as file:
            content = file.read(FIRST_BYTES)
            if not isinstance(content, bytes):
                actual_text = "text" if isinstance(content, str) else describe_type(content)
                JsonPath(name).fail(f"expected a file opened in binary mode, got {actual_text}")
            if not content.startswith(beginnings):
                actual_text = _format_beginning(content)
                JsonPath(name).fail(
                    f"expected {expected}, got {actual_text}", remedy, expected=expected
                )
            # the size of a device or a pipe is 0
            file_size = 0 if path is None else os.fstat(file.fileno()).st_size
            if 0 < file_size <= MAX_BYTES:
                file.seek(0)  # to join chunks takes longer than to read all again
                return file.read(), name
            chunks = [content]
            num_bytes = max(file_size, len(content))
            while num_bytes <= MAX_BYTES and (chunk := file.read(CHUNK_BYTES)):
                chunks.append(chunk)
                num_bytes += len(chunk)
            if num_bytes > MAX_BYTES:
                JsonPath(name).fail(f"more than {MAX_BYTES >> 20} MiB of data")
            return b"".join(chunks), name
    except (OSError, ValueError) as error:  # ValueError: a NUL in a path, or the file is closed
        message = f"cannot read {format_path(name)}: {_format_system_error(error)}"
        raise FormatError(message, path=name) from error


def _format_beginning(text: bytes) -> str:
    """Format the beginning of a text for messages."""
    beginning = text[:FIRST_BYTES].removeprefix(BOM).lstrip(b" \t\r\n")[:8]
    return f"{format_value(beginning)[1:]}…" if beginning else "nothing"


def unpack(content: bytes, name: str) -> bytes:
    """Unpack gzip or bzip2, detected by the content; return other data as they are.

    Args:
        content: the content of a file.
        name: the file's name, for errors.

    Raises:
        FormatError: the packed data are broken, or unpack to more than an `Allowance` of text.
    """
    packing, open_packed = OPENERS.get(content[:2], ("", None))
    if open_packed is None:
        return content
    allowance = Allowance(len(content), "max_cells")
    chunks = []
    try:
        with open_packed(io.BytesIO(content)) as unpacked_file:
            while chunk := unpacked_file.read(CHUNK_BYTES):
                allowance.take_text(len(chunk), JsonPath(name))
                chunks.append(chunk)
    except (EOFError, OSError, zlib.error) as error:
        message = f"broken {packing} data in {name}: {_format_system_error(error)}"
        hint = INCOMPLETE_HINT if isinstance(error, EOFError) else None
        raise FormatError(
            f"{message}; {hint}" if hint else message, path=name, hint=hint
        ) from error
    return b"".join(chunks)


def read_navgrid_text(source: Source) -> tuple[bytes, int, JsonPath]:
    """Read the JSON of a grid's file, plain or gzipped (detected by its content).

    Args:
        source: a path, the file's content, or the file opened in binary mode.

    Returns:
        The text without a byte order mark, the file's size before unpacking [bytes], and the
        location of the whole file, for errors.

    Raises:
        FormatError: the file can't be read, or is no JSON object.
    """
    beginnings = (b"{", GZIP_MAGIC, BOM, b" ", b"\t", b"\r", b"\n")
    remedy = NAVGRID_REMEDY
    path = str(source) if isinstance(source, str | os.PathLike) else ""
    if path.lower().endswith((".yaml", ".yml")):
        remedy = (
            f"of settings, `navbake bake {format_path(path)}` makes one, of a map of nav2, "
            f"`{format_convert_command(path)}`"
        )
    elif path.lower().endswith(VOXEL_ENDINGS):
        remedy = (
            f"of voxels, `{format_convert_command(path)} --height 0.1:1.2` makes one, and "
            f"`navbake fly {format_path(path)}` takes them as they are"
        )
    text, name = read_bytes(source, beginnings=beginnings, expected=NAVGRID_TEXT, remedy=remedy)
    num_bytes = len(text)
    root_place = JsonPath(name)
    text = unpack(text, name).removeprefix(BOM)
    if _format_beginning(text)[1:2] != "{":
        root_place.fail(f"expected {NAVGRID_TEXT}, got {_format_beginning(text)}", remedy)
    return text, num_bytes, root_place


def parse_json(content: bytes | memoryview, place: JsonPath) -> JsonValue:
    """Parse JSON.

    Args:
        content: the text, UTF-8.
        place: its location, for errors.

    Returns:
        The value.

    Raises:
        FormatError: the text is no JSON; the error names line and column.
    """
    try:
        return orjson.loads(content)
    except orjson.JSONDecodeError as error:
        text_at_fault = error.doc[error.pos : error.pos + 9].lstrip("-")
        is_constant = text_at_fault[:3] in ("NaN", "Inf")
        hint = "NaN and Infinity are no JSON, write null" if is_constant else None
        # orjson gives no text of what is not UTF-8
        if error.doc and error.pos >= len(error.doc):
            hint = INCOMPLETE_HINT
        file = f"`{place.path}` of {place.file}" if place.path else place.file
        place_text = f"line {error.lineno}, column {error.colno}"
        message = f"broken JSON in {file}, {place_text}: {error.msg}"
        raise FormatError(
            f"{message}; {hint}" if hint else message, path=place.file, place=place_text, hint=hint
        ) from error


def read_json(path: str | os.PathLike[str], *, expected: str) -> tuple[JsonValue, str]:
    """Read a JSON file.

    Args:
        path: the file.
        expected: a description of the expected file, for errors.

    Returns:
        The parsed value, and the file's name for messages.

    Raises:
        FormatError: the file can't be read, or is no JSON.
    """
    content, name = read_bytes(path)
    try:
        return parse_json(content.removeprefix(BOM), JsonPath(format_path(name))), name
    except FormatError as error:
        message = f"expected {expected}: {error}"
        raise FormatError(
            message, path=name, expected=expected, place=error.place, hint=error.hint
        ) from error


def read_yaml_source(path: str | os.PathLike[str], *, expected: str) -> tuple[JsonValue, str]:
    """Read a YAML file.

    Args:
        path: the file.
        expected: a description of the expected file, for errors.

    Returns:
        The parsed value, and the file's name for messages.

    Raises:
        FormatError: the file can't be read, or is no YAML.
    """
    from navbake.yaml_text import decode_yaml  # PyYAML loads slowly

    content, name = read_bytes(path)
    try:
        return decode_yaml(content, format_path(name)), name
    except ConfigError as error:
        message = f"expected {expected}: {error}"
        raise FormatError(
            message, path=name, expected=expected, place=error.place, hint=error.hint
        ) from error


# ---------------------------------------------------------------- images


class Pixels(NamedTuple):
    """The pixels of an image, row 0 at the top.

    Attributes:
        channel_sum: the sum of red, green and blue, shape (height, width), uint16 or uint32.
        max_channel: the largest value of each channel, 255 or 65535.
        opacity: the opacity of each pixel, 0 to 255, shape (height, width), uint8; None if the
            image has none.
        luma: luma by Rec. 601, 0 to 255, shape (height, width), uint8. It equals
            the luma of GraphicsMagick with quanta of 16 bits.
    """

    channel_sum: NDArray[Any]
    max_channel: int
    opacity: NDArray[np.uint8] | None
    luma: NDArray[np.uint8]


def open_image(
    source: str | os.PathLike[str], kinds: tuple[str, ...] = tuple(IMAGE_BEGINNINGS)
) -> Image.Image:
    """Load an image.

    Args:
        source: the file.
        kinds: the kinds that the image may have: ``PPM`` (includes PGM), ``PNG`` and ``BMP``.

    Returns:
        The image with its pixels loaded; ``info`` holds its texts.

    Raises:
        FormatError: the file can't be read, is of another kind, broken or too large.
    """
    beginnings = tuple(beginning for kind in kinds for beginning in IMAGE_BEGINNINGS[kind])
    kind_names = " or ".join("PGM" if kind == "PPM" else kind for kind in kinds)
    content, name = read_bytes(source, beginnings=beginnings, expected=f"a {kind_names} image")
    allowance = Allowance(len(content))
    place = JsonPath(name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the pixels are counted here
            image = Image.open(io.BytesIO(content), formats=kinds)
            allowance.take_cells(image.size, place)
            allowance.take_array(image.size, BYTES_PER_PIXEL, place)
            image.load()
            return image
    except FormatError:
        raise
    except Exception as error:  # Pillow and zlib raise many types for a broken image
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        if isinstance(error, PIL.UnidentifiedImageError):  # its text has an address in memory
            reason = "its header is broken"
        message = f"{format_path(name)} is no image that can be read: {reason}"
        raise FormatError(message, path=name) from error


def read_pixels(source: str | os.PathLike[str]) -> Pixels:
    """Read the pixels of a PGM, PNG or BMP of any depth.

    Raises:
        FormatError: the file can't be read, is no PGM, PNG or BMP, broken or too large.
    """
    image = open_image(source)
    if image.mode in ("I", "I;16", "I;16B", "I;16L"):
        grey = np.asarray(image).astype(np.uint32)
        return Pixels(3 * grey, 65535, None, (grey // 257).astype(np.uint8))
    has_opacity = "A" in image.getbands() or "transparency" in image.info
    if not has_opacity and image.mode in ("1", "L"):
        luma = np.asarray(image.convert("L"))
        return Pixels(3 * luma.astype(np.uint16), 255, None, luma)
    channels = np.asarray(image.convert("RGBA" if has_opacity else "RGB"))
    channel_sum = channels[..., :3].sum(axis=2, dtype=np.uint16)
    luma = (channels[..., :3] @ np.array(LUMA_SHARES, dtype=np.uint32) >> 10).astype(np.uint8)
    return Pixels(channel_sum, 255, channels[..., 3] if has_opacity else None, luma)


def encode_image(pixels: NDArray[np.uint8], kind: str, **texts: str) -> bytes:
    """Encode pixels as an image file.

    Args:
        pixels: grey values, shape (height, width), or channels, shape (height, width, 3 or 4);
            row 0 is the top.
        kind: ``PNG``, or ``PPM`` for a binary PGM of grey values.
        texts: keyword -> text, for the text chunks of a PNG.

    Returns:
        The content of the file.
    """
    text_chunks = PngImagePlugin.PngInfo()
    for keyword, text in texts.items():
        text_chunks.add_text(keyword, text)
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, kind, pnginfo=text_chunks)
    return file.getvalue()


def read_header(
    data: bytes,
    source: str,
    number_types: Mapping[str, tuple[int, type]],
    defaults: Mapping[str, list[str]] | None = None,
) -> tuple[dict[str, list[str]], list[list[JsonValue]], int]:
    """Read the header of a binvox or OctoMap file: lines of a name and values, up to ``data``.

    Args:
        data: the content of the file.
        source: the file's name, for errors.
        number_types: name of a line whose values must be numbers -> how many, and their type (int
            or float).
        defaults: name of a line that may be missing -> the values that it has then, as text.

    Returns:
        Three results: name of each line -> its values as text, where a comment's name begins with
        ``#``; for each entry of `number_types`, the line's numbers; and the offset of the data
        after the header [bytes].

    Raises:
        FormatError: a line is missing, or its numbers are not those that are expected.
    """
    lines = dict(defaults or {})
    line_start = 0
    while "data" not in lines:
        line_stop = data.find(b"\n", line_start, MAX_HEADER_BYTES)
        if line_stop < 0:
            raise FormatError(f"no line `data` ends the header of {source}", path=source)
        first_word, *words = data[line_start:line_stop].decode(
            "ascii", errors="replace"
        ).split() or [""]
        lines[first_word] = words
        line_start = line_stop + 1
    numbers_of_lines = []
    for name, (count, number_type) in number_types.items():
        if name not in lines:
            message = f"no line `{name}` in the header of {source}"
            raise FormatError(message, path=source, key=name)
        try:
            values = [number_type(word) for word in lines[name]]
            is_valid = len(values) == count and all(map(math.isfinite, values))
        except (ValueError, OverflowError):  # OverflowError: a whole number beyond all floats
            is_valid = False
        if not is_valid:
            noun = "whole number" if number_type is int else "number"
            expected = f"{count} {noun}" if count == 1 else f"{count} {noun}s"
            place_text = f"at `{name}` in the header of {source}"
            text = " ".join(lines[name])[:60]
            raise FormatError(
                f"expected {expected} {place_text}, got {text!r}",
                path=source,
                key=name,
                value=text,
                expected=expected,
            )
        numbers_of_lines.append(values)
    return lines, numbers_of_lines, line_start


# ---------------------------------------------------------------- writing


def check_name_encoding(path: Path) -> None:
    """Check that a file's name is valid UTF-8, because another file is to refer to it by this name.

    Raises:
        FormatError: the name isn't UTF-8.
    """
    if path.name != os.fsencode(path.name).decode(errors="replace"):
        raise FormatError(
            f"expected a name in UTF-8, which another file can hold, got {path}",
            path=str(path),
            expected="a name in UTF-8",
        )


def write_bytes(data: bytes, path: str | os.PathLike[str]) -> None:
    """Write a file as a whole or not at all.

    Args:
        data: the content.
        path: the file.

    Raises:
        FormatError: the file can't be written.
    """
    write_files({Path(check_path(path)): data})


def write_files(files: Files) -> list[Path]:
    """Write files that belong together, all or none.

    Args:
        files: the content of each file by its path.

    Returns:
        The paths, in their order.

    Raises:
        FormatError: a file can't be written.
    """
    try:
        write_together(files)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        reason = _format_system_error(error)
        if isinstance(error, FileNotFoundError):
            folders = {os.path.dirname(os.path.realpath(path)) for path in files}
            missing_folders = sorted(folder for folder in folders if not os.path.isdir(folder))
            reason = (
                f"there is no folder {format_path(missing_folders[0])}"
                if missing_folders
                else reason
            )
        message = f"cannot write {' and '.join(map(format_path, files))}: {reason}"
        raise FormatError(message, path=str(next(iter(files), ""))) from error
    return list(files)


def import_extra(name: str, extra: str = "convert", feature: str = "this") -> ModuleType:
    """Import a module of an optional library.

    Args:
        name: the module's dotted name.
        extra: the extra of navbake that installs it.
        feature: what needs the library, such as ``MCAP``; the beginning of the error.

    Returns:
        The module.

    Raises:
        MissingDependencyError: the library is not installed; the message has the command for it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        message = f'{feature} needs {name.partition(".")[0]}: pip install "navbake[{extra}]"'
        raise MissingDependencyError(message) from error
