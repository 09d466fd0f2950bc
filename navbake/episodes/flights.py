"""Draws episodes of flights: a start and a goal in the air, and the shortest way through voxels.

The set is one of `EpisodeSet`, with the task ``fly``; it is written, read and scored as others are.
"""

from __future__ import annotations

import math
from collections import Counter
from hashlib import sha256
from itertools import pairwise
from typing import Annotated, Literal

import msgspec
import numpy as np

from navbake.episodes.episode import (
    FLY_TASK,
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    Length,
    Record,
)
from navbake.episodes.goals import VIEW_POINT_SPACING
from navbake.errors import ConfigError, QueryError
from navbake.known_names import suggest
from navbake.types import Float, Vector3
from navbake.voxels.finder import FlightPath, VoxelFinder
from navbake.voxels.grid import VoxelGrid

MAX_FAILURES = 2000  # a draw ends after this many pairs in a row that the rules refuse
PAIRS_PER_DRAW = 64  # pairs that are drawn at once


class FlightRules(Record, frozen=True, kw_only=True):
    """The rules by which starts and goals of flights are drawn."""

    min_distance: Length = 1.0  #: Least length of the shortest way [m].
    max_distance: Length | None = None  #: Largest length of the shortest way [m].
    min_ratio: Annotated[float, msgspec.Meta(ge=1)] = 1.0
    """Least ratio of the lengths of the shortest way and of the straight line."""
    reach: Length = 0.2  #: How near to the goal counts as reached, through the air [m].


class FlightSettings(Record, frozen=True, kw_only=True):
    """Where the ball of a set's flights may be, beside its radius: arguments of `VoxelFinder`."""

    min_height: float | None = None  #: Least world z of its middle [m]; None for any.
    max_height: float | None = None  #: Greatest world z of its middle [m]; None for any.
    unknown: Literal["occupied", "free"] = "occupied"  #: What unknown voxels count as.


def make_flight_rules(**rules: object) -> FlightRules:
    """Make rules of flights from values of fields of `FlightRules`, which may be texts.

    Args:
        rules: name of a field -> its value; the others keep their defaults.

    Returns:
        The rules.

    Raises:
        ConfigError: there is no such rule, or a value doesn't fit.
    """
    rule_names = FlightRules.__struct_fields__
    for name in rules:
        if name not in rule_names:
            hint = suggest(name, rule_names, len(rule_names))
            raise ConfigError(f"no rule {name!r} of flights: {hint}")
    try:
        return msgspec.convert(rules, FlightRules, strict=False)
    except msgspec.ValidationError as error:
        raise ConfigError(str(error)) from error


