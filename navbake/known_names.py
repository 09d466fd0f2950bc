"""What errors and warnings say of names: the nearest known one, and which ones there are."""

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

MAX_LISTED = 12
NEAR = 0.85  # share of characters that two long names have in common


def find_near(name: object, known: Iterable[str], most: int = 1) -> list[str]:
    """The known names that were probably meant, the nearest first; often none.

    Near is what differs by one slip of the finger (a character too many, too few, a wrong one, or
    two swapped), in long names by more; and what has all the words of the name and others, as
    ``cell_size`` has ``size``. Capitals don't count.
    """
    by_folded = {other.casefold(): other for other in reversed(list(dict.fromkeys(known)))}
    folded = str(name).casefold()
    typos = get_close_matches(folded, by_folded, n=most, cutoff=NEAR)
    typos += [other for other in by_folded if _is_one_slip(folded, other)]
    words = _words(folded)
    longer = sorted((o for o in by_folded if words and words <= _words(o)), key=len)
    return [by_folded[other] for other in dict.fromkeys([*typos, *longer])][:most]


def suggest(name: object, known: Iterable[str], limit: int = MAX_LISTED, owner: str = "it") -> str:
    """The nearest of the known names, if one is near, and the first `limit` that the owner has."""
    names = list(dict.fromkeys(known))
    folded = str(name).casefold()
    near = find_near(name, names) or [n for n in names if _is_two_slips(folded, n.casefold())]
    hint = f"did you mean {near[0]!r}? " if near else ""
    more = f", and {len(names) - limit} more" if len(names) > limit else ""
    return f"{hint}{owner} has {', '.join(names[:limit]) or 'none'}{more}"


def list_first(names: Sequence[str], most: int = 1) -> str:
    """The first names, and how many more there are, as in ``a, b and 3 more``."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _is_one_slip(name: str, other: str) -> bool:
    """Whether one edit makes one of the other; not of names as short as two characters."""
    if min(len(name), len(other)) < 3 or abs(len(name) - len(other)) > 1:
        return False
    same = 0
    while same < min(len(name), len(other)) and name[same] == other[same]:
        same += 1
    a = name[same:]
    b = other[same:]
    return a[1:] == b[1:] or a[1:] == b or a == b[1:] or (a[:2] == b[1::-1] and a[2:] == b[2:])


def _is_two_slips(name: str, other: str) -> bool:
    """Whether one of the names without a character is one edit from the other; of four or more."""
    return min(len(name), len(other)) >= 4 and any(
        _is_one_slip(a[:k] + a[k + 1 :], b)
        for a, b in ((name, other), (other, name))
        for k in range(len(a))
    )


def _words(name: str) -> set[str]:
    """The words of a name, in the singular."""
    words = re.findall(r"[^\W_]+", name)
    return {f"{w[:-3]}y" if w.endswith("ies") else w.removesuffix("s") for w in words}


def unique_name(name: str, taken: set[str]) -> str:
    """The name, numbered from 2 where it is taken, as in ``wall#2``; taken from now on."""
    candidate = name
    count = 1
    while candidate in taken:
        count += 1
        candidate = f"{name}#{count}"
    taken.add(candidate)
    return candidate
