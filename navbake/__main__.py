"""``python -m navbake`` is the same as ``navbake``."""

from navbake.cli.main import main

main()
