"""``python -m navbake`` is the same as ``navbake``."""

from navbake.cli.start import main

main()
