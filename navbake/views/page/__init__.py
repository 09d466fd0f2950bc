"""What pages are made of: a skeleton, one style, and functions that their scripts share.

`page.py` puts a page together from `page.html`, `page.css`, `kit.js`, and what is the page's own:
its content, its `body.html` and its script. A page needs neither a server nor the network.
"""
