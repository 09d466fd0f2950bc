"""Compiled functions of plain arrays and tuples of them, see `navbake.compiled`.

A helper with ``inline="always"`` becomes part of its caller's code before types are inferred. As a
function of its own it would be optimized once more in each kernel that reaches it, and its tuples
of arrays would be passed for each cell. So what many call is a function; other helpers are
inlined. No kernel is parallel: `navbake.threads` calls it for ranges of its work.

numba counts the references to an array at each use, by an atomic instruction, and each helper that
is inlined is such a use: half of the time of some loops. A function that allocates nothing needs no
counts, as its caller keeps the arrays alive: it is made with ``**UNCOUNTED``.
"""
