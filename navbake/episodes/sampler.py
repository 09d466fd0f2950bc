"""Draws episodes on grids by rules.

The set's header stores the rules, and how many draws each rule refused.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from hashlib import sha256
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypedDict, TypeVar

import msgspec
import numpy as np

from navbake.episodes.episode import (
    CLASS_EDGES,
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    Length,
    Record,
    check_word,
    choose_agent,
    digest_of,
    scene_of,
)
from navbake.episodes.goals import GoalFinder, Stops, Task, find_stops, plan_path_through
from navbake.errors import ConfigError, QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid import links
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.rooms import has_building
from navbake.runtime.agents import fit_grid
from navbake.runtime.flat_grid import check_positive
from navbake.runtime.path_finder import PathFinder
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    from typing_extensions import Unpack

StructT = TypeVar("StructT")
spatial = lazy("scipy.spatial")  # saves scipy at start-up

MAX_FAILURES = 200  # a scene's draw ends after this many goals in a row without an episode


class Rules(Record, frozen=True, kw_only=True):
    """The rules by which a sampler draws episodes."""

    name: str = "uniform"  #: Name of the preset.
    min_distance: Length = 1.0
    """Least length of the shortest path, and of each leg of a sequence of points or objects [m]."""
    max_distance: Length | None = None  #: Largest length of the shortest path [m].
    max_rise: Length | None = None  #: Largest difference of the floors of start and goal [m].
    outdoors: bool = False
    """Whether starts and points that are goals may lie in rooms that are outdoors. They may anyhow
    in a scene without a building (`has_building`), or where no agent can stand in a room."""
    same_level: bool = False  #: Whether start and goal have to be on the same level.
    min_ratio: Annotated[float, msgspec.Meta(ge=1)] = 1.0
    """Least ratio of the lengths of the shortest path and of the straight line."""
    soft_ratio: Annotated[float, msgspec.Meta(ge=1)] | None = None
    """Starts with a smaller ratio r of these lengths are kept with probability 20 (r - 0.98)²."""
    min_island: Length = 0.0
    """Least radius of the start's island [m]: the distance of its farthest cell from its middle."""
    tries: Annotated[int, msgspec.Meta(ge=1)] = 10  #: Most starts that are drawn for an episode.
    goals: Annotated[int, msgspec.Meta(ge=1)] = 100
    """Number of goals that a scene's episodes are divided among: all starts for one goal share its
    distance field, which saves time. More goals are drawn where rules refuse starts."""
    paths: bool = False  #: Whether to keep each path, and the doors and rooms along it.
    headings: str = "random"
    """Headings at starts: ``random``, to the ``goal``, or ``away`` from it."""
    strata: str | None = None
    """A measure of `CLASS_EDGES`: each class of its values gets the same number of episodes."""
    edges: tuple[float, ...] = ()  #: Lower edges of the classes; () for those of `CLASS_EDGES`.

    def __post_init__(self) -> None:
        check_word(self.headings, ("random", "goal", "away"), "headings")
        check_word(self.strata or "distance", CLASS_EDGES, "strata")
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
"""Name of a sampler -> its rules."""


class Splits(Record, frozen=True, kw_only=True):
    """The parts (splits) of a set, and their shares of the scenes or rooms."""

    shares: dict[str, Annotated[float, msgspec.Meta(gt=0)]] = msgspec.field(default_factory=dict)
    """Name of a part -> its share, relative to the sum of all."""
    by: str = "scene"  #: ``scene`` or ``room``: what is never divided between two parts.

    def __post_init__(self) -> None:
        if self.by not in ("scene", "room"):
            raise ValueError(f"expected scene or room to split by, got {self.by!r}")

    def of(self, seed: int, scene: str, room: str | None) -> str | None:
        """Return the part that a scene or a room belongs to; it depends only on id and seed.

        Args:
            seed: the seed of the draw.
            scene: the id of the scene.
            room: the id of the start's room; ignored if `by` is ``scene``.

        Returns:
            A key of `shares`; None if there are no shares.
        """
        if not self.shares:
            return None
        hash_text = repr((seed, scene, room if self.by == "room" else None))
        hash_fraction = (
            int.from_bytes(sha256(hash_text.encode()).digest()[:8], "big") / 2.0**64
        )  # 0 to 1
        cumulative_shares = np.cumsum(list(self.shares.values()))
        cumulative_shares = cumulative_shares / cumulative_shares[-1]
        return list(self.shares)[
            int(np.searchsorted(cumulative_shares, hash_fraction, side="right"))
        ]


