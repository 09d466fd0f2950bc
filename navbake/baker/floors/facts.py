"""What was found out about sheets, kept as long as the sheets and what is near them stay."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Int


class SheetFacts:
    """Facts about single sheets that are dear to find.

    A fact holds as long as its sheet has the same surfaces, and nothing that it rests on changed:
    `begin` is told when something last did, by sheet.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[str, int], tuple[int, Any]] = {}
        self._kept: dict[tuple[str, int], tuple[int, Any]] = {}
        self._now = 0

    def begin(self, digest: NDArray[np.uint64], now: int) -> None:
        """Begin an update; facts that were not asked for in the last one are forgotten.

        Args:
            digest: of each sheet, see `Sheets`.
            now: the number of the update.
        """
        self._kept, self._known = self._known, {}
        self._digests, self._now = digest.tolist(), now

    def of(
        self, name: str, chosen: Bool, changed: Int, find: Callable[[Bool], list[Any]]
    ) -> list[Any]:
        """A fact about each chosen sheet, in their order.

        Args:
            name: of the fact.
            chosen: the sheets, shape (sheets,), bool.
            changed: the update in which what the fact rests on last changed, by sheet.
            find: finds the fact about some sheets, in their order.
        """
        asked, sheets = np.zeros_like(chosen), np.flatnonzero(chosen).tolist()
        for sheet in sheets:
            known = self._kept.get((name, self._digests[sheet]))
            if known is None or known[0] < changed[sheet]:
                asked[sheet] = True
            else:
                self._known[name, self._digests[sheet]] = known
        if asked.any():
            for sheet, fact in zip(np.flatnonzero(asked).tolist(), find(asked), strict=True):
                self._known[name, self._digests[sheet]] = self._now, fact
        return [self._known[name, self._digests[sheet]][1] for sheet in sheets]

    def mask(self, name: str, chosen: Bool, changed: Int, find: Callable[[Bool], Bool]) -> Bool:
        """Which of the chosen sheets a fact is true of, as `find` returns it, shape (sheets,)."""
        result = np.zeros_like(chosen)
        result[chosen] = self.of(name, chosen, changed, lambda asked: find(asked)[asked].tolist())
        return result
