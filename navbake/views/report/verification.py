"""Reads what `navbake verify --json` printed."""

import os
from typing import Any

from navbake.errors import FormatError
from navbake.formats.json_path import shown
from navbake.formats.source import read_object
from navbake.types import Json

MAX_BYTES = 64 << 20
PRINTED = "what `navbake verify --json` prints"
WHOLE = {"ok": bool, "checked": int, "cells": int, "findings": list}
FINDING = {"kind": str, "level": int, "position": list, "text": str}


def read_verification(path: str | os.PathLike[str]) -> Json:
    """Read a verification's JSON, see `navbake.verifier.report.VerifyReport.to_json`.

    Raises:
        FormatError: it is none, or can't be read.
    """
    report, name = read_object(path, expected=PRINTED, limit=MAX_BYTES)
    _check(report, WHOLE, "", name)
    for number, finding in enumerate(report["findings"]):
        _check(finding, FINDING, f"findings[{number}].", name)
        position = finding["position"]
        if len(position) != 3 or not all(type(v) in (int, float) for v in position):
            raise FormatError(f"expected [x, y, z] at `findings[{number}].position` in {name}")
    checked: Json = report
    return checked


def _check(value: Any, kinds: dict[str, type], where: str, name: str) -> None:
    if not isinstance(value, dict):
        raise FormatError(f"expected {PRINTED} in {name}, got {shown(value)}")
    for key, kind in kinds.items():
        if type(value.get(key)) is not kind:
            raise FormatError(
                f"expected {kind.__name__} at `{where}{key}` in {name}, got {shown(value.get(key))}"
            )
