"""Bakes many scenes; the failure of one scene doesn't affect the others.

`scenes.py` lists the scenes and merges their settings. `job.py` does one scene: it fetches files,
bakes, makes the products (`products.py`), and computes the key by which the next run skips the
scene; `scene_row.py` has the types of what it reports. `run.py` says what would be baked, runs all
jobs in worker processes, here or on a Ray cluster (`workers.py`), and writes the index (`index.py`)
and shards. `store.py` accesses files, local and on stores.
"""
