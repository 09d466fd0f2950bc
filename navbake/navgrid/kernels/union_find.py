"""Union-find: which items belong together.

Disjoint sets as a forest of parents (Galler and Fischer, 1964) with path halving (Tarjan and van
Leeuwen, 1984). Of two roots the lower item becomes the parent, not that of the larger tree: so a
root is the first member of its set, whatever the order in which sets were joined, and numbers
that follow the roots depend on nothing else. Path halving alone keeps the trees shallow enough.
"""

from navbake.compiled import UNCOUNTED, part


@part(**UNCOUNTED)
def find_root(parent, item):
    """The root of an item's set, its lowest member; of roots, `parent` has themselves."""
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@part(**UNCOUNTED)
def unite(parent, one, other):
    """Join the sets of two items."""
    one, other = find_root(parent, one), find_root(parent, other)
    if one != other:
        parent[max(one, other)] = min(one, other)
