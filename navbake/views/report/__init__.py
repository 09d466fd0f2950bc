"""A report on grids: one page that needs neither a server nor the network.

`report.py` writes it. `content.py` gathers what it says of a grid, `cells.py` what it says of each
cell, `pictures.py` what it shows, `difference.py` what differs between two grids. `page.html`,
`page.css` and `page.js` are the page.
"""
