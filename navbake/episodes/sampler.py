"""Draws episodes on grids by rules that can be named, stored and counted."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from typing import Annotated, Any

import msgspec
import numpy as np

from navbake.episodes.episode import (
    TASKS,
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    Length,
    digest_of,
    scene_of,
)
from navbake.episodes.goals import GoalFinder, Target, agent_of, fit_grid
from navbake.errors import ConfigError, QueryError
from navbake.known_names import suggest
from navbake.navgrid.grid import NavGrid
from navbake.runtime.path_finder import PathFinder
from navbake.types import Float, Int, Int32

BARREN = 200  # goals in a row that may give no episode before the draw ends
NEAR_STRAIGHT = 0.98  # of habitat's rule: pairs with a ratio r are kept with 20 (r - 0.98)²
STEEPNESS = 20.0
MEASURES = ("distance", "ratio", "doors", "rooms", "levels")
EDGES: dict[str, tuple[float, ...]] = {
    "distance": (1.0, 3.0, 6.0, 10.0, 20.0, 40.0),
    "ratio": (1.0, 1.1, 1.25, 1.5, 2.0),
    "doors": (0.0, 1.0, 2.0, 3.0, 5.0),
    "rooms": (1.0, 2.0, 3.0, 4.0, 6.0),
    "levels": (0.0, 1.0, 2.0),
}
OUTCOMES = (
    "island too small", "no path", "too near", "too far", "too steep", "another level",
    "too straight", "straight, by chance", "stratum full",
)  # fmt: skip
"""Why a start is refused, in the order in which the rules are asked."""


class Rules(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The rules of a sampler.

    Attributes:
        name: of the preset that they began as.
        min_distance, max_distance: of the shortest path [m].
        max_rise: between the floors of start and goal [m].
        same_level: start and goal are on one level.
        min_ratio: of the path's length to the straight line's, >= 1.
        soft_ratio: pairs with a smaller ratio r are kept with probability 20 (r - 0.98)².
        min_island: radius of the disc round the island's middle that holds it [m].
        tries: starts drawn for a goal until one is accepted.
        goals: how many goals are drawn for a scene, at most and as far as enough are accepted; an
            episode a goal where fewer episodes are asked for. Starts share a goal's field.
        paths: list doors and rooms along each path.
        strata: draw as many episodes in each class of this measure; one of `MEASURES`.
        edges: lower edges of the classes.
    """

    name: str = "uniform"
    min_distance: Length = 1.0
    max_distance: Length | None = None
    max_rise: Length | None = None
    same_level: bool = False
    min_ratio: Annotated[float, msgspec.Meta(ge=1)] = 1.0
    soft_ratio: Annotated[float, msgspec.Meta(ge=1)] | None = None
    min_island: Length = 0.0
    tries: Annotated[int, msgspec.Meta(ge=1)] = 10
    goals: Annotated[int, msgspec.Meta(ge=1)] = 100
    paths: bool = False
    strata: str | None = None
    edges: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.strata is not None and self.strata not in MEASURES:
            wanted = ", ".join(MEASURES)
            raise ValueError(f"expected one of {wanted} as strata, got {self.strata!r}")
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


