"""Standable surfaces, what steps join them to, and how floors go on under things."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

# Surfaces of different geoms this close together are at one height [m]
SAME = 1e-5
# `closed` of geoms made of triangles that enclose a volume; solids have SOLID
SURFACE, SOLID = 1, 2
# How far a height may exceed a limit and still keep it [m]
SLACK = 1e-6


@njit(cache=True, parallel=True)
def mark_surfaces(
    x_min, y_max, cell_size, width, start, z, normals, geom, closed, plane_pos, plane_normal,
    min_up, headroom, step, floor_like, standable,
):  # fmt: skip
    """Tell which crossings are floor-like and which are standable.

    Floor-like: faces up within the slope, or faces up more steeply at most a step above one that
    does: a bump too low to be an obstacle. Standable: faces up within the slope, lies inside of
    no solid, and the next surface above is at least `headroom` higher. A solid that stands on a
    surface covers it; a closed surface that begins at its height doesn't, because buildings are
    drawn as closed shells stacked on each other. Of several surfaces at one height the lowest
    counts.

    Args:
        x_min, y_max, cell_size, width: the lattice.
        start, z, normals, geom: the columns.
        closed: by geom id, SURFACE or SOLID where it encloses a volume, else 0, uint8.
        plane_pos, plane_normal: the infinite planes, (p, 3) float64.
        min_up: cosine of the largest slope.
        headroom: [m].
        step: [m].
        floor_like, standable: (n,) bool, receive the answers.
    """
    for cell in prange(start.shape[0] - 1):
        x = x_min + (cell % width + 0.5) * cell_size
        y = y_max - (cell // width + 0.5) * cell_size
        first, last = start[cell], start[cell + 1]
        previous, gentle = -math.inf, -math.inf
        for i in range(first, last):
            standable[i] = False
            floor_like[i] = normals[i, 2] > 0.0 and z[i] - gentle <= step + SLACK
            if normals[i, 2] < min_up:
                continue
            floor_like[i] = True
            gentle = z[i]
            if z[i] - previous <= SAME:
                continue
            inside = 0
            for p in range(plane_pos.shape[0]):
                depth = (
                    plane_normal[p, 0] * (x - plane_pos[p, 0])
                    + plane_normal[p, 1] * (y - plane_pos[p, 1])
                    + plane_normal[p, 2] * (z[i] - plane_pos[p, 2])
                )
                if depth < -SAME:
                    inside += 1
            for j in range(first, i):  # what begins at this height, a hair lower
                if z[i] - z[j] <= SAME and normals[j, 2] < 0.0 and closed[geom[j]] == SURFACE:
                    inside -= 1
            above = math.inf
            for j in range(i + 1, last):
                apart = z[j] - z[i] > SAME
                if apart and above == math.inf:
                    above = z[j]
                if not closed[geom[j]]:
                    continue
                if normals[j, 2] > 0.0:
                    inside += 1 if apart else 0
                elif apart or closed[geom[j]] == SURFACE:
                    inside -= 1
            if inside <= 0 and above - z[i] >= headroom - SLACK:
                standable[i] = True
                previous = z[i]


@njit(cache=True)
def _root(parent, node):
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True)
def neighbour(cell, way, width, height):
    """The next cell east (0), south (1), west (2) or north (3), or -1."""
    col = cell % width
    if way == 0:
        return cell + 1 if col + 1 < width else -1
    if way == 1:
        return cell + width if cell + width < width * height else -1
    if way == 2:
        return cell - 1 if col > 0 else -1
    return cell - width


@njit(cache=True)
def join_by_steps(start, z, group, width, height, step):
    """Label the connected parts of standable surfaces.

    Args:
        start, z: standable surfaces by column, ascending: (cells + 1,) int64, (n,) float64.
        group: (n,) int64; only surfaces of one group belong together.
        width, height: of the lattice.
        step: the largest difference of neighbours that belong together [m].

    Returns:
        The part of each surface, (n,) int64, numbered from 0 by their first members; and how
        many surfaces each part has, (parts,) int64.
    """
    parent = np.arange(z.shape[0])
    for cell in range(width * height):
        for way in range(2):
            other = neighbour(cell, way, width, height)
            if other < 0:
                continue
            for a in range(start[cell], start[cell + 1]):
                for b in range(start[other], start[other + 1]):
                    if group[a] == group[b] and abs(z[a] - z[b]) <= step + SLACK:
                        root_a, root_b = _root(parent, a), _root(parent, b)
                        if root_a < root_b:
                            parent[root_b] = root_a
                        elif root_b < root_a:
                            parent[root_a] = root_b
    part = np.empty(z.shape[0], np.int64)
    size = np.zeros(z.shape[0], np.int64)
    count = 0
    for node in range(z.shape[0]):
        root = _root(parent, node)
        if root == node:  # roots are the lowest of their part, so met first
            part[node] = count
            count += 1
        else:
            part[node] = part[root]
        size[part[node]] += 1
    return part, size[:count].copy()


@njit(cache=True)
def group_members(part, size):
    """List the members of each part.

    Args:
        part: the part of each surface, (n,) int64.
        size: how many each part has, (parts,) int64.

    Returns:
        start, (parts + 1,) int64, and member, (n,) int64, ascending within a part.
    """
    start = np.zeros(size.shape[0] + 1, np.int64)
    for i in range(size.shape[0]):
        start[i + 1] = start[i] + size[i]
    cursor = start[:-1].copy()
    member = np.empty(part.shape[0], np.int64)
    for i in range(part.shape[0]):
        member[cursor[part[i]]] = i
        cursor[part[i]] += 1
    return start, member


@njit(cache=True)
def place_on_levels(start, z, base, num_levels, level):
    """Give each surface its level, so that no two of a column share one.

    The lowest of a column on a level stays; each other one goes to the next level up that has
    none in that column.

    Args:
        start, z: surfaces by column, ascending.
        base: the level of the highest ground at or below each, (n,) int64.
        num_levels: how many there are.
        level: (n,) int64, receives the level, or -1 where every one above is taken.
    """
    taken = np.zeros(num_levels, np.bool_)
    for cell in range(start.shape[0] - 1):
        first, last = start[cell], start[cell + 1]
        if last == first:
            continue
        taken[:] = False
        for i in range(first, last):
            level[i] = -1
            if not taken[base[i]]:
                taken[base[i]] = True
                level[i] = base[i]
        for i in range(first, last):
            if level[i] >= 0:
                continue
            for k in range(base[i] + 1, num_levels):
                if not taken[k]:
                    taken[k] = True
                    level[i] = k
                    break


@njit(cache=True)
def find_links(start, z, level, width, height, step):
    """Pairs of surfaces in neighbouring cells, a step apart, on different levels.

    Returns:
        Surfaces a and b of each pair, (n, 2) int64, the lower level's first, by cell.
    """
    pairs = np.empty((0, 2), np.int64)
    for pass_ in range(2):
        count = 0
        for cell in range(width * height):
            for way in range(2):
                other = neighbour(cell, way, width, height)
                if other < 0:
                    continue
                for a in range(start[cell], start[cell + 1]):
                    for b in range(start[other], start[other + 1]):
                        if level[a] == level[b] or level[a] < 0 or level[b] < 0:
                            continue
                        if abs(z[a] - z[b]) > step + SLACK:
                            continue
                        if pass_ == 1:
                            swap = level[b] < level[a]
                            pairs[count, 0] = b if swap else a
                            pairs[count, 1] = a if swap else b
                        count += 1
        if pass_ == 0:
            pairs = np.empty((count, 2), np.int64)
    return pairs


@njit(cache=True)
def grow_floor(floor, width, height, start, z, candidate, lowest, highest, step):
    """Let a level's floor go on under things, ring by ring, in place.

    A cell without a floor takes the candidate surface that is nearest to the floor of a
    neighbour (the lower one if two are equally near), when they differ by at most a step.

    Args:
        floor: (cells,) float64, NaN where there is none yet [m].
        width, height: of the lattice.
        start, z: all crossings by column, ascending.
        candidate: (n,) bool, which crossings a floor may go on at.
        lowest, highest: (cells,) float64, between which this level stays, infinite where
            there is no level below or above [m].
        step: [m].
    """
    num = width * height
    queue = np.empty(num, np.int64)
    queued = np.zeros(num, np.bool_)
    value = np.empty(num, np.float64)
    end = 0
    for cell in range(num):
        if not math.isnan(floor[cell]):
            for way in range(4):
                other = neighbour(cell, way, width, height)
                if other >= 0 and math.isnan(floor[other]) and not queued[other]:
                    queued[other] = True
                    queue[end] = other
                    end += 1
    while end > 0:
        for q in range(end):
            value[q] = _nearest_candidate(
                queue[q], floor, width, height, start, z, candidate, lowest, highest, step
            )
        following = np.empty(4 * end, np.int64)
        num_following = 0
        for q in range(end):
            queued[queue[q]] = False
            floor[queue[q]] = value[q]
        for q in range(end):
            if math.isnan(value[q]):
                continue
            for way in range(4):
                other = neighbour(queue[q], way, width, height)
                if other >= 0 and math.isnan(floor[other]) and not queued[other]:
                    queued[other] = True
                    following[num_following] = other
                    num_following += 1
        end = num_following
        queue[:end] = following[:end]


@njit(cache=True)
def _nearest_candidate(cell, floor, width, height, start, z, candidate, lowest, highest, step):
    best, best_gap = math.nan, step + SLACK
    for way in range(4):
        other = neighbour(cell, way, width, height)
        if other < 0 or math.isnan(floor[other]):
            continue
        for i in range(start[cell], start[cell + 1]):
            if not candidate[i] or z[i] < lowest[cell] or z[i] > highest[cell]:
                continue
            gap = abs(z[i] - floor[other])
            if gap < best_gap - SAME or (gap <= best_gap + SAME and z[i] < best):
                best, best_gap = z[i], min(gap, best_gap)
            elif math.isnan(best) and gap <= best_gap:
                best, best_gap = z[i], gap
    return best
