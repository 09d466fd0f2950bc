// Times Recast over a file of triangles: from rasterizing to regions, one thread.
//
//     recast_bench TRIANGLES CELL STEP HEIGHT RADIUS SLOPE
//
// TRIANGLES: int32 number of vertices, int32 number of triangles, float32 x y z of each vertex
// (y is up, as Recast has it), int32 corners of each triangle; little endian. Lengths in metres,
// SLOPE in degrees. Prints a line of JSON; the file's reading doesn't count.

#include <Recast.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

namespace {

double now() {
    using clock = std::chrono::steady_clock;
    return std::chrono::duration<double>(clock::now().time_since_epoch()).count();
}

[[noreturn]] void fail(const char* what) {
    std::fprintf(stderr, "recast_bench: %s\n", what);
    std::exit(1);
}

template <class T> std::vector<T> read(std::FILE* file, std::size_t count) {
    std::vector<T> values(count);
    if (std::fread(values.data(), sizeof(T), count, file) != count) fail("the file is too short");
    return values;
}

// The most memory that this process has had [MiB]; 0 where the system doesn't tell.
double peak() {
    double found = 0;
    char line[256];
    if (std::FILE* file = std::fopen("/proc/self/status", "r")) {
        while (std::fgets(line, sizeof(line), file))
            if (std::sscanf(line, "VmHWM: %lf", &found) == 1) found /= 1024;
        std::fclose(file);
    }
    return found;
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 7) fail("expected TRIANGLES CELL STEP HEIGHT RADIUS SLOPE");
    std::FILE* file = std::fopen(argv[1], "rb");
    if (!file) fail("cannot open the file of triangles");
    const auto counts = read<std::int32_t>(file, 2);
    const auto vertices = read<float>(file, 3 * std::size_t(counts[0]));
    const auto corners = read<std::int32_t>(file, 3 * std::size_t(counts[1]));
    std::fclose(file);

    const float cell = std::atof(argv[2]), level = cell / 2;  // spans are half a cell high
    const int climb = int(std::floor(std::atof(argv[3]) / level));
    const int height = int(std::ceil(std::atof(argv[4]) / level));
    const int radius = int(std::ceil(std::atof(argv[5]) / cell));
    const float slope = std::atof(argv[6]);

    const double start = now();
    rcContext context(false);
    float low[3], high[3];
    rcCalcBounds(vertices.data(), counts[0], low, high);
    int width = 0, depth = 0;
    rcCalcGridSize(low, high, cell, &width, &depth);
    rcHeightfield* spans = rcAllocHeightfield();
    if (!spans || !rcCreateHeightfield(&context, *spans, width, depth, low, high, cell, level))
        fail("out of memory");
    std::vector<unsigned char> areas(counts[1], 0);
    rcMarkWalkableTriangles(&context, slope, vertices.data(), counts[0], corners.data(), counts[1],
                            areas.data());
    if (!rcRasterizeTriangles(&context, vertices.data(), counts[0], corners.data(), areas.data(),
                              counts[1], *spans, climb))
        fail("cannot rasterize");
    const double rasterized = now();
    rcFilterLowHangingWalkableObstacles(&context, climb, *spans);
    rcFilterLedgeSpans(&context, height, climb, *spans);
    rcFilterWalkableLowHeightSpans(&context, height, *spans);
    rcCompactHeightfield* compact = rcAllocCompactHeightfield();
    if (!compact || !rcBuildCompactHeightfield(&context, height, climb, *spans, *compact))
        fail("cannot compact");
    if (!rcErodeWalkableArea(&context, radius, *compact)) fail("cannot erode");
    const double eroded = now();
    if (!rcBuildDistanceField(&context, *compact)) fail("cannot build distances");
    if (!rcBuildRegions(&context, *compact, 0, 8 * 8, 20 * 20)) fail("cannot build regions");
    const double end = now();
    std::printf("{\"seconds\": %.6f, \"rasterize\": %.6f, \"filter\": %.6f, \"regions\": %.6f, "
                "\"peak\": %.1f, \"width\": %d, \"depth\": %d, \"triangles\": %d}\n",
                end - start, rasterized - start, eroded - rasterized, end - eroded, peak(), width, depth,
                counts[1]);
    return 0;
}
