"""The answer of a stage that can't be brought up to date near what moved alone."""


class NotLocal(Exception):
    """More may change than what is near to what moved; the text says why."""
