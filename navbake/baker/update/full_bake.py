"""What an update cannot do near what moved alone."""


class FullBake(Exception):
    """Raised when an update needs a full bake; the text says why."""
