"""``python -m navbake`` is the same as ``navbake``."""

from navbake.cli import main

main()