def make_rules(sampler: str | Rules = "uniform", **changes: object) -> Rules:
    """Make the rules of a sampler: those of a preset, with some of them changed.

    Args:
        sampler: the rules to begin with, or the name of a preset.
        changes: new values of fields of `Rules`; texts are converted to the field's type.

    Returns:
        The changed rules.

    Raises:
        ConfigError: there is no such preset or rule, or a value doesn't fit.
    """
    if isinstance(sampler, str) and sampler not in PRESETS:
        raise ConfigError(f"no sampler {sampler!r}: {suggest(sampler, PRESETS)}")
    rules = sampler if isinstance(sampler, Rules) else PRESETS[sampler]
    rule_names = Rules.__struct_fields__
    for name in changes:
        if name not in rule_names:
            raise ConfigError(
                f"no rule {name!r} of a sampler: {suggest(name, rule_names, len(rule_names))}"
            )
    return _convert({**msgspec.to_builtins(rules), **changes}, Rules)


def make_task(name: str = "point", **fields: object) -> Task:
    """Make a task from its name and the values of its other fields.

    Args:
        name: the name of the task, one of `GRID_TASKS`.
        fields: values of the other fields of `Task`; texts are converted to the field's type.

    Raises:
        ConfigError: there is no such task or field, or a value doesn't fit.
    """
    return _convert({"name": name, **fields}, Task)


def make_splits(shares: Mapping[str, float | str], by: str = "scene") -> Splits:
    """Make the parts (splits) of a set.

    Args:
        shares: name of a part -> its size, relative to the sum of all, > 0.
        by: ``scene`` or ``room``: all episodes that start in the same one are in the same part.

    Raises:
        ConfigError: a value doesn't fit.
    """
    return _convert({"shares": shares, "by": by}, Splits)


def _convert(field_values: dict[str, object], struct_type: type[StructT]) -> StructT:
    """Make a struct from the values of its fields, which may be texts."""
    try:
        return msgspec.convert(field_values, struct_type, strict=False)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(str(error)) from error


class AgentChoice(TypedDict, total=False):
    """The agent that episodes are drawn for; by default the agent of the grids."""

    radius: float | None  #: Its radius [m]; grids are inflated for it if need be.
    height: float | None  #: Its height [m], at most that of the grids' agent.
    speed: float | None  #: Its speed [m/s], which is only stored in the header.
    agent: str | None  #: Name of one of the grids' agents, in place of size and speed.


