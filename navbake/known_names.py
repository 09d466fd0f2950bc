"""Suggestions of names for errors and warnings: the nearest known name, and which there are."""

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

MAX_LISTED = 12
CLOSE_MATCH = 0.85  # share of characters that two long names have in common


def find_near(name: object, candidates: Iterable[str], most: int = 1) -> list[str]:
    """Return the candidates that were probably meant; often none.

    Near is a name that differs by one edit (a character too many, too few, a wrong one, or two
    swapped), in long names by more; and a name that has all the words of the name and others, as
    ``cell_size`` has ``size``. Capitals don't count.

    Args:
        name: The name that is not known.
        candidates: The known names.
        most: How many to return at most.

    Returns:
        The names, the nearest first.
    """
    # reversed, so that of names that differ in capitals alone the first one counts
    names = reversed(list(dict.fromkeys(candidates)))
    by_folded = {candidate.casefold(): candidate for candidate in names}
    folded = str(name).casefold()
    close = get_close_matches(folded, by_folded, n=most, cutoff=CLOSE_MATCH)
    close += [candidate for candidate in by_folded if _is_one_edit(folded, candidate)]
    words = _words(folded)
    with_all_words = [candidate for candidate in by_folded if words and words <= _words(candidate)]
    with_all_words.sort(key=len)
    nearest = dict.fromkeys([*close, *with_all_words])  # each once, in this order
    return [by_folded[candidate] for candidate in nearest][:most]


def suggest(
    name: object, candidates: Iterable[str], limit: int = MAX_LISTED, owner: str = "it"
) -> str:
    """Write a suggestion for a name that is not known, as ``did you mean 'hall'? it has hall``.

    Args:
        name: The name that is not known.
        candidates: The known names.
        limit: How many of them to list.
        owner: What has the known names.
    """
    names = list(dict.fromkeys(candidates))
    folded = str(name).casefold()
    near = find_near(name, names)
    if not near:
        near = [candidate for candidate in names if _is_two_edits(folded, candidate.casefold())]
    question = f"did you mean {near[0]!r}? " if near else ""
    more = f", and {len(names) - limit} more" if len(names) > limit else ""
    return f"{question}{owner} has {', '.join(names[:limit]) or 'none'}{more}"


def list_first(names: Sequence[str], most: int = 1) -> str:
    """List the first names, and count the others, as in ``a, b and 3 more``.

    Args:
        names: The names.
        most: How many to list.
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _is_one_edit(first: str, second: str) -> bool:
    """Whether one edit turns a name into another; False for names of two characters or fewer."""
    if min(len(first), len(second)) < 3 or abs(len(first) - len(second)) > 1:
        return False
    num_equal = 0
    while num_equal < min(len(first), len(second)) and first[num_equal] == second[num_equal]:
        num_equal += 1
    a = first[num_equal:]
    b = second[num_equal:]
    is_replaced = a[1:] == b[1:]
    is_added = a[1:] == b or a == b[1:]
    is_swapped = a[:2] == b[1::-1] and a[2:] == b[2:]
    return is_replaced or is_added or is_swapped


def _is_two_edits(first: str, second: str) -> bool:
    """Whether one name without a character is one edit from the other; of four or more."""
    if min(len(first), len(second)) < 4:
        return False
    for shortened, whole_name in ((first, second), (second, first)):
        for k in range(len(shortened)):
            if _is_one_edit(shortened[:k] + shortened[k + 1 :], whole_name):
                return True
    return False


def _words(name: str) -> set[str]:
    """The words of a name, in the singular."""
    words = re.findall(r"[^\W_]+", name)
    return {f"{word[:-3]}y" if word.endswith("ies") else word.removesuffix("s") for word in words}


def unique_name(name: str, used_names: set[str]) -> str:
    """Return a name that is not used yet: the name, or with a number from 2, as ``wall#2``.

    Args:
        name: The name.
        used_names: Names that are used; the returned one is added.
    """
    candidate = name
    count = 1
    while candidate in used_names:
        count += 1
        candidate = f"{name}#{count}"
    used_names.add(candidate)
    return candidate
