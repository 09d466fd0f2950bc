"""Bakes many scenes: a scene that fails costs itself alone.

`manifest.py` lists the scenes, `done.py` says which are done already, `work.py` makes what is asked
for of one, `crew.py` does so in worker processes that may crash, `index.py` notes what became of
each, and `batch.py` puts these together. `far.py` does for scenes and grids on stores what the
others do for local ones.
"""
