"""Describes the attributes of cells, as ``metadata.cellAttributes`` does."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.types import Json

Arrays = Mapping[str, NDArray[Any]]


# Other names that the original client has for datatypes; source: sstk's `TypeUtils.js`
ALIASES = {"uint8clamped": "uint8", "uchar": "uint8"}


def datatype_name(stated: str) -> str:
    """Name the datatype of an array type: "uint8" for "Uint8Array" or "uchar"."""
    name = stated.lower().removesuffix("array")
    return ALIASES.get(name, name)


def describe_attributes(metadata: Json, levels: Iterable[Arrays]) -> list[Json]:
    """List ``{"name", "type", "dataType", …}`` of the levels' attributes, in their order.

    An entry of the metadata is kept, except a ``type`` that is not that of the array. Where two
    levels differ in dtype, the first counts.
    """
    entries = metadata.get("cellAttributes")
    stated = {
        entry["name"]: entry
        for entry in (entries if isinstance(entries, list) else [])
        if isinstance(entry, dict) and isinstance(entry.get("name"), str)
    }
    described: dict[str, Json] = {}
    for arrays in levels:
        for name, array in arrays.items():
            described.setdefault(name, _describe(name, array.dtype, stated.get(name, {})))
    return list(described.values())


def _describe(name: str, dtype: np.dtype[Any], stated: Json) -> Json:
    # the array decides; what the file states is kept where it says the same in other words
    kind = stated.get("type")
    if not isinstance(kind, str) or datatype_name(kind) != dtype.name:
        kind = f"{dtype.name.capitalize()}Array"
    data_type = "continuous" if dtype.kind == "f" else "categorical"
    return {"name": name, "type": kind, "dataType": data_type} | stated | {"type": kind}
