"""A report on grids.

`report.py` writes it and gathers facts and tables, `maps.py` what it shows of each level,
`difference.py` what differs between two grids; `body.html` and `report.js` show it.
"""
