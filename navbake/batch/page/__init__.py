"""The page of a batch: what became of its scenes, for a browser, without a server or the network.

`page.py` writes it. `content.py` gathers what it says, `reasons.py` groups failures, warnings and
remarks. `page.html`, `page.css` and the scripts are the page: `common.js` (what is known and what
is chosen), `charts.js`, `scenes.js` (the table, and a scene by itself), `page.js` (the rest).
"""
