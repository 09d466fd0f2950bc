"""Bakes many scenes: a scene that fails costs itself alone.

`manifest.py` lists the scenes, `work.py` makes what is asked for of one, `crew.py` does so in
worker processes that may crash, `index.py` notes what became of each, and `batch.py` puts these
together.
"""