def make_episodes(
    grids: NavGrid | Sequence[NavGrid],
    task: str | Task = "point",
    sampler: str | Rules = "uniform",
    *,
    count: int = 100,
    seed: int = 0,
    splits: Splits | None = None,
    files: Sequence[str | None] = (),
    **agent_choice: Unpack[AgentChoice],
) -> EpisodeSet:
    """Draw episodes on grids. All can be solved, and equal arguments give equal sets.

    The episodes of a scene depend on the seed and the scene's id, but not on the other grids.

    Args:
        grids: one or several grids, of different scenes.
        task: the task, or its name.
        sampler: the rules, or the name of a preset.
        count: the number of episodes, >= 1, divided equally among the scenes. There are fewer if
            the rules refuse too many: 200 goals in a row without an episode end a scene.
        seed: the seed of the draw, >= 0.
        splits: the parts of the set.
        files: the file names of the grids, for the header.
        agent_choice: the agent, see `AgentChoice`.

    Returns:
        The set, whose header has the grids, agent and rules, and how many draws each rule refused.

    Raises:
        QueryError: no episode could be drawn, there is no such object or room, the agent is too
            high, or two grids are of the same scene.
        ConfigError: there is no such task or sampler.

    Example:
        >>> episodes = make_episodes(grid, "object", count=500, radius=0.2)
    """
    if unknown_names := agent_choice.keys() - AgentChoice.__annotations__.keys():
        raise TypeError(
            f"make_episodes() got an unexpected keyword argument {min(unknown_names)!r}"
        )
    agent_name = agent_choice.get("agent")
    grid_list = list(grids) if isinstance(grids, Sequence) else [grids]
    if not isinstance(task, Task):
        task = make_task(task)
    rules = make_rules(sampler)
    splits = splits or Splits()
    for name, value, minimum in (("count", count, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or value < minimum:
            raise QueryError(f"expected a {name} >= {minimum}, got {value!r}")
    speed_choice = agent_choice.get("speed")
    if speed_choice is not None:
        check_positive(speed_choice, "speed")
    scenes = [scene_of(grid) for grid in grid_list]
    if not grid_list or len(set(scenes)) < len(scenes):
        scenes_text = ", ".join(sorted(scenes)) or "none"
        raise QueryError(f"expected grids of different scenes, got {scenes_text}")
    episodes: list[Episode] = []
    grid_entries = []
    sizes_and_speeds = set()  # tuples of radius, height and speed
    num_rejected = Counter[str]()
    for index, (scene, original_grid) in enumerate(zip(scenes, grid_list, strict=True)):
        agent = choose_agent(
            original_grid, agent_name, agent_choice.get("radius"), agent_choice.get("height")
        )
        grid = fit_grid(original_grid, agent)
        finder_agent = agent.without_sizes() if agent_name else None
        scene_sampler = _SceneSampler(grid, task, rules, int(seed), splits, finder_agent)
        # the first scenes get one episode more if the count can't be divided
        num_scene_episodes = count // len(scenes) + (index < count % len(scenes))
        episodes += scene_sampler.draw(num_scene_episodes)
        num_rejected.update(scene_sampler.rejected)
        file_name = files[index] if index < len(files) else None
        grid_entries.append(GridEntry(scene=scene, digest=digest_of(grid), file=file_name))
        height = grid.agent_height if agent.height is None else float(agent.height)
        speed = agent.speed if agent_name else speed_choice
        sizes_and_speeds.add((grid.radius, height, speed))
    if len(sizes_and_speeds) > 1:
        agent_sizes = sorted({(radius, height) for radius, height, _ in sizes_and_speeds})
        size_text = ", ".join(f"{radius:g} x {height:g} m" for radius, height in agent_sizes)
        raise QueryError(f"the grids are for agents of several sizes ({size_text}): give a radius")
    if not episodes:
        count_texts = [f"{num_draws} {reason}" for reason, num_draws in num_rejected.most_common()]
        reasons_text = ", ".join(count_texts) or "nothing drawn"
        raise QueryError(f"no episode of {scenes[0]!r} keeps the rules: {reasons_text}")
    ((radius, height, speed),) = sizes_and_speeds
    sampler_settings = {"task": task, "rules": rules, "count": int(count), "splits": splits}
    header = Header(
        agent=Agent(radius=radius, height=height, speed=speed, name=agent_name or msgspec.UNSET),
        grids=tuple(grid_entries),
        sampler=msgspec.to_builtins(sampler_settings),
        seed=int(seed),
        rejected=dict(sorted(num_rejected.items())),
    )
    numbered_episodes = [
        msgspec.structs.replace(episode, id=str(index)) for index, episode in enumerate(episodes)
    ]
    return EpisodeSet(header, tuple(numbered_episodes))


class _SceneSampler:
    """Draws the episodes of one scene."""

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
        self.goal_finder = GoalFinder(self.finder, task)
        scene_hash = sha256(self.scene.encode()).digest()
        self.rng = np.random.default_rng([seed, int.from_bytes(scene_hash[:8], "big")])
        self.rejected = Counter[str]()
        self.island_radii = self._measure_islands()
        self.allows_outdoors = (
            rules.outdoors or not has_building(grid.rooms) or not self._has_free_room()
        )
        self.class_edges: tuple[float, ...] = (0.0,)
        if rules.strata:
            self.class_edges = rules.edges or CLASS_EDGES[rules.strata]
        self.num_missing_of_class: list[int] = []  # episodes still to be drawn in each class

    def _has_free_room(self) -> bool:
        """Return whether an agent can stand in a room that isn't outdoors."""
        search = self.finder.search
        is_in_room = search.rooms.number > 0
        return bool((search.flat.free & is_in_room & ~search.mark_outdoors()).any())

    def _measure_islands(self) -> Float:
        """Return for each island the distance of its farthest cell from its middle [m]."""
        search = self.finder.search
        cells = np.flatnonzero(search.flat.free)
        island_of_cell = search.islands.number[cells]
        positions = search.flat.positions(cells)
        num_islands = search.islands.count + 1
        num_cells = np.maximum(np.bincount(island_of_cell, minlength=num_islands), 1)
        mean_coordinates = [
            np.bincount(island_of_cell, coordinate, num_islands) / num_cells
            for coordinate in positions.T
        ]
        middle_of_island = np.stack(mean_coordinates, axis=1)
        radii = np.zeros(num_islands)
        np.maximum.at(
            radii,
            island_of_cell,
            np.linalg.norm(positions - middle_of_island[island_of_cell], axis=1),
        )
        return radii

    def draw(self, count: int) -> list[Episode]:
        """Draw `count` episodes, or fewer if the rules refuse too many; their ids are empty."""
        if not self.finder.search.flat.free.any():
            raise QueryError(f"no agent can stand anywhere in {self.scene!r}")
        episodes: list[Episode] = []
        episodes_per_goal = math.ceil(count / self.rules.goals)
        num_classes = len(self.class_edges)
        # the first classes get one episode more if the count can't be divided
        self.num_missing_of_class = [
            count // num_classes + (class_index < count % num_classes)
            for class_index in range(num_classes)
        ]
        num_failures = 0  # in a row
        while len(episodes) < count and num_failures < MAX_FAILURES:
            stops = self._draw_stops()
            new_episodes = [] if stops is None else self._draw_starts(stops, episodes_per_goal)
            num_failures = 0 if new_episodes else num_failures + 1
            episodes += new_episodes
        return episodes

    def _draw_stops(self) -> Stops | None:
        """Draw goals and find their stops.

        If no episode can have these goals, return None and count the reason in `rejected`.
        """
        task = self.task
        if task.name == "explore":
            return Stops((Goal(share=task.share, radius=task.reach),))
        in_order = task.name == "sequence"
        num_goals = task.length if in_order else 1
        goals = self._draw_goals(num_goals, in_order)
        stops = None
        if len(goals) >= num_goals:
            stops = find_stops(self.finder, goals, in_order=in_order)
        if stops is None:
            reasons = {"object": "not in sight", "reach": "not in reach"}
            reason = reasons.get(task.kind, "no place in the room")
        elif not math.isfinite(stops.remaining_lengths[0]):
            reason = "no path"
        elif (
            task.kind != "room"
            and (-np.diff(stops.remaining_lengths) < self.rules.min_distance).any()
        ):
            reason = "too near"
        else:
            return stops
        self.rejected[reason] += 1
        return None

    def _draw_goals(self, num_goals: int, in_order: bool) -> list[Goal]:
        """Draw the goals of an episode.

        Args:
            num_goals: the number of goals of a sequence; else 1.
            in_order: whether the task is a sequence.

        Returns:
            The goals of a sequence, in order, fewer if a label has no goals; else all goals of one
            label of `GoalFinder.choices`, or one point.
        """
        task = self.task
        if task.kind == "point":
            points = self.finder.random_point(self.rng, num_goals, outdoors=self.allows_outdoors)
            return [Goal(position=(x, y, z), radius=task.reach) for x, y, z in points.tolist()]
        labels = list(self.goal_finder.choices)
        if not labels:
            raise QueryError(f"no {task.noun} in {self.scene!r} to set as a goal")
        label_indices = self.rng.choice(len(labels), num_goals, replace=num_goals > len(labels))
        goals_of_labels = [
            self.goal_finder.make_goals(labels[label_index])
            for label_index in label_indices.tolist()
        ]
        if not in_order:
            return goals_of_labels[0]
        return [goals[int(self.rng.integers(len(goals)))] for goals in goals_of_labels if goals]

    def _draw_starts(self, stops: Stops, count: int) -> list[Episode]:
        """Draw starts for the stops of goals, and make up to `count` episodes.

        For each episode, `Rules.tries` starts are drawn; the first that no rule refuses is used.
        """
        rules = self.rules
        start_positions = self.finder.random_point(
            self.rng, count * rules.tries, outdoors=self.allows_outdoors
        )
        lower_limits = [[-math.pi], [0.0]]
        upper_limits = [[math.pi], [1.0]]
        headings, random_numbers = self.rng.uniform(
            lower_limits, upper_limits, (2, len(start_positions))
        )
        drawn_starts = self._measure_starts(stops, start_positions, headings)
        is_refused_by_reason = self._find_refused(drawn_starts, random_numbers)
        episodes: list[Episode] = []
        for start_indices in np.arange(len(start_positions)).reshape(count, rules.tries):
            if not any(self.num_missing_of_class):
                break
            for start_index in start_indices.tolist():
                reasons = (
                    reason
                    for reason, is_refused in is_refused_by_reason.items()
                    if is_refused[start_index]
                )
                reason = next(reasons, None)
                if reason is None:
                    episode = self._make_episode(stops, drawn_starts, start_index)
                    if self._take_from_class(episode):
                        episodes.append(episode)
                        break
                    reason = "stratum full"
                self.rejected[reason] += 1
        return episodes

    def _measure_starts(self, stops: Stops, start_positions: Float, headings: Float) -> _Starts:
        """Measure the paths from drawn starts to the stops of an episode.

        Args:
            stops: the stops.
            start_positions: world x, y, z of the starts, shape (n, 3) [m].
            headings: headings at the starts, shape (n,) [rad]; used if `Rules.headings` is
                ``random``.
        """
        flat_grid = self.finder.search.flat
        cells = flat_grid.cells_at(start_positions)
        goal_positions = start_positions
        path_lengths = np.full(len(start_positions), np.nan)
        straight_lengths = np.full(len(start_positions), np.nan)
        if stops.places:
            straight_lengths, nearest_index = spatial.cKDTree(stops.places[0]).query(
                start_positions
            )
            goal_positions = stops.places[0][nearest_index]
            path_lengths = stops.distance_fields[0][cells] + stops.remaining_lengths[0]
            for stop_places, next_stop_places in pairwise(stops.places):
                straight_lengths = (
                    straight_lengths + spatial.cKDTree(stop_places).query(next_stop_places)[0].min()
                )
            if self.rules.headings != "random":
                heading_vectors = (
                    goal_positions - start_positions
                    if self.rules.headings == "goal"
                    else start_positions - goal_positions
                )
                headings = np.arctan2(heading_vectors[:, 1], heading_vectors[:, 0])
        levels = np.stack(
            [flat_grid.level_of(cells), flat_grid.level_of(flat_grid.cells_at(goal_positions))],
            axis=1,
        )
        return _Starts(
            positions=start_positions,
            headings=headings,
            cells=cells,
            levels=levels,
            rises=(start_positions - goal_positions)[:, 2],
            path_lengths=path_lengths,
            straight_lengths=straight_lengths,
        )

    def _make_episode(self, stops: Stops, starts: _Starts, start_index: int) -> Episode:
        """Make the episode for one of the starts; its id is empty."""
        room_table = self.finder.search.rooms
        room = room_table.id_of(int(room_table.number[starts.cells[start_index]]))
        episode = Episode(
            id="",
            scene=self.scene,
            task=self.task.name,
            start=tuple(starts.positions[start_index].tolist()),
            heading=float(starts.headings[start_index]),
            goals=stops.goals,
            distance=float(starts.path_lengths[start_index]) if stops.places else None,
            straight=float(starts.straight_lengths[start_index]) if stops.places else None,
            split=self.splits.of(self.seed, self.scene, room),
            room=room,
            levels=tuple(starts.levels[start_index].tolist()),
        )
        if self.rules.paths or self.rules.strata in ("doors", "rooms"):
            route_fields = plan_path_through(self.finder, episode.start, stops.places)
            episode = msgspec.structs.replace(episode, **route_fields)
        return episode

    def _take_from_class(self, episode: Episode) -> bool:
        """Count an episode in its class; return False, uncounted, if the class is full."""
        measure = self.rules.strata
        measured_value = episode.measures[measure] if measure else 0.0
        # an unknown ratio counts as 1
        measured_value = measured_value or float(measure == "ratio")
        class_index = int(np.searchsorted(self.class_edges, measured_value, side="right")) - 1
        if class_index < 0 or not self.num_missing_of_class[class_index]:
            return False
        self.num_missing_of_class[class_index] -= 1
        return True

    def _find_refused(self, starts: _Starts, random_numbers: Float) -> dict[str, Bool]:
        """Find which starts each rule refuses.

        Args:
            starts: the starts.
            random_numbers: a random number from 0 to 1 for each start, shape (n,).

        Returns:
            Reason -> mask of the starts that are refused for it, shape (n,). A start that several
            rules refuse is counted for the first of these reasons.
        """
        rules = self.rules
        island_of_start = self.finder.search.islands.number[starts.cells]
        max_distance = math.inf if rules.max_distance is None else rules.max_distance
        max_rise = math.inf if rules.max_rise is None else rules.max_rise
        path_lengths = starts.path_lengths
        straight_lengths = starts.straight_lengths
        # 1 for a start at the goal, and on a stair, where the line through the air may be longer
        length_ratio = np.where(straight_lengths == 0, 1.0, np.nan)
        length_ratio = np.maximum(
            np.divide(path_lengths, straight_lengths, out=length_ratio, where=straight_lengths > 0),
            1.0,
        )
        is_refused_by_chance = random_numbers > 20.0 * (length_ratio - 0.98) ** 2
        is_on_another_level = starts.levels[:, 0] != starts.levels[:, 1]
        return {
            "island too small": self.island_radii[island_of_start] < rules.min_island,
            "no path": np.isinf(path_lengths),
            "too near": path_lengths < rules.min_distance,
            "too far": path_lengths > max_distance,
            "too straight": length_ratio < rules.min_ratio,
            "straight, by chance": (length_ratio < (rules.soft_ratio or 0.0))
            & is_refused_by_chance,
            "too steep": np.abs(starts.rises) > max_rise,
            "another level": rules.same_level & is_on_another_level,
        }


class _Starts(NamedTuple):
    """n starts that were drawn for the same goals, and their measures."""

    positions: Float  # world x, y, floor z, shape (n, 3) [m]
    headings: Float  # [rad], shape (n,)
    cells: Int  # flat ids, shape (n,)
    levels: Int  # levels of start and goal, shape (n, 2)
    rises: Float  # z of the start minus z of the goal [m], shape (n,)
    # length of the shortest path through the stops [m], shape (n,); NaN if there is no path
    path_lengths: Float
    straight_lengths: Float  # the same length, but straight through the air [m], shape (n,)
