"""Compiled functions of plain arrays and tuples of them, see `navbake.compiled`.

``inline="always"`` inlines a helper before types are inferred. A function of its own would be
optimized once more in each kernel that reaches it, and its tuples of arrays passed for each cell.
So helpers that many call are functions, others are inlined. No kernel is parallel:
`navbake.threads` calls it for ranges of its work.

numba counts references to arrays by an atomic instruction at each use, inlined helpers included:
half of the time of some loops. A function that allocates nothing is made with ``**UNCOUNTED``, as
its caller keeps the arrays alive.
"""