def make_flight_episodes(
    finder: VoxelFinder,
    rules: FlightRules | None = None,
    *,
    count: int = 100,
    seed: int = 0,
    scene: str = "scene",
    file: str | None = None,
) -> EpisodeSet:
    """Draw episodes of flights. All can be solved, and equal arguments give equal sets.

    Starts and goals are uniform by volume over where the ball fits. An episode's ``distance`` is
    the length of the straight line where the ball can fly along it, else of the shortest route over
    voxels, as `VoxelFinder.find_path` has it in ``cost``. Its ``path`` is the shortened path, with
    a point every 0.25 m or nearer.

    Args:
        finder: the voxels and the ball; its ``cost_of_clearance`` must be 0, since distances are
            lengths.
        rules: which starts and goals are taken; None for the defaults of `FlightRules`.
        count: number of episodes, >= 1. There are fewer if the rules refuse 2,000 pairs in a row.
        seed: seed of the draw, >= 0.
        scene: id of the scene, on which the draw depends, too.
        file: name of the file of the voxels, for the header.

    Returns:
        The set. Its header has a digest of the voxels, the ball, the rules, and how many draws each
        rule refused.

    Raises:
        QueryError: no episode could be drawn, the finder has a cost of clearance, or a number is
            out of range.

    Example:
        >>> voxels = navbake.create_voxel_grid(navbake.samples.path("house"), res=0.1)
        >>> finder = navbake.VoxelFinder(voxels, radius=0.25)
        >>> episodes = make_flight_episodes(finder, count=50, seed=1, scene="house")
        >>> write_episodes(episodes, "flights.jsonl")
    """
    if finder.cost_of_clearance:
        expected = "a finder without `cost_of_clearance`: distances are lengths"
        raise QueryError(
            f"expected {expected}, got {finder.cost_of_clearance:g}",
            key="cost_of_clearance",
            value=finder.cost_of_clearance,
            expected=expected,
        )
    for name, value, minimum in (("count", count, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or value < minimum:
            raise QueryError(f"expected a {name} >= {minimum}, got {value!r}")
    rules = rules or FlightRules()
    scene_hash = sha256(scene.encode()).digest()
    rng = np.random.default_rng([int(seed), int.from_bytes(scene_hash[:8], "big")])
    rejected = Counter[str]()
    episodes: list[Episode] = []
    num_failures = 0  # in a row
    while len(episodes) < count and num_failures < MAX_FAILURES:
        pairs = finder.random_point(rng, 2 * PAIRS_PER_DRAW).reshape(-1, 2, 3)
        headings = rng.uniform(-math.pi, math.pi, len(pairs))
        for (start, goal), heading in zip(pairs, headings.tolist(), strict=True):
            straight = math.dist(start, goal)
            flight = None
            # parts of the air that nothing connects would be searched to their ends
            if finder.island_at(start) == finder.island_at(goal):
                flight = finder.find_path(start, goal)
            if flight is None:
                rejected["no path"] += 1
                num_failures += 1
                continue
            # over voxels, a flight is longer than the straight line, even where nothing is between
            distance = straight if finder.sees(start, goal) else flight.cost
            reason = _find_reason(distance, straight, rules)
            if reason is not None:
                rejected[reason] += 1
                num_failures += 1
                continue
            num_failures = 0
            episodes.append(
                Episode(
                    id=str(len(episodes)),
                    scene=scene,
                    task=FLY_TASK,
                    start=_to_vector(start),
                    heading=heading,
                    goals=(Goal(position=_to_vector(goal), radius=rules.reach),),
                    distance=distance,
                    straight=straight,
                    path=list_flight_points(flight),
                )
            )
            if len(episodes) == count:
                break
    if not episodes:
        count_texts = [f"{num_draws} {reason}" for reason, num_draws in rejected.most_common()]
        raise QueryError(f"no flight in {scene!r} keeps the rules: {', '.join(count_texts)}")
    settings = FlightSettings(
        min_height=finder.min_height, max_height=finder.max_height, unknown=finder.unknown
    )
    sampler = {"task": {"name": FLY_TASK}, "rules": rules, "count": int(count), "flight": settings}
    header = Header(
        agent=Agent(radius=finder.radius, height=2.0 * finder.radius),
        grids=(GridEntry(scene=scene, digest=digest_of_voxels(finder.voxels), file=file),),
        sampler=msgspec.to_builtins(sampler),
        seed=int(seed),
        rejected=dict(sorted(rejected.items())),
    )
    return EpisodeSet(header, tuple(episodes))


def _find_reason(distance: float, straight: float, rules: FlightRules) -> str | None:
    """Return the reason for which the rules refuse a flight; None if they take it.

    Args:
        distance: length of the shortest way from its start to its goal [m].
        straight: length of the straight line [m].
        rules: the rules.
    """
    if distance < rules.min_distance:
        return "too near"
    if rules.max_distance is not None and distance > rules.max_distance:
        return "too far"
    if distance < rules.min_ratio * straight:
        return "too straight"
    return None


def list_flight_points(flight: FlightPath) -> tuple[Vector3, ...]:
    """List a path's points, and points between them, so that each is at most 0.25 m from the next.

    Args:
        flight: the path.

    Returns:
        World x, y, z of the points [m].
    """
    points = [flight.positions[:1]]
    for begin, end in pairwise(flight.positions):
        num_parts = math.ceil(math.dist(begin, end) / VIEW_POINT_SPACING)
        points.append(np.linspace(begin, end, num_parts + 1)[1:])
    return tuple(_to_vector(point) for point in np.concatenate(points))


def _to_vector(position: Float) -> Vector3:
    """Return x, y and z of a position, shape (3,), as numbers that JSON takes."""
    x, y, z = position.tolist()
    return x, y, z


def digest_of_voxels(voxels: VoxelGrid) -> str:
    """Compute a SHA-256, in hexadecimal, of the parts of voxels that flights depend on.

    These are the place, edge and counts of the voxels, and which of them are occupied or unknown.

    Args:
        voxels: the voxels.

    Returns:
        64 hexadecimal digits.
    """
    digest = sha256(repr((voxels.origin, voxels.res, voxels.shape)).encode())
    digest.update(np.packbits(voxels.occupied).tobytes())
    if voxels.known is not None:
        digest.update(np.packbits(voxels.known).tobytes())
    return digest.hexdigest()


def make_flight_finder(
    episodes: EpisodeSet, voxels: VoxelGrid, *, force: bool = False
) -> VoxelFinder:
    """Make the finder that a set of flights was drawn with.

    Args:
        episodes: the set.
        voxels: the voxels that it was drawn in.
        force: take other voxels, too.

    Returns:
        A finder in the voxels, for the set's ball and heights.

    Raises:
        QueryError: the set was drawn in other voxels, or its header doesn't say for which ball.
    """
    agent = episodes.header.agent
    if agent is None:
        raise QueryError("the set doesn't say for which ball its flights are: expected a radius")
    digests = [grid_entry.digest for grid_entry in episodes.header.grids]
    digest = digest_of_voxels(voxels)
    if not force and digest not in digests:
        digests_text = ", ".join(entry_digest[:12] for entry_digest in digests) or "none"
        raise QueryError(
            f"the set was made in other voxels (digest {digests_text}, these have {digest[:12]}): "
            "make them with the settings of then, or force it"
        )
    try:
        settings = msgspec.convert(episodes.header.sampler.get("flight", {}), FlightSettings)
    except msgspec.ValidationError as error:
        raise QueryError(f"{error} of the set's header, in its sampler's `flight`") from error
    return VoxelFinder(
        voxels, agent.radius, settings.min_height, settings.max_height, unknown=settings.unknown
    )
