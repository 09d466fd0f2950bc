"""Draws episodes on grids by rules that can be named, stored and counted."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from hashlib import sha256
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, TypeVar

import msgspec
import numpy as np

from navbake.episodes.episode import (
    EDGES,
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    Length,
    Record,
    check_word,
    digest_of,
    named_agent,
    scene_of,
)
from navbake.episodes.goals import GoalFinder, Stops, Task, find_stops, path_through
from navbake.errors import ConfigError, QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid import links
from navbake.navgrid.grid import NavGrid
from navbake.runtime.blocking import fit_grid
from navbake.runtime.path_finder import PathFinder
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    from typing_extensions import Unpack

Kind = TypeVar("Kind")
spatial = lazy("scipy.spatial")  # saves scipy at start-up

MAX_FAILURES = 200  # goals in a row without an episode, after which a scene's draw ends


class Rules(Record, frozen=True, kw_only=True):
    """The rules of a sampler."""

    name: str = "uniform"  #: Of the preset.
    min_distance: Length = 1.0
    """Of the shortest path, and of each leg between points or objects of a sequence [m]."""
    max_distance: Length | None = None  #: Of the shortest path [m].
    max_rise: Length | None = None  #: Between the floors of start and goal [m].
    same_level: bool = False  #: Start and goal are on one level.
    min_ratio: Annotated[float, msgspec.Meta(ge=1)] = 1.0  #: Of path and straight line.
    soft_ratio: Annotated[float, msgspec.Meta(ge=1)] | None = None
    """Pairs with a smaller ratio r are kept with probability 20 (r - 0.98)²."""
    min_island: Length = 0.0  #: Radius of the disc round the island's middle that holds it [m].
    tries: Annotated[int, msgspec.Meta(ge=1)] = 10  #: Starts drawn for an episode, at most.
    goals: Annotated[int, msgspec.Meta(ge=1)] = 100
    """Goals that share the episodes of a scene; more are drawn where rules refuse starts. Starts
    share a goal's distance field."""
    paths: bool = False  #: Keep each path, and the doors and rooms along it.
    headings: str = "random"  #: Of starts: ``random``, to the ``goal``, or ``away`` from it.
    strata: str | None = None  #: A key of `EDGES`: as many episodes in each of its classes.
    edges: tuple[float, ...] = ()  #: Lower edges of the classes.

    def __post_init__(self) -> None:
        check_word(self.headings, ("random", "goal", "away"), "headings")
        check_word(self.strata or "distance", EDGES, "strata")
        if list(self.edges) != sorted(set(self.edges)):
            raise ValueError(f"expected ascending edges, got {self.edges}")


PRESETS = {
    "uniform": Rules(),
    "habitat": Rules(
        name="habitat", max_distance=30.0, max_rise=0.5, soft_ratio=1.1, min_island=1.5
    ),
    "stratified": Rules(name="stratified", strata="distance"),
    "minos": Rules(name="minos", same_level=True, paths=True),
}
"""Samplers by their names."""


class Splits(Record, frozen=True, kw_only=True):
    """Parts of a set by their shares; a scene, or a room with its starts, is in one part."""

    shares: dict[str, Annotated[float, msgspec.Meta(gt=0)]] = msgspec.field(default_factory=dict)
    by: str = "scene"

    def __post_init__(self) -> None:
        if self.by not in ("scene", "room"):
            raise ValueError(f"expected scene or room to split by, got {self.by!r}")

    def of(self, seed: int, scene: str, room: str | None) -> str | None:
        """The part of a scene or a room, which follows from its name and the seed alone."""
        if not self.shares:
            return None
        key = repr((seed, scene, room if self.by == "room" else None))
        at = int.from_bytes(sha256(key.encode()).digest()[:8], "big") / 2.0**64
        edges = np.cumsum(list(self.shares.values()))
        return list(self.shares)[int(np.searchsorted(edges / edges[-1], at, side="right"))]


