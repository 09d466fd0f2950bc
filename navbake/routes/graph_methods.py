"""The methods of a graph of routes whose code stands in other modules: writing and auditing it.

These modules import `navbake.routes.graph`. To avoid a circle, this module imports them only for
type checkers and inside its methods. It holds no code of its own, and the graph of imports leaves
it out, like `navbake.navgrid.grid_methods`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from navbake.auditor.facts import AuditReport
    from navbake.navgrid.grid import NavGrid
    from navbake.routes.graph import RouteGraph

# Functions import the modules that they call: these import this one.


class RouteGraphMethods:
    """Methods that `RouteGraph` inherits."""

    def _as_graph(self) -> RouteGraph:
        """Return the object, typed as `RouteGraph`: no other class inherits from this one."""
        return cast("RouteGraph", self)

    def save(self, path: str | PathLike[str], to: str | None = None) -> list[Path]:
        """Write the graph for nav2's Route Server, Open-RMF and others; see docs/routes.md.

        Args:
            path: Name of the file; its ending says the format unless `to` does.
            to: Name of the format: ``nav2-route``, ``lif``, ``rmf``, ``graphml`` or ``gml``.

        Returns:
            The paths of the written files.

        Raises:
            FormatError: There is no such format, or the file cannot be written.

        Example:
            >>> grid.routes().save("routes.geojson")
            [PosixPath('routes.geojson')]
        """
        from navbake.formats.route_files import write_routes

        return write_routes(self._as_graph(), path, to)

    def audit(self, grid: NavGrid, *, radius: float | None = None) -> AuditReport:
        """Check the graph for lanes that cross walls, and for nodes that cannot be reached.

        Args:
            grid: A grid of the graph's scene, inflated or not, or a map of one level.
            radius: Radius of the agent [m]; None for the graph's radius.

        Returns:
            The findings, errors first.
        """
        from navbake.auditor.routes import audit_routes

        return audit_routes(self._as_graph(), grid, radius=radius)
