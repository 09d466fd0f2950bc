"""Images of maps, read and written by Pillow: one for each level."""

from __future__ import annotations

import io
import warnings
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from navbake.errors import FormatError
from navbake.formats.allowance import PIXEL_COST, Allowance, JsonPath
from navbake.formats.source import path_name, read_bytes

LUMA = (306, 601, 117)  # of 1024: shares of red, green and blue
BEGINNINGS = {"PPM": (b"P2", b"P5", b"P3", b"P6"), "PNG": (b"\x89PNG",), "BMP": (b"BM",)}


class Pixels(NamedTuple):
    """The pixels of an image, row 0 at the top."""

    light: NDArray[Any]  #: Sum of red, green and blue, shape (height, width), uint16 or uint32.
    white: int  #: The largest value of each, 255 or 65535.
    #: 0 to 255, shape (height, width), uint8; None if the image has none.
    opacity: NDArray[np.uint8] | None
    #: Luma by Rec. 601, 0 to 255, shape (height, width), uint8, as GraphicsMagick computes it with
    #: quanta of 16 bits.
    luma: NDArray[np.uint8]


def open_image(source: str | PathLike[str], kinds: tuple[str, ...] = tuple(BEGINNINGS)) -> Any:
    """Load an image of one of some kinds: ``PPM`` (includes PGM), ``PNG`` and ``BMP``."""
    begins = tuple(start for kind in kinds for start in BEGINNINGS[kind])
    names = " or ".join("PGM" if kind == "PPM" else kind for kind in kinds)
    data, name = read_bytes(source, begins=begins, expected=f"a {names} image")
    allowance, place = Allowance(len(data)), JsonPath(name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the pixels are counted here
            image = Image.open(io.BytesIO(data), formats=kinds)
            allowance.take_cells(image.size, place)
            allowance.take_array(image.size, PIXEL_COST, place)
            image.load()
            return image
    except FormatError:
        raise
    except Exception as error:  # Pillow and zlib raise many types for a broken image
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"{path_name(name)} is no image that can be read: {why}") from error


def read_pixels(source: str | PathLike[str]) -> Pixels:
    """Read the pixels of a PGM, PNG or BMP of any depth; see `open_image`."""
    image = open_image(source)
    if image.mode in ("I", "I;16", "I;16B", "I;16L"):
        grey = np.asarray(image).astype(np.uint32)
        return Pixels(3 * grey, 65535, None, (grey // 257).astype(np.uint8))
    has_opacity = "A" in image.getbands() or "transparency" in image.info
    if not has_opacity and image.mode in ("1", "L"):
        luma = np.asarray(image.convert("L"))
        return Pixels(3 * luma.astype(np.uint16), 255, None, luma)
    channels = np.asarray(image.convert("RGBA" if has_opacity else "RGB"))
    light = channels[..., :3].sum(axis=2, dtype=np.uint16)
    luma = (channels[..., :3] @ np.array(LUMA, dtype=np.uint32) >> 10).astype(np.uint8)
    return Pixels(light, 255, channels[..., 3] if has_opacity else None, luma)


def encode_image(pixels: NDArray[np.uint8], kind: str, **texts: str) -> bytes:
    """Encode pixels, (height, width) or (height, width, 3 or 4), as ``PNG`` with texts by keyword.

    Or a binary PGM (``PPM`` to Pillow) of grey values, (height, width). Row 0 is the top.
    """
    notes = PngImagePlugin.PngInfo()
    for keyword, text in texts.items():
        notes.add_text(keyword, text)
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, kind, pnginfo=notes)
    return file.getvalue()
