"""Exceptions that navbake raises on purpose, and helpers for their messages; it imports nothing."""


class NavbakeError(Exception):
    """Base of every error that navbake raises on purpose.

    The message is one line: what is wrong, where, what was expected, what was given and what to do
    about it. The command line prints it and exits with status 1.

    The parts of the message that a program may need are attributes as well; an attribute is None if
    the message has no such part. If a message reports several faults, the attributes describe the
    first one.

    Attributes:
        path: The file at fault, or what it was read from, as a message names it.
        key: The setting, argument or field at fault, with its section, such as ``agent.radius``.
        value: What was given.
        expected: What was expected, in the message's words.
        place: The place in the file, such as ``line 3`` or ``levels[0].weights``.
        hint: What to do, or the nearest known name.

    Example:
        >>> try:
        ...     navbake.bake("house.yaml", grid={"cell_size": "5cm"})
        ... except navbake.ConfigError as error:
        ...     print(error.key, repr(error.value), error.expected)
        grid.cell_size '5cm' a number > 0
    """

    def __init__(
        self,
        message: str = "",
        *,
        path: str | None = None,
        key: str | None = None,
        value: object = None,
        expected: str | None = None,
        place: str | None = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(message)
        self.path = path
        self.key = key
        self.value = value
        self.expected = expected
        self.place = place
        self.hint = hint

    def __str__(self) -> str:
        """Return the message on one line that any terminal can show.

        Characters that are not printable are escaped; the names of files may have such. The middle
        of a very long message is left out.
        """
        message = printable(super().__str__())
        is_short = len(message) <= MAX_BEGINNING + MAX_TEXT_END
        return message if is_short else f"{message[:MAX_BEGINNING]} … {message[-MAX_TEXT_END:]}"


class ConfigError(NavbakeError):
    """Raised for a setting that is missing, unknown, of the wrong type or out of its range."""


class SceneError(NavbakeError):
    """Raised for a scene that cannot be read, or that holds nothing to bake."""


class FormatError(NavbakeError):
    """Raised for a file that does not follow the format that it claims to be in."""


class QueryError(NavbakeError):
    """Raised for a query to a grid with wrong arguments, such as a position that is not finite."""


class MissingDependencyError(NavbakeError):
    """Raised where an optional package is needed; the message has the command that installs it."""


class BakeWarning(UserWarning):
    """A warning about a bake that succeeded, one line: what, where, and what to do.

    `navbake.bake` issues these warnings. ``warnings.simplefilter("error", navbake.BakeWarning)``
    turns them into errors, ``"ignore"`` silences them. The grid keeps the texts as `grid.warnings`.
    """


MAX_NAME = 200  # characters of a name in a message
# a message with more characters than both together is cut: these many stay at its beginning and end
MAX_BEGINNING = 700
MAX_TEXT_END = 400


def shorten(text: str) -> str:
    """Shorten a name to `MAX_NAME` characters, so that a message stays readable in a terminal."""
    return text if len(text) <= MAX_NAME else f"{text[:MAX_NAME]}…"


def printable(message: str) -> str:
    """Escape all characters of a message that are not printable, such as line ends."""
    if message.isprintable():
        return message
    return "".join(
        character if character.isprintable() else repr(character)[1:-1] for character in message
    )


def count_of(count: int, noun: str) -> str:
    """Write a count with its noun, in the plural unless it is 1: ``1 door``, ``3 doors``.

    Args:
        count: The count.
        noun: The noun in the singular, whose plural ends in s.
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"
