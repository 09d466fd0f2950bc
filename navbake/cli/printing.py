"""What commands print: results on stdout, warnings and errors on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from typing import Any


def print_json(value: Any) -> None:
    """Print a value as JSON; NaN and infinity are refused, as JSON has neither."""
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False))


def print_error(message: str) -> None:
    """Print one line on stderr."""
    print(f"navbake: {message}", file=sys.stderr)


def print_warnings(warnings: Iterable[str]) -> None:
    """Print warnings on stderr, one a line."""
    for warning in warnings:
        print_error(f"warning: {warning}")