def make_rules(sampler: str | Rules = "uniform", **changes: Any) -> Rules:
    """The rules of a preset with some changed; texts are read as the rule's type.

    Raises:
        ConfigError: there is no such preset or rule, or a value doesn't fit.
    """
    if isinstance(sampler, str) and sampler not in PRESETS:
        raise ConfigError(f"no sampler {sampler!r}: {suggest(sampler, PRESETS)}")
    before = sampler if isinstance(sampler, Rules) else PRESETS[sampler]
    known = Rules.__struct_fields__
    for key in changes:
        if key not in known:
            raise ConfigError(f"no rule {key!r} of a sampler: {suggest(key, known, len(known))}")
    return _convert({**msgspec.to_builtins(before), **changes}, Rules)


def make_task(name: str = "point", **given: Any) -> Task:
    """A task; raises a ConfigError for what doesn't fit, see `Task`."""
    return _convert({"name": name, **given}, Task)


def make_splits(shares: Mapping[str, float | str], by: str = "scene") -> Splits:
    """Parts of a set; raises a ConfigError for what doesn't fit, see `Splits`."""
    return _convert({"shares": shares, "by": by}, Splits)


def _convert(values: dict[str, Any], kind: type[Kind]) -> Kind:
    try:
        return msgspec.convert(values, kind, strict=False)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(str(error)) from error


class AgentChoice(TypedDict, total=False):
    """For whom episodes are drawn; the grids' own agent unless given."""

    radius: float | None  #: Grids are inflated for it if need be [m].
    height: float | None  #: At most the grids' [m].
    speed: float | None  #: For the header [m/s].
    agent: str | None  #: The name of one of the grids' agents, in place of size and speed.