class Task(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the episodes of a set ask for.

    Attributes:
        name: one of `TASKS`.
        objects: patterns of the objects' names, or patterns by category; all by the categories
            that their names say unless given.
        rooms: patterns of rooms' ids or names; all but the outdoors unless given.
        radius: how near counts as reached, or how far the agent sees of what it explores [m]:
            0.2 of a point, 0.1 of a view point, 3.0 to explore unless given.
        view_distance: how far from an object it may be seen from [m].
        length: number of goals of a sequence, >= 2.
        share: of the free area of the start's island that is to be explored.
    """

    name: str = "point"
    objects: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    rooms: tuple[str, ...] = ()
    radius: Length | None = None
    view_distance: Length = 1.0
    length: Annotated[int, msgspec.Meta(ge=2)] = 3
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.9

    def __post_init__(self) -> None:
        if self.name not in TASKS:
            raise ValueError(f"expected one of {', '.join(TASKS)} as task, got {self.name!r}")

    @property
    def reach(self) -> float:
        """The radius, or what it is unless given [m]."""
        known = {"object": 0.1, "room": 0.0, "explore": 3.0}
        return known.get(self.name, 0.2) if self.radius is None else self.radius


class Splits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parts of a set: their shares, and whether a scene or a room of the start is in one whole."""

    shares: dict[str, Annotated[float, msgspec.Meta(gt=0)]] = {}
    by: str = "scene"

    def __post_init__(self) -> None:
        if self.by not in ("scene", "room"):
            raise ValueError(f"expected scene or room to split by, got {self.by!r}")

    def of(self, seed: int, scene: str, room: str | None) -> str | None:
        """The part that a scene or a room is in: by its name and the seed alone."""
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
    rules: Rules = _convert({**msgspec.to_builtins(before), **changes}, Rules)
    return rules


def make_task(name: str = "point", **given: Any) -> Task:
    """A task; raises a ConfigError for what doesn't fit, see `Task`."""
    task: Task = _convert({"name": name, **given}, Task)
    return task


def make_splits(shares: Mapping[str, float], by: str = "scene") -> Splits:
    """Parts of a set; raises a ConfigError for what doesn't fit, see `Splits`."""
    splits: Splits = _convert({"shares": shares, "by": by}, Splits)
    return splits


def _convert(values: Mapping[str, Any], kind: Any) -> Any:
    try:
        return msgspec.convert(dict(values), kind, strict=False)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(str(error)) from error


def make_episodes(
    grids: NavGrid | Sequence[NavGrid],
    task: str | Task = "point",
    sampler: str | Rules = "uniform",
    *,
    count: int = 100,
    seed: int = 0,
    radius: float | None = None,
    height: float | None = None,
    speed: float | None = None,
    splits: Splits | None = None,
    files: Sequence[str | None] = (),
) -> EpisodeSet:
    """Draw episodes on grids; all can be solved, and the same arguments give the same set.

    Each scene is drawn by itself, from the seed and its id, so other scenes change nothing in it.

    Args:
        grids: one or several, of different scenes.
        task: what is to be done; the name of one is that with its defaults.
        sampler: by which rules.
        count: episodes in all, as many of each scene, >= 1. There may be fewer where the rules
            refuse too much: 200 goals in a row without an episode end a scene.
        seed: of the draw, >= 0.
        radius: of the agent; grids are inflated for it if need be [m].
        height: of the agent, at most the grids' [m].
        speed: of the agent, as a note in the header [m/s].
        splits: parts of the set.
        files: the grids' names in the header.

    Raises:
        QueryError: there is no episode, no such object or room, the agent is too high, or two
            grids are of one scene.
        ConfigError: there is no such task or sampler.
    """
    scenes = [grids] if not isinstance(grids, Sequence) else list(grids)
    wanted = task if isinstance(task, Task) else make_task(task)
    rules, parts = make_rules(sampler), splits or Splits()
    for name, value, least in (("count", count, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or value < least:
            raise QueryError(f"expected a {name} >= {least}, got {value!r}")
    if not scenes or len({scene_of(grid) for grid in scenes}) < len(scenes):
        names = sorted(scene_of(grid) for grid in scenes)
        raise QueryError(f"expected grids of different scenes, got {', '.join(names) or 'none'}")
    episodes: list[Episode] = []
    entries, agents, rejected = [], [], Counter[str]()
    for k, given in enumerate(scenes):
        grid = fit_grid(given, radius, height)
        share = count // len(scenes) + (k < count % len(scenes))
        draw = _Draw(grid, wanted, rules, int(seed), parts)
        episodes += draw.run(share, first=len(episodes))
        rejected.update(draw.rejected)
        file = files[k] if k < len(files) else None
        entries.append(GridEntry(scene=scene_of(grid), digest=digest_of(grid), file=file))
        agents.append(agent_of(grid, speed))
    if len(set(agents)) > 1:
        sizes = ", ".join(sorted({f"{a.radius:g} x {a.height:g} m" for a in agents}))
        raise QueryError(f"the grids are for agents of several sizes ({sizes}): give a radius")
    agent = agents[0]
    if height is not None:
        agent = Agent(radius=agent.radius, height=float(height), speed=speed)
    if not episodes:
        why = ", ".join(f"{n} {reason}" for reason, n in rejected.most_common()) or "nothing drawn"
        raise QueryError(f"no episode of {scene_of(scenes[0])!r} keeps the rules: {why}")
    made_by = {"task": msgspec.to_builtins(wanted), "rules": msgspec.to_builtins(rules)}
    made_by |= {"count": int(count), "splits": msgspec.to_builtins(parts)}
    header = Header(
        agent=agent, grids=tuple(entries), sampler=made_by, seed=int(seed),
        rejected=dict(sorted(rejected.items())),
    )  # fmt: skip
    return EpisodeSet(header, tuple(episodes))


class _Draw:
    """The draw of one scene's episodes."""

    def __init__(self, grid: NavGrid, task: Task, rules: Rules, seed: int, parts: Splits) -> None:
        self.task, self.rules, self.seed, self.parts = task, rules, seed, parts
        self.scene = scene_of(grid)
        self.finder = PathFinder(grid)
        self.goals = GoalFinder(
            self.finder, task.objects, task.rooms, task.reach, task.view_distance
        )
        name = sha256(self.scene.encode()).digest()
        self.rng = np.random.default_rng([seed, int.from_bytes(name[:8], "big")])
        self.rejected = Counter[str]()
        self.radii = _island_radii(self.finder)
        self.strata = rules.edges or EDGES[rules.strata] if rules.strata else (0.0,)
        self.filled = np.zeros(len(self.strata), dtype=np.int64)

    def run(self, count: int, first: int) -> list[Episode]:
        """Draw so many episodes; the first has the id `first`."""
        found: list[Episode] = []
        if not self.finder.search.flat.free.any():
            raise QueryError(f"no agent can stand anywhere in {self.scene!r}")
        each = math.ceil(count / self.rules.goals)
        # as many in each class; the first take what is left over
        self.quota = np.full(len(self.strata), count // len(self.strata))
        self.quota[: count % len(self.strata)] += 1
        barren = 0
        while len(found) < count and barren < BARREN:
            target = self._draw_target()
            new = [] if target is None else self._draw_starts(target, each)
            barren = 0 if new else barren + 1
            for episode in new:
                found.append(msgspec.structs.replace(episode, id=str(first + len(found))))
        return found

    def _draw_target(self) -> Target | None:
        """Draw what is to be reached; None where it can't be, which is counted."""
        task, rng, goals = self.task.name, self.rng, self.goals
        if task == "explore":
            goal = Goal(share=self.task.share, radius=self.task.reach)
            return Target((goal,), np.empty((0, 3)), np.empty(0), 0)
        if task in ("object", "room"):
            known: list[Any] = list(goals.categories if task == "object" else goals.room_goals)
            if not known:
                raise QueryError(f"no {task} in {self.scene!r} to set as a goal")
            chosen = known[int(rng.integers(len(known)))]
            options = goals.object_goals(chosen) if task == "object" else [chosen]
            target = goals.target_of(options) if options else None
            if target is None:
                self.rejected["not in sight" if task == "object" else "no place in the room"] += 1
            return target
        places = self.finder.random_point(rng, self.task.length if task == "sequence" else 1)
        targets = [goals.target_of([goals.point(place)]) for place in places]
        first = targets[0]
        assert first is not None  # places are free
        if task == "point":
            return first
        along = self.finder.search.flat.cells_at(places)
        legs = np.array([t.field[c] for t, c in zip(targets[1:], along, strict=False) if t])
        if not np.isfinite(legs).all() or (legs < self.rules.min_distance).any():
            self.rejected["too near" if np.isfinite(legs).all() else "no path"] += 1
            return None
        air = np.linalg.norm(np.diff(places, axis=0), axis=1)
        ordered = tuple(goals.point(place) for place in places)
        beyond = float(legs.sum()), float(air.sum())
        return Target(ordered, first.places, first.field, first.island, beyond)

    def _draw_starts(self, target: Target, count: int) -> list[Episode]:
        """Draw starts for a target: `tries` for each of `count` episodes, the first that fits."""
        rules, search = self.rules, self.finder.search
        flat = search.flat
        starts = self.finder.random_point(self.rng, count * rules.tries)
        headings, chance = self.rng.uniform(
            [[-math.pi], [0.0]], [[math.pi], [1.0]], (2, len(starts))
        )
        cells, distance = flat.cells_at(starts), np.full(len(starts), np.nan)
        straight, level = distance.copy(), flat.level_of(flat.cells_at(starts))
        goal_level, rise = level, np.zeros(len(starts))
        if len(target.places):
            distance = target.field[cells] + target.beyond[0]
            air, nearest = target.tree.query(starts)
            straight = air + target.beyond[1]
            goal_level = flat.level_of(flat.cells_at(target.places[nearest]))
            rise = np.abs(starts[:, 2] - target.places[nearest, 2])
        outcome = self._judge(search.islands.number[cells], distance, straight, chance)
        for reason, is_refused in (
            ("too steep", rise > (np.inf if rules.max_rise is None else rules.max_rise)),
            ("another level", rules.same_level & (level != goal_level)),
        ):
            outcome[(outcome < 0) & is_refused] = OUTCOMES.index(reason)
        rooms = search.rooms
        found = []
        for row in np.arange(len(starts)).reshape(count, rules.tries):
            if self.filled.sum() >= self.quota.sum():
                break
            for k in row.tolist():
                if outcome[k] >= 0:
                    self.rejected[OUTCOMES[outcome[k]]] += 1
                    continue
                room = rooms.id_of(int(rooms.number[cells[k]]))
                known = bool(np.isfinite(distance[k]))
                x, y, z = starts[k].tolist()
                episode = Episode(
                    id="", scene=self.scene, task=self.task.name, start=(x, y, z),
                    heading=float(headings[k]), goals=target.goals,
                    distance=float(distance[k]) if known else None,
                    straight=float(straight[k]) if known else None,
                    split=self.parts.of(self.seed, self.scene, room), room=room,
                    levels=(int(level[k]), int(goal_level[k])),
                )  # fmt: skip
                if rules.paths or rules.strata in ("doors", "rooms"):
                    episode = self._with_path(episode, target)
                if self._fits_strata(episode):
                    found.append(episode)
                    break
                self.rejected["stratum full"] += 1
        return found

    def _judge(self, island: Int32, distance: Float, straight: Float, chance: Float) -> Int:
        """Which rule refuses each start, by its place in `OUTCOMES`; -1 for none."""
        rules, outcome = self.rules, np.full(len(distance), -1)
        refused = {"island too small": self.radii[island] < rules.min_island}
        if not np.isnan(distance).all():
            # a start at the goal goes straight; on a stair the line through the air may be longer
            air = np.where(straight > 0, straight, np.inf)
            ratio = np.where(straight > 0, np.maximum(distance / air, 1.0), 1.0)
            farthest = np.inf if rules.max_distance is None else rules.max_distance
            refused |= {
                "no path": ~np.isfinite(distance),
                "too near": distance < rules.min_distance,
                "too far": distance > farthest,
                "too straight": ratio < rules.min_ratio,
            }
            if rules.soft_ratio is not None:
                kept = STEEPNESS * (ratio - NEAR_STRAIGHT) ** 2
                refused["straight, by chance"] = (ratio < rules.soft_ratio) & (chance > kept)
        for reason, mask in refused.items():
            outcome[(outcome < 0) & mask] = OUTCOMES.index(reason)
        return outcome

    def _with_path(self, episode: Episode, target: Target) -> Episode:
        """The episode with the doors and rooms along its way."""
        stops: list[Any] = [goal.position for goal in target.goals]
        if self.task.name in ("object", "room"):
            stops = [target.places]
        doors: list[str] = []
        rooms: list[str] = []
        here = np.array(episode.start)
        for stop in stops if self.task.name != "explore" else []:
            path = self.finder.find_path(here, stop)
            assert path is not None  # its length is known
            doors += path.doors
            rooms += path.rooms[bool(rooms) and rooms[-1:] == path.rooms[:1] :]
            here = path.positions[-1]
        return msgspec.structs.replace(episode, doors=tuple(doors), rooms=tuple(rooms))

    def _fits_strata(self, episode: Episode) -> bool:
        """Whether its class takes one more; then it is counted."""
        number = 0
        if self.rules.strata is not None:
            doors, rooms = episode.doors or (), episode.rooms or ()
            value = {
                "distance": episode.distance or 0.0, "ratio": episode.ratio or 1.0,
                "doors": len(doors), "rooms": len(rooms),
                "levels": abs(episode.levels[0] - episode.levels[-1]),
            }[self.rules.strata]  # fmt: skip
            number = int(np.searchsorted(self.strata, value, side="right")) - 1
        if number < 0 or self.filled[number] >= self.quota[number]:
            return False
        self.filled[number] += 1
        return True


def _island_radii(finder: PathFinder) -> Float:
    """Radius of the disc round each island's middle that holds it [m]; shape (count + 1,)."""
    search = finder.search
    cells = np.flatnonzero(search.flat.free)
    number, points = search.islands.number[cells], search.flat.positions(cells)
    size = np.maximum(np.bincount(number, minlength=search.islands.count + 1), 1)
    middle = np.stack([np.bincount(number, v, len(size)) / size for v in points.T], axis=1)
    radii = np.zeros(len(size))
    np.maximum.at(radii, number, np.linalg.norm(points - middle[number], axis=1))
    return radii


def shares_of(texts: Iterable[str]) -> dict[str, float]:
    """Read shares of splits, ``NAME=SHARE`` each; raises a ConfigError."""
    shares = {}
    for text in texts:
        name, _, share = text.partition("=")
        try:
            shares[name] = float(share)
        except ValueError as error:
            raise ConfigError(f"expected NAME=SHARE as a split, got {text!r}") from error
    return shares
