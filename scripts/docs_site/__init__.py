"""Parts of the site of the documentation, which `make_docs.py` builds."""
