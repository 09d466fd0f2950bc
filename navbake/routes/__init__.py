"""Sparse graphs of where agents drive."""
