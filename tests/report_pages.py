"""Reads what a report's page holds, by Python: the script of the page has its own reader."""

from __future__ import annotations

import hashlib
import io
import json
import re
import zlib
from base64 import b64decode

import numpy as np
from PIL import Image

CONTENT = re.compile(rb'<script type="application/json" id="content">(.*?)</script>', re.DOTALL)


def content_of(page):
    """What a page shows."""
    [found] = CONTENT.findall(page)
    return json.loads(found)


def content_of_batch(path):
    """What the page of a batch shows."""
    with open(path, "rb") as file:
        return content_of_page(file.read())


def content_of_page(page):
    """What the page of a batch shows, from its content."""
    return json.loads(text_of(content_of(page)["packed"]))


def check_policy(page):
    """See that its own style and script alone may run; the rules of its Content-Security-Policy."""
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    for name in ("style", "script"):
        [text] = re.findall(f"<{name}>(.*?)</{name}>", page, re.DOTALL)
        digest = b64decode(rules[f"{name}-src"].strip("'").removeprefix("sha256-"))
        assert digest == hashlib.sha256(text.encode()).digest()
    return rules


def text_of(packed):
    """Undo `pack`, but for the JSON."""
    return zlib.decompress(b64decode(packed))


def unpack(level, shape):
    """The lists of names and the arrays of a level's cells, NaN for none."""
    content = json.loads(text_of(level["cells"]))
    lists = content.pop("nameLists", [])
    arrays = {key: np.array(values, float).reshape(shape) for key, values in content.items()}
    return lists, arrays


def picture_of(layer):
    """A layer's picture, shape (rows, cols, 3), uint8."""
    data = layer["png"].removeprefix("data:image/png;base64,")
    return np.asarray(Image.open(io.BytesIO(b64decode(data))).convert("RGB"))
