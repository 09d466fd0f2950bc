"""Batches on a Ray cluster: worker processes on several machines.

`executor` does a batch's jobs, `slot` is what runs on the nodes, and `connection` connects to a
cluster or starts one on this machine.
"""
