"""Checks words against a list of choices, and writes hints about unknown names.

A hint stands in an error or a warning: it has a similar known name, and lists the known names.
"""

import re
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches

from navbake.errors import NavbakeError

MAX_LISTED = 12  # known names that a hint lists
MIN_SIMILARITY = 0.85  # of two names, by `difflib`: 1 for equal ones


def check_choice(
    value: str, choices: Collection[str], name: str, error: type[NavbakeError]
) -> None:
    """Check that the value of an argument or option is one of the words that it may be.

    Args:
        value: The value that a user passes.
        choices: The words that are allowed.
        name: The name of the argument or option, for the error's message.
        error: The class of the error that is raised.

    Raises:
        NavbakeError: The value is none of the choices; an error of the class `error`.
    """
    if value not in choices:
        expected = " or ".join(choices)
        raise error(
            f"expected {expected} as {name}, got {value!r}",
            key=name,
            value=value,
            expected=expected,
        )


def find_near(name: object, candidates: Iterable[str], most: int = 1) -> list[str]:
    """Return the known names that were probably meant; often none.

    A known name counts if it differs from the name by one edit (a character too many or too few, a
    wrong one, or two swapped); a long name may differ by more edits. It also counts if it has all
    words of the name: ``cell_size`` is found for ``size``. Capitals don't matter.

    Args:
        name: The name that is not known.
        candidates: The known names.
        most: The largest number of names to return.

    Returns:
        The known names, the most similar ones first.
    """
    # reversed: where names differ only in their capitals, the first one shall stay in the mapping
    names = reversed(list(dict.fromkeys(candidates)))
    by_folded = {candidate.casefold(): candidate for candidate in names}
    folded = str(name).casefold()
    close = get_close_matches(folded, by_folded, n=most, cutoff=MIN_SIMILARITY)
    close += [candidate for candidate in by_folded if _is_one_edit(folded, candidate)]
    words = _words(folded)
    with_all_words = [candidate for candidate in by_folded if words and words <= _words(candidate)]
    with_all_words.sort(key=len)
    nearest = dict.fromkeys([*close, *with_all_words])  # each once, in this order
    return [by_folded[candidate] for candidate in nearest][:most]


def suggest(
    name: object, candidates: Iterable[str], limit: int = MAX_LISTED, owner: str = "it"
) -> str:
    """Write a hint for a name that is not known, such as ``did you mean 'hall'? it has hall``.

    Args:
        name: The name that is not known.
        candidates: The known names.
        limit: The largest number of known names to list.
        owner: What has the known names, such as ``the grid``; the subject of the last sentence.
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
    """List the first names, and count the others, such as ``a, b and 3 more``.

    Args:
        names: The names.
        most: The largest number of names to list.
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
    first_rest = first[num_equal:]
    second_rest = second[num_equal:]
    is_replaced = first_rest[1:] == second_rest[1:]
    is_added = first_rest[1:] == second_rest or first_rest == second_rest[1:]
    is_swapped = first_rest[:2] == second_rest[1::-1] and first_rest[2:] == second_rest[2:]
    return is_replaced or is_added or is_swapped


def _is_two_edits(first: str, second: str) -> bool:
    """Whether two edits turn a name into another, one of which removes a character.

    False if a name has fewer than four characters.
    """
    if min(len(first), len(second)) < 4:
        return False
    for shortened, whole_name in ((first, second), (second, first)):
        for k in range(len(shortened)):
            if _is_one_edit(shortened[:k] + shortened[k + 1 :], whole_name):
                return True
    return False


def _words(name: str) -> set[str]:
    """Return the words of a name, in the singular."""
    words = re.findall(r"[^\W_]+", name)
    return {f"{word[:-3]}y" if word.endswith("ies") else word.removesuffix("s") for word in words}


def unique_name(name: str, used_names: set[str]) -> str:
    """Return a name that is not used yet: the name itself, or with a number, such as ``wall#2``.

    Args:
        name: The name.
        used_names: The names that are used; the returned name is added to them.
    """
    candidate = name
    count = 1
    while candidate in used_names:
        count += 1
        candidate = f"{name}#{count}"
    used_names.add(candidate)
    return candidate
