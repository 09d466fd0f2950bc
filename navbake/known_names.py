"""What an error about an unknown name adds: the nearest known name, and which ones there are."""

from collections.abc import Iterable
from difflib import get_close_matches

MAX_LISTED = 12


def suggest(name: object, known: Iterable[str], limit: int = MAX_LISTED) -> str:
    """The nearest of the known names, if one is near, and the first `limit` of them all."""
    names = list(dict.fromkeys(known))
    near = get_close_matches(str(name), names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    more = f", and {len(names) - limit} more" if len(names) > limit else ""
    return f"{hint}it has {', '.join(names[:limit]) or 'none'}{more}"
