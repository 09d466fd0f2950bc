"""Enumerations that kernels and their callers share: MuJoCo's types, and states."""

# MuJoCo's geom types (mjtGeom); sites have the same
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = range(9)
# MuJoCo's joint types (mjtJoint)
FREE, BALL, SLIDE, HINGE = range(4)

# What a surface encloses (`closed` of `ColumnHits`, `Facets` and `GeomTriangles`). The inside of
# all but the first counts as occupied. A closed surface is a mesh's own triangles; SOLID is a
# height field, CONVEX_SOLID a primitive or a hull.
OPEN_SURFACE, CLOSED_SURFACE, SOLID, CONVEX_SOLID = range(4)

# Whether a geom meets a prism; UNDECIDED where rounding leaves no proof either way
APART, MEETS, UNDECIDED = range(3)

# What a geom can be; BUILDING is a mesh that holds an entire building, floors and walls together
OBJECT, WALL, STRUCTURE, BUILDING = range(4)
