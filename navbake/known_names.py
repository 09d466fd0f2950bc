"""What an error about an unknown name adds: the nearest known name, and which ones there are."""

import re
from collections.abc import Iterable
from difflib import get_close_matches

MAX_LISTED = 12
# Share of characters in common, twice over the sum of both lengths. 0.75 takes in one wrong, one
# missing or two swapped characters of a short name, and keeps `step` apart from `state` (0.67).
NEAR = 0.75


def find_near(name: object, known: Iterable[str], most: int = 1) -> list[str]:
    """The known names that were probably meant, the nearest first; often none.

    Near is what differs by a slip of the finger, or has all the words of the name (``size`` of
    ``cell_size``). Capitals don't count.
    """
    by_folded = {other.casefold(): other for other in reversed(list(dict.fromkeys(known)))}
    folded = str(name).casefold()
    typos = get_close_matches(folded, by_folded, n=most, cutoff=NEAR)
    words = _words(folded)
    longer = sorted((o for o in by_folded if words and words <= _words(o)), key=len)
    return [by_folded[other] for other in dict.fromkeys([*typos, *longer])][:most]


def suggest(name: object, known: Iterable[str], limit: int = MAX_LISTED) -> str:
    """The nearest of the known names, if one is near, and the first `limit` of them all."""
    names = list(dict.fromkeys(known))
    near = find_near(name, names)
    hint = f"did you mean {near[0]!r}? " if near else ""
    more = f", and {len(names) - limit} more" if len(names) > limit else ""
    return f"{hint}it has {', '.join(names[:limit]) or 'none'}{more}"


def _words(name: str) -> set[str]:
    return set(re.findall(r"[^\W_]+", name))
