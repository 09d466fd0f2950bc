"""Shapes of a grid for programs that take no cells: meshes, polygons and graphs."""
