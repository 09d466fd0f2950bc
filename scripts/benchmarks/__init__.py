"""The rows of `scripts/bench.py`, a file for each kind of job."""
