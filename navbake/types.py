"""Types of arrays and of JSON by the names that the whole package uses for them."""

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Bool: TypeAlias = NDArray[np.bool_]
Float: TypeAlias = NDArray[np.float64]
Int: TypeAlias = NDArray[np.int64]
Int32: TypeAlias = NDArray[np.int32]  # labels, MuJoCo's ids
JsonValue: TypeAlias = Any  # an object, a list, a string, a number, a bool or None, parsed
Json: TypeAlias = dict[str, JsonValue]  # a JSON object
Vector3: TypeAlias = tuple[float, float, float]
ScalarT = TypeVar("ScalarT", bound=np.generic)
"""The type of the entries of arrays, of a function that takes and returns arrays of any type."""
