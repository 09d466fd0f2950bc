"""Checks words against a list of choices, and writes hints about unknown names.

A hint stands in an error or a warning: it has a similar known name, and lists the known names.
"""

import re
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches

from navbake.errors import NavbakeError

MAX_LISTED = 12  # known names that a hint lists
MIN_PREFIX_LENGTH = 3  # of a name that a known one may be the long form of
MIN_SIMILARITY = 0.85  # of two names, by `difflib`: 1 for equal ones


def check_choice(
    value: str, choices: Collection[str], name: str, error: type[NavbakeError]
) -> None:
    """Raise an error unless the value of an argument or option is one of the allowed words.

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


def find_similar_names(name: object, candidates: Iterable[str], max_names: int = 1) -> list[str]:
    """Return the known names that a user who wrote an unknown name probably meant; often none.

    A known name counts if it differs from the name by one edit (a character too many or too few, a
    wrong one, or two swapped); a long name may differ by more edits. It also counts if it has all
    words of the name: ``cell_size`` is found for ``size``. Capitals don't matter.

    Args:
        name: The name that is not known.
        candidates: The known names.
        max_names: The largest number of names to return.

    Returns:
        The known names, the most similar ones first.
    """
    # reversed: where names differ only in their capitals, the first one shall stay in the mapping
    reversed_candidates = reversed(list(dict.fromkeys(candidates)))
    original_by_folded = {candidate.casefold(): candidate for candidate in reversed_candidates}
    folded_name = str(name).casefold()
    close_names = get_close_matches(
        folded_name, original_by_folded, n=max_names, cutoff=MIN_SIMILARITY
    )
    close_names += [
        candidate for candidate in original_by_folded if _is_one_edit(folded_name, candidate)
    ]
    name_words = _split_into_words(folded_name)
    names_with_all_words = [
        candidate
        for candidate in original_by_folded
        if name_words and name_words <= _split_into_words(candidate)
    ]
    names_with_all_words.sort(key=len)
    near_names = dict.fromkeys([*close_names, *names_with_all_words])  # each once, in this order
    return [original_by_folded[candidate] for candidate in near_names][:max_names]


def append_hint(message: str, hint: str) -> str:
    """Return a message with a hint after it; the message alone if the hint is ""."""
    return f"{message}: {hint}" if hint else message


def suggest(
    name: object, candidates: Iterable[str], max_listed: int = MAX_LISTED, owner: str = "it"
) -> str:
    """Write a hint for a name that is not known, such as ``did you mean 'hall'? it has hall``.

    Args:
        name: The name that is not known.
        candidates: The known names.
        max_listed: The largest number of known names to list.
        owner: What has the known names, such as ``the grid``; the subject of the last sentence.
    """
    names = list(dict.fromkeys(candidates))
    folded_name = str(name).casefold()
    near_names = find_similar_names(name, names)
    if not near_names:
        near_names = [
            candidate for candidate in names if _is_two_edits(folded_name, candidate.casefold())
        ]
    if not near_names and len(folded_name) >= MIN_PREFIX_LENGTH:
        near_names = [
            candidate for candidate in names if candidate.casefold().startswith(folded_name)
        ]
    question_text = f"did you mean {near_names[0]!r}? " if near_names else ""
    more_text = f", and {len(names) - max_listed} more" if len(names) > max_listed else ""
    return f"{question_text}{owner} has {', '.join(names[:max_listed]) or 'none'}{more_text}"


def list_first(names: Sequence[str], max_names: int = 1) -> str:
    """List the first names, and count the others, such as ``a, b and 3 more``.

    Args:
        names: The names.
        max_names: The largest number of names to list.
    """
    more_text = f" and {len(names) - max_names} more" if len(names) > max_names else ""
    return ", ".join(names[:max_names]) + more_text


def _is_one_edit(first_name: str, second_name: str) -> bool:
    """Whether one edit turns a name into another; False for names of two characters or fewer."""
    if min(len(first_name), len(second_name)) < 3 or abs(len(first_name) - len(second_name)) > 1:
        return False
    num_equal = 0
    while (
        num_equal < min(len(first_name), len(second_name))
        and first_name[num_equal] == second_name[num_equal]
    ):
        num_equal += 1
    first_tail = first_name[num_equal:]
    second_tail = second_name[num_equal:]
    is_replaced = first_tail[1:] == second_tail[1:]
    is_added = first_tail[1:] == second_tail or first_tail == second_tail[1:]
    is_swapped = first_tail[:2] == second_tail[1::-1] and first_tail[2:] == second_tail[2:]
    return is_replaced or is_added or is_swapped


def _is_two_edits(first_name: str, second_name: str) -> bool:
    """Whether two edits turn one name into the other, where one edit removes a character.

    False if a name has fewer than four characters.
    """
    if min(len(first_name), len(second_name)) < 4:
        return False
    for shortened, whole_name in ((first_name, second_name), (second_name, first_name)):
        for i in range(len(shortened)):
            if _is_one_edit(shortened[:i] + shortened[i + 1 :], whole_name):
                return True
    return False


def _split_into_words(name: str) -> set[str]:
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
