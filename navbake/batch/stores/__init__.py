"""Where scenes come from and grids go: folders of this machine, and stores that fsspec knows.

`urls.py` tells one from the other, `store.py` reads and writes files of a store, `mirror.py` brings
a scene and all that it names into a temporary folder, and `index.py` is the index of a batch that
writes into a store.
"""
