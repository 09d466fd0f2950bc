"""Lanes between nodes while a graph of routes is made: is there a short enough route over them?

Source: Hart, Nilsson and Raphael 1968 for A*.
"""

from __future__ import annotations

import heapq
import math

# share of a cost by which an estimate may be too high, for rounding
ESTIMATE_SLACK = 1e-9


class LaneGraph:
    """Lanes between nodes; grows as nodes and lanes are added.

    Args:
        least_weight: the least weight of a free cell: no lane on a floor costs less a metre.
    """

    def __init__(self, least_weight: float) -> None:
        # lower bound of every lane's cost, as a multiple of the distance of its ends
        self._least_cost_per_metre = least_weight
        self._points: list[tuple[float, float]] = []  # x, y of each node [m]
        # for each node the lanes that lead from it: their end and their cost [m]
        self._lanes_from: list[list[tuple[int, float]]] = []

    def add_node(self, x: float, y: float) -> None:
        """Add a node without lanes at world x, y [m]; its index is the number of nodes before."""
        self._points.append((x, y))
        self._lanes_from.append([])

    def remove_last_node(self) -> None:
        """Remove the node that was added last; no lane may lead from or to it."""
        self._points.pop()
        self._lanes_from.pop()

    def add_lane(self, start: int, end: int, cost: float) -> None:
        """Add a lane in one direction.

        Args:
            start: index of the node that it leads from.
            end: index of the node that it leads to.
            cost: its cost, >= 0 [m].
        """
        self._lanes_from[start].append((end, cost))
        distance = math.dist(self._points[start], self._points[end])
        if cost < self._least_cost_per_metre * distance:  # over a link
            self._least_cost_per_metre = cost / distance

    def has_route(self, start: int, end: int, max_cost: float) -> bool:
        """Whether some route from one node to another costs at most `max_cost`.

        The search leaves out each node over which any route is too expensive. So it looks only at
        nodes in an ellipse round both ends, however many nodes there are.

        Args:
            start: index of the first node.
            end: index of the last node.
            max_cost: the highest cost [m]; inf for any route.
        """
        if start == end:
            return max_cost >= 0.0
        end_point = self._points[end]
        max_estimate = max_cost * (1.0 + ESTIMATE_SLACK)
        lowest_costs = {start: 0.0}  # of the routes to the nodes that were reached
        queue = [(0.0, start)]  # by the estimated cost of a route to the end over each node
        while queue:
            _, node = heapq.heappop(queue)
            node_cost = lowest_costs[node]
            for next_node, lane_cost in self._lanes_from[node]:
                cost = node_cost + lane_cost
                if next_node == end and cost <= max_cost:
                    return True
                if cost >= lowest_costs.get(next_node, math.inf):
                    continue
                remaining_distance = math.dist(self._points[next_node], end_point)
                estimate = cost + self._least_cost_per_metre * remaining_distance
                if estimate <= max_estimate:
                    lowest_costs[next_node] = cost
                    heapq.heappush(queue, (estimate, next_node))
        return False
