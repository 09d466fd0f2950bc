"""The command `navbake warm-up`: compiles the kernels, so that no first bake or query waits."""

from __future__ import annotations

from navbake.cli.printing import VOLUME, print_warnings, say_unless_quiet


def warm_up() -> None:
    """Compile all kernels for this machine, once.

    It takes a minute or two. Without it, the first bake and the first query compile what they use.
    For a container, set NUMBA_CACHE_DIR to a folder of its own: compiled code is kept there.

    Example: navbake warm-up
    """
    from navbake import compiled  # loads numba
    from navbake.cli.progress import stage_progress  # loads rich

    if compiled.cache_folder() is None:
        lost = "no folder for compiled code can be written, so nothing can be kept"
        print_warnings([f"{lost}: {compiled.REMEDY}"])
        return
    with stage_progress(title="compiling", hidden=VOLUME.quiet) as show:
        cold = compiled.warm_up(
            everything=True, watch=lambda done, total: show("kernels", done / total)
        )
    if cold:
        print_warnings([f"not compiled, or not kept: {', '.join(cold)}"])
    else:
        say_unless_quiet("compiled: bakes and queries start at once from now on")
