"""Graphs of routes: places in a scene, and the lanes that agents drive between them."""
