"""Enumerations that kernels and their callers share: MuJoCo's types, surfaces, answers, kinds."""

# MuJoCo's geom types (mjtGeom); sites have the same types
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = range(9)
# MuJoCo's joint types (mjtJoint)
FREE, BALL, SLIDE, HINGE = range(4)

# What a surface encloses (`closed` of `ColumnHits`, `Facets` and `GeomTriangles`): an OPEN_SURFACE
# nothing; a CLOSED_SURFACE, made of a mesh's own triangles, its inside; SOLID is the surface of a
# height field, CONVEX_SOLID of a primitive or a hull. All insides count as occupied.
OPEN_SURFACE, CLOSED_SURFACE, SOLID, CONVEX_SOLID = range(4)

# Whether a geom meets a prism; UNDECIDED where rounding leaves no proof either way
APART, MEETS, UNDECIDED = range(3)

# What a geom can be; BUILDING is a mesh with an entire building, floors and walls together
OBJECT, WALL, STRUCTURE, BUILDING = range(4)
