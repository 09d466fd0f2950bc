"""Compiled functions of plain arrays and tuples of them, see `navbake.compiled`."""
