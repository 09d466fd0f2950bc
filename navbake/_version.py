"""The version of navbake, for the package and for its build."""

__version__ = "0.4.0"
