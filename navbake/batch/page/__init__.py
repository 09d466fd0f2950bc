"""The page of a batch: what became of its scenes, for a browser, without a server or the network.

`page.py` writes it, `content.py` gathers what it says, `body.html` and `batch.js` show it.
"""
