"""Exceptions that navbake raises on purpose, and words of messages; it imports nothing."""


class NavbakeError(Exception):
    """Base of every error that navbake raises on purpose.

    The message is one line: what is wrong, where, what was expected, what was found and
    what to do about it. The command line prints it and exits with status 1.
    """

    def __str__(self) -> str:
        """The message, in which names of files stand that may be anything.

        What no terminal shows is escaped, and the middle of what nobody would read is left out.
        """
        text = printable(super().__str__())
        return text if len(text) <= BEGINNING + END else f"{text[:BEGINNING]} … {text[-END:]}"


class ConfigError(NavbakeError):
    """A setting is missing, unknown, of the wrong type or out of its range."""


class SceneError(NavbakeError):
    """A scene cannot be read, or holds nothing that can be baked."""


class FormatError(NavbakeError):
    """A file does not follow the format that it claims to be in."""


class QueryError(NavbakeError):
    """A question to a grid that has no answer because the question is wrong."""


class MissingDependencyError(NavbakeError):
    """An optional package is not installed; the message names the command that installs it."""


class BakeWarning(UserWarning):
    """What a user should know about a bake that went through, one line: what, where, remedy.

    `navbake.bake` warns of it. ``warnings.simplefilter("error", navbake.BakeWarning)`` makes it
    an error, ``"ignore"`` keeps it quiet. The grid keeps the texts as `grid.warnings`.
    """


LONGEST = 200  # characters of a name in a message
# characters that stay of a message that is longer than both
BEGINNING = 700
END = 400


def shorten(text: str) -> str:
    """A name as far as a message shows it: a message is a line of a terminal, not a page."""
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def printable(message: str) -> str:
    """The message with all that no terminal shows escaped, as a name of a file may have it."""
    if message.isprintable():
        return message
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)


def count_of(count: int, what: str) -> str:
    """How many of something, in words."""
    return f"{count} {what}{'' if count == 1 else 's'}"
