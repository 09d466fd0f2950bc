"""Readers of mesh files: each yields named parts as they stand in the file."""
