"""Bakes many scenes: a scene that fails costs itself alone.

`scenes.py` lists the scenes and `settings.py` merges their settings. `job.py` does one scene: it
fetches the scene's files, bakes, makes the products (`products.py`), puts them into the output
folder, and computes the key by which the next run knows that the scene is done. `run.py` does all
of them in worker processes (`workers.py`) or on a Ray cluster (`cluster.py`), and writes what
became of each into the index (`index.py`). `store.py` reads and writes files here and on stores.
"""
