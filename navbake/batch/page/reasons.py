"""Groups texts that say the same of different things: failures, warnings, remarks."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

NAME, NUMBER = "…", "#"  # what stands for a name and for a number
KEPT = re.compile(r"(`[^`]*`)")  # settings: they say what is wrong
QUOTED = re.compile(r"""(?<!\w)'[^']*'(?!\w)|(?<!\w)"[^"]*"(?!\w)""")
WORD = re.compile(r"[^\s`'\"(),;:=<>\[\]{}]+")
FILE = re.compile(
    r"(?i)\.(xml|mjcf|urdf|mjb|ya?ml|json|jsonl|gz|obj|stl|ply|glb|gltf|dae|msh|skn|png|hdr|bin|npz"
    r"|txt|csv)$"
)
THOUSANDS = re.compile(r"(?<=\d),(?=\d{3}(?!\d))")  # commas within a number
# with a unit: 5cm, 30%
NUMERIC = re.compile(r"[-+±]?(\d+(\.\d+)*|\.\d+)([eE][-+]?\d+)?[a-zA-Z%²³°]{0,3}")


class Reasons(NamedTuple):
    """Distinct texts, and the groups that they fall into.

    Attributes:
        texts: each once, in the order of their first use; with how a scene failed, for failures.
        group: which group each is in.
        groups: what the texts of each have in common, see `fold`, likewise with how; the whole
            text where there is only one.
    """

    texts: list[tuple[str, str]]
    group: list[int]
    groups: list[tuple[str, str]]


class Grouping:
    """Numbers texts as they come, and groups them."""

    def __init__(self) -> None:
        self._texts: dict[tuple[str, str], int] = {}
        self._group: list[int] = []
        self._groups: dict[tuple[str, str], int] = {}

    def number(self, text: str, how: str = "") -> int:
        """The number of a text, which gets one if it is new."""
        number = _number(self._texts, (how, text))
        if number == len(self._group):
            self._group.append(_number(self._groups, (how, fold(text))))
        return number

    def numbers(self, texts: Iterable[str]) -> list[int]:
        """The numbers of several."""
        return [self.number(text) for text in texts]

    @property
    def reasons(self) -> Reasons:
        """What came so far."""
        texts = [*self._texts]
        members: list[list[tuple[str, str]]] = [[] for _ in self._groups]
        for text, group in zip(texts, self._group, strict=True):
            members[group].append(text)
        groups = [
            own[0] if len(own) == 1 else folded
            for own, folded in zip(members, self._groups, strict=True)
        ]
        return Reasons(texts, self._group, groups)


def _number(known: dict[tuple[str, str], int], key: tuple[str, str]) -> int:
    return known.setdefault(key, len(known))


def fold(text: str) -> str:
    """A text without what differs from scene to scene, so that alike ones are the same.

    What is quoted, paths, names of files and words with digits in them become ``…``, numbers
    become ``#``. What stands between backticks is a setting and stays.
    """
    parts = KEPT.split(text)
    parts[::2] = [_fold_words(THOUSANDS.sub("", QUOTED.sub(NAME, part))) for part in parts[::2]]
    return "".join(parts)


def _fold_words(text: str) -> str:
    return WORD.sub(_fold_word, text)


def _fold_word(match: re.Match[str]) -> str:
    word = match.group()
    core = word.rstrip(".!?")
    if "/" in core or "\\" in core or FILE.search(core):
        folded = NAME
    elif NUMERIC.fullmatch(core):
        folded = NUMBER
    else:
        folded = NAME if any(letter.isdecimal() for letter in core) else core
    return folded + word[len(core) :]