def make_episodes(
    grids: NavGrid | Sequence[NavGrid],
    task: str | Task = "point",
    sampler: str | Rules = "uniform",
    *,
    count: int = 100,
    seed: int = 0,
    splits: Splits | None = None,
    files: Sequence[str | None] = (),
    **choice: Unpack[AgentChoice],
) -> EpisodeSet:
    """Draw episodes on grids; all can be solved, and the same arguments give the same set.

    Each scene is drawn by itself, from the seed and its id, so other scenes change nothing in it.

    Args:
        grids: one or several, of different scenes.
        task: what is to be done, or its name.
        sampler: the rules, or the name of a preset.
        count: episodes in all, as many of each scene, >= 1; fewer where the rules refuse too much:
            200 goals in a row without an episode end a scene.
        seed: of the draw, >= 0.
        splits: parts of the set.
        files: the grids' names, for the header.
        choice: for whom, see `AgentChoice`.

    Raises:
        QueryError: there is no episode, no such object or room, the agent is too high, or two
            grids are of one scene.
        ConfigError: there is no such task or sampler.
    """
    if unknown := choice.keys() - AgentChoice.__annotations__.keys():
        raise TypeError(f"make_episodes() got an unexpected keyword argument {min(unknown)!r}")
    radius = choice.get("radius")
    height = choice.get("height")
    speed = choice.get("speed")
    agent = choice.get("agent")
    scenes = list(grids) if isinstance(grids, Sequence) else [grids]
    wanted = task if isinstance(task, Task) else make_task(task)
    rules = make_rules(sampler)
    parts = splits or Splits()
    for what, value, least in (("count", count, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or value < least:
            raise QueryError(f"expected a {what} >= {least}, got {value!r}")
    names = [scene_of(grid) for grid in scenes]
    if not scenes or len(set(names)) < len(names):
        got = ", ".join(sorted(names)) or "none"
        raise QueryError(f"expected grids of different scenes, got {got}")
    found: list[Episode] = []
    entries = []
    agents = set()
    rejected = Counter[str]()
    for k, (scene, given) in enumerate(zip(names, scenes, strict=True)):
        planner = named_agent(given, agent, radius, height)
        grid = fit_grid(given, planner)
        any_size = planner.of_any_size() if agent else None
        draw = _Draw(grid, wanted, rules, int(seed), parts, any_size)
        found += draw.run(count // len(scenes) + (k < count % len(scenes)))
        rejected.update(draw.rejected)
        file = files[k] if k < len(files) else None
        entries.append(GridEntry(scene=scene, digest=digest_of(grid), file=file))
        tall = grid.agent_height if planner.height is None else float(planner.height)
        agents.add((grid.radius, tall, planner.speed if agent else speed))
    if len(agents) > 1:
        sizes = ", ".join(f"{r:g} x {h:g} m" for r, h in sorted({size[:2] for size in agents}))
        raise QueryError(f"the grids are for agents of several sizes ({sizes}): give a radius")
    if not found:
        why = ", ".join(f"{n} {reason}" for reason, n in rejected.most_common()) or "nothing drawn"
        raise QueryError(f"no episode of {names[0]!r} keeps the rules: {why}")
    ((own_radius, own_height, own_speed),) = agents
    made_by = {"task": wanted, "rules": rules, "count": int(count), "splits": parts}
    name = agent or msgspec.UNSET
    header = Header(
        agent=Agent(radius=own_radius, height=own_height, speed=own_speed, name=name),
        grids=tuple(entries), sampler=msgspec.to_builtins(made_by), seed=int(seed),
        rejected=dict(sorted(rejected.items())),
    )  # fmt: skip
    numbered = (msgspec.structs.replace(e, id=str(k)) for k, e in enumerate(found))
    return EpisodeSet(header, tuple(numbered))


class _Draw:
    """The draw of one scene's episodes."""

    def __init__(
        self,
        grid: NavGrid,
        task: Task,
        rules: Rules,
        seed: int,
        splits: Splits,
        agent: links.Agent | None,
    ) -> None:
        self.task = task
        self.rules = rules
        self.seed = seed
        self.splits = splits
        self.scene = scene_of(grid)
        self.finder = PathFinder(grid, agent=agent)
        self.goals = GoalFinder(self.finder, task)
        name = sha256(self.scene.encode()).digest()
        self.rng = np.random.default_rng([seed, int.from_bytes(name[:8], "big")])
        self.rejected = Counter[str]()
        # radius of the disc round each island's middle that holds it [m]
        search = self.finder.search
        cells = np.flatnonzero(search.flat.free)
        number = search.islands.number[cells]
        points = search.flat.positions(cells)
        size = np.maximum(np.bincount(number, minlength=search.islands.count + 1), 1)
        middle = np.stack([np.bincount(number, v, len(size)) / size for v in points.T], axis=1)
        self.radii = np.zeros(len(size))
        np.maximum.at(self.radii, number, np.linalg.norm(points - middle[number], axis=1))
        self.edges = rules.edges or EDGES[rules.strata] if rules.strata else (0.0,)

    def run(self, count: int) -> list[Episode]:
        """Draw so many episodes, as yet without ids."""
        found: list[Episode] = []
        if not self.finder.search.flat.free.any():
            raise QueryError(f"no agent can stand anywhere in {self.scene!r}")
        per_goal = math.ceil(count / self.rules.goals)
        classes = len(self.edges)
        failures = 0
        # episodes still to be drawn in each class; the first have the remainder
        self.missing = [count // classes + (k < count % classes) for k in range(classes)]
        while len(found) < count and failures < MAX_FAILURES:
            stops = self._draw_stops()
            new = [] if stops is None else self._draw_starts(stops, per_goal)
            failures = 0 if new else failures + 1
            found += new
        return found

    def _draw_stops(self) -> Stops | None:
        """Draw goals; None, counted as rejected, where no episode can have them."""
        task = self.task
        rng = self.rng
        finder = self.finder
        if task.name == "explore":
            return Stops((Goal(share=task.share, radius=task.reach),))
        in_order = task.name == "sequence"
        stages = task.length if in_order else 1
        if task.kind == "point":
            places = finder.random_point(rng, stages)
            goals = [Goal(position=(x, y, z), radius=task.reach) for x, y, z in places.tolist()]
        else:
            labels = list(self.goals.choices)
            if not labels:
                raise QueryError(f"no {task.kind} in {self.scene!r} to set as a goal")
            drawn = rng.choice(len(labels), stages, replace=stages > len(labels))
            options = [self.goals.goals_of(labels[k]) for k in drawn.tolist()]
            goals = options[0]
            if in_order:  # each stage is one object or room
                goals = [each[int(rng.integers(len(each)))] for each in options if each]
        stops = find_stops(finder, goals, in_order=in_order) if len(goals) >= stages else None
        if stops is None:
            why = "not in sight" if task.kind == "object" else "no place in the room"
        elif not math.isfinite(stops.rest[0]):
            why = "no path"
        elif task.kind != "room" and (-np.diff(stops.rest) < self.rules.min_distance).any():
            why = "too near"
        else:
            return stops
        self.rejected[why] += 1
        return None

    def _draw_starts(self, stops: Stops, count: int) -> list[Episode]:
        """Draw starts for goals: `tries` for each of `count` episodes, the first that fits."""
        rules = self.rules
        search = self.finder.search
        flat = search.flat
        rooms = search.rooms
        starts = self.finder.random_point(self.rng, count * rules.tries)
        low = [[-math.pi], [0.0]]
        high = [[math.pi], [1.0]]
        headings, chance = self.rng.uniform(low, high, (2, len(starts)))
        cells = flat.cells_at(starts)
        goals = starts
        distance = straight = np.full(len(starts), np.nan)
        if stops.places:
            straight, nearest = spatial.cKDTree(stops.places[0]).query(starts)
            goals = stops.places[0][nearest]
            distance = stops.fields[0][cells] + stops.rest[0]
            for one, other in pairwise(stops.places):
                straight = straight + spatial.cKDTree(one).query(other)[0].min()
            if rules.headings != "random":
                ahead = goals - starts if rules.headings == "goal" else starts - goals
                headings = np.arctan2(ahead[:, 1], ahead[:, 0])
        levels = np.stack([flat.level_of(cells), flat.level_of(flat.cells_at(goals))], axis=1)
        refused = self._refuse(cells, levels, starts - goals, distance, straight, chance)
        found = []
        for row in np.arange(len(starts)).reshape(count, rules.tries):
            if not any(self.missing):
                break
            for k in row.tolist():
                if why := next((reason for reason, mask in refused.items() if mask[k]), None):
                    self.rejected[why] += 1
                    continue
                room = rooms.id_of(int(rooms.number[cells[k]]))
                episode = Episode(
                    id="", scene=self.scene, task=self.task.name, start=tuple(starts[k].tolist()),
                    heading=float(headings[k]), goals=stops.goals,
                    distance=float(distance[k]) if stops.places else None,
                    straight=float(straight[k]) if stops.places else None,
                    split=self.splits.of(self.seed, self.scene, room), room=room,
                    levels=tuple(levels[k].tolist()),
                )  # fmt: skip
                if rules.paths or rules.strata in ("doors", "rooms"):
                    along = path_through(self.finder, episode.start, stops.places)
                    episode = msgspec.structs.replace(episode, **along)
                # its class has to miss episodes; a ratio that isn't known counts as 1
                value = episode.measures[rules.strata] if rules.strata else 0.0
                value = value or float(rules.strata == "ratio")
                number = int(np.searchsorted(self.edges, value, side="right")) - 1
                if number >= 0 and self.missing[number]:
                    self.missing[number] -= 1
                    found.append(episode)
                    break
                self.rejected["stratum full"] += 1
        return found

    def _refuse(
        self, cells: Int, levels: Int, apart: Float, distance: Float, straight: Float, chance: Float
    ) -> dict[str, Bool]:
        """Which starts each rule refuses, by its name, in the order in which they are counted."""
        rules = self.rules
        island = self.finder.search.islands.number[cells]
        limits = rules.max_distance, rules.max_rise
        farthest, steepest = (math.inf if most is None else most for most in limits)
        # 1 of a start at the goal, and on a stair, where the line through the air may be longer
        ratio = np.where(straight == 0, 1.0, np.nan)
        ratio = np.maximum(np.divide(distance, straight, out=ratio, where=straight > 0), 1.0)
        by_chance = chance > 20.0 * (ratio - 0.98) ** 2
        return {
            "island too small": self.radii[island] < rules.min_island,
            "no path": np.isinf(distance),
            "too near": distance < rules.min_distance,
            "too far": distance > farthest,
            "too straight": ratio < rules.min_ratio,
            "straight, by chance": (ratio < (rules.soft_ratio or 0.0)) & by_chance,
            "too steep": np.abs(apart[:, 2]) > steepest,
            "another level": rules.same_level & (levels[:, 0] != levels[:, 1]),
        }
