// Reads an OBJ as RecastDemo does (lines `v` and `f`, everything else skipped) and rasterizes it.
//
//     read_obj OBJ CELL X0 Z0 COLUMNS ROWS STEP
//
// Y is up. The field begins at X0, Z0 and has COLUMNS x ROWS columns of edge CELL [m]. Prints a line
// for each walkable span: column, row, height of its top [m]. STEP: of the heights of spans [m].

#include <Recast.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

int main(int argc, char** argv) {
    if (argc != 8) return 2;
    std::FILE* file = std::fopen(argv[1], "r");
    if (!file) return 3;
    std::vector<float> vertices;
    std::vector<int> corners;
    char line[512];
    while (std::fgets(line, sizeof(line), file)) {
        float x, y, z;
        int a, b, c;
        if (std::sscanf(line, "v %f %f %f", &x, &y, &z) == 3) vertices.insert(vertices.end(), {x, y, z});
        if (std::sscanf(line, "f %d %d %d", &a, &b, &c) == 3)
            corners.insert(corners.end(), {a - 1, b - 1, c - 1});
    }
    std::fclose(file);
    const int num_vertices = int(vertices.size() / 3), num_triangles = int(corners.size() / 3);
    const float cell = std::atof(argv[2]), step = std::atof(argv[7]);
    const int columns = std::atoi(argv[5]), rows = std::atoi(argv[6]);

    rcContext context(false);
    float low[3], high[3];
    rcCalcBounds(vertices.data(), num_vertices, low, high);
    low[0] = std::atof(argv[3]), low[1] -= 1, low[2] = std::atof(argv[4]);
    high[0] = low[0] + columns * cell, high[1] += 1, high[2] = low[2] + rows * cell;
    rcHeightfield* spans = rcAllocHeightfield();
    if (!rcCreateHeightfield(&context, *spans, columns, rows, low, high, cell, step)) return 4;
    std::vector<unsigned char> areas(num_triangles, 0);
    rcMarkWalkableTriangles(&context, 46, vertices.data(), num_vertices, corners.data(), num_triangles,
                            areas.data());
    if (!rcRasterizeTriangles(&context, vertices.data(), num_vertices, corners.data(), areas.data(),
                              num_triangles, *spans, 0))
        return 5;
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < columns; ++column)
            for (const rcSpan* span = spans->spans[column + row * columns]; span; span = span->next)
                if (span->area != RC_NULL_AREA)
                    std::printf("%d %d %.9g\n", column, row, low[1] + span->smax * step);
    return 0;
}
