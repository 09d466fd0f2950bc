"""Distances of voxels from the nearest occupied voxel, axis by axis.

`spread_along_axis` is one pass of the exact Euclidean distance transform of Felzenszwalb and
Huttenlocher ("Distance Transforms of Sampled Functions", 2012): the lower envelope of parabolas
along each line of voxels, in linear time. They measure from centre to centre. These kernels measure
to the nearest point of the occupied cube, so their parabolas stand on the faces between voxels: the
point of a cube that is nearest to a voxel's centre lies, along each axis, on the face towards that
voxel, or beside the centre itself.

Lengths are in half voxels, so that centres are even numbers, faces are odd numbers, and squares are
whole numbers, which float64 holds exactly.
"""

import math

import numpy as np

from navbake.compiled import kernel
from navbake.voxels.envelope_kernels import add_parabola


@kernel(nogil=True)
def spread_along_axis(lines, begin, end):
    """Spread squared distances along the lines of an array, in place.

    Args:
        lines: squared distances [half voxels squared], shape (lines, planes, n), float64, inf where
            none is known yet. The line ``lines[a, b]`` has n voxels. Any memory layout.
        begin: first index of `lines` to work on.
        end: the index after the last.
    """
    count = lines.shape[2]
    heights = np.empty(count)  # of the line's voxels, before the pass
    faces = np.empty(count)  # places of the parabolas of the envelope
    face_heights = np.empty(count)
    bounds = np.empty(count + 1)  # from where to where each parabola is the lowest
    for line in range(begin, end):
        for plane in range(lines.shape[1]):
            has_height = False
            for voxel in range(count):
                heights[voxel] = lines[line, plane, voxel]
                has_height |= heights[voxel] < math.inf
            if not has_height:
                continue
            num_parabolas = 0
            for voxel in range(1, count):
                face_height = min(heights[voxel - 1], heights[voxel])
                if face_height == math.inf:
                    continue
                num_parabolas = add_parabola(
                    faces, face_heights, bounds, num_parabolas, 2.0 * voxel - 1.0, face_height
                )
            parabola = 0
            for voxel in range(count if num_parabolas else 0):
                center = 2.0 * voxel
                while bounds[parabola + 1] < center:
                    parabola += 1
                offset = center - faces[parabola]
                spread = face_heights[parabola] + offset * offset
                lines[line, plane, voxel] = min(heights[voxel], spread)


@kernel(nogil=True)
def interpolate(values, points, results, gradients, begin, end):
    """Interpolate between the eight centres round each point, trilinearly.

    Beyond the outermost centres, the outermost cells are extended.

    Args:
        values: values at the centres, shape (nx, ny, nz), float64, finite.
        points: points, shape (n, 3), in voxels: centre (i, j, k) is at i, j, k.
        results: the values at the points, shape (n,), written.
        gradients: change of the value along x, y and z for each voxel's edge, shape (n, 3),
            written.
        begin: first point to work on.
        end: the point after the last.
    """
    lower = np.empty(3, np.int64)
    upper = np.empty(3, np.int64)
    fraction = np.empty(3)
    for point in range(begin, end):
        for axis in range(3):
            last = values.shape[axis] - 1
            lower[axis] = min(max(math.floor(points[point, axis]), 0), max(last - 1, 0))
            upper[axis] = min(lower[axis] + 1, last)
            fraction[axis] = points[point, axis] - lower[axis]
        x, y, z = fraction
        value_000 = values[lower[0], lower[1], lower[2]]
        value_001 = values[lower[0], lower[1], upper[2]]
        value_010 = values[lower[0], upper[1], lower[2]]
        value_011 = values[lower[0], upper[1], upper[2]]
        value_100 = values[upper[0], lower[1], lower[2]]
        value_101 = values[upper[0], lower[1], upper[2]]
        value_110 = values[upper[0], upper[1], lower[2]]
        value_111 = values[upper[0], upper[1], upper[2]]
        # along z, then along y, then along x
        value_00 = value_000 + z * (value_001 - value_000)
        value_01 = value_010 + z * (value_011 - value_010)
        value_10 = value_100 + z * (value_101 - value_100)
        value_11 = value_110 + z * (value_111 - value_110)
        value_0 = value_00 + y * (value_01 - value_00)
        value_1 = value_10 + y * (value_11 - value_10)
        results[point] = value_0 + x * (value_1 - value_0)
        gradients[point, 0] = value_1 - value_0
        rise_0 = value_01 - value_00
        rise_1 = value_11 - value_10
        gradients[point, 1] = rise_0 + x * (rise_1 - rise_0)
        rise_00 = value_001 - value_000
        rise_01 = value_011 - value_010
        rise_10 = value_101 - value_100
        rise_11 = value_111 - value_110
        rise_0 = rise_00 + y * (rise_01 - rise_00)
        rise_1 = rise_10 + y * (rise_11 - rise_10)
        gradients[point, 2] = rise_0 + x * (rise_1 - rise_0)
