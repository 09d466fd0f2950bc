"""Sets of episodes in the formats of other programs: habitat-lab, MINOS and MolmoSpaces.

habitat-lab (``.json.gz``): PointNav, ObjectNav and VLN, y up, rotations x, y, z, w; an agent looks
along -z. MINOS (``.csv``, ``.csv.bz2``): y up, angles about y from -z, three decimals. MolmoSpaces
(``.json``): a list of ``EpisodeSpec``, z up, poses x, y, z and w, x, y, z.

Fields of navbake's episodes that a JSON format lacks are kept in its field ``navbake``, which the
other programs ignore.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, TypeAlias, TypeVar

import msgspec

from navbake.episodes.episode import Episode, EpisodeSet, Goal, Header, ViewPoint
from navbake.errors import FormatError
from navbake.types import Json, Vector3

StructT = TypeVar("StructT")
ParsedSet: TypeAlias = tuple[Header, list[Any]]
"""The header, and the fields of each episode, which are not checked yet."""
Rotation = tuple[float, float, float, float]
"""A quaternion x, y, z, w in a world with y up, as habitat-lab has it."""
Pose = tuple[float, float, float, float, float, float, float]
"""World x, y, z [m], then a quaternion w, x, y, z, as MolmoSpaces has it."""
# distances to a goal that habitat-lab counts as a success, if the goal states none [m]
OBJECT_RADIUS = 0.1
POINT_RADIUS = 0.2
MINOS_RADIUS = 0.25  # distance to a goal that MINOS counts as a success [m]
MINOS_COLUMNS = (
    "episodeId", "task", "sceneId", "split", "level", "roomId", "startX", "startY", "startZ",
    "startAngle", "startTilt", "goalRoomId", "goalRoomType", "goalObjectId", "goalObjectType",
    "goalX", "goalY", "goalZ", "goalAngle", "goalTilt", "dist", "pathDist", "pathNumDoors",
    "pathDoorIds", "pathNumRooms", "pathRoomIndices",
)  # fmt: skip
MINOS_TASKS = {"p": "point", "o": "object", "r": "room"}
"""MINOS's letter of a task -> the task."""
HABITAT_FIELDS = {"id", "scene", "task", "start", "heading", "goals", "distance", "room", "extra"}
"""Fields of episodes that habitat-lab's formats have a field for."""
HOUSE_INDEX = re.compile(r"/\d+$")  # the end of a scene's name in MolmoSpaces
MOLMOSPACES_RADIUS = 1.5  # distance to a goal, from above, that MolmoSpaces counts as success [m]
EPISODE_SPEC = {"robot": {"robot_name": "", "init_qpos": {}}, "img_resolution": [640, 480]}
"""Fields that an EpisodeSpec needs, but that navbake's episodes lack, with fixed values."""


class SetFormat(NamedTuple):
    """A file format of sets of episodes."""

    ending: str  #: Ending of its files' names.
    tasks: tuple[str, ...]  #: Tasks that it can hold, of `TASKS`.
    encode: Callable[[EpisodeSet, str], bytes]  #: Takes a set and the format's name.
    read: Callable[[bytes, str], ParsedSet]  #: Takes a file's content and name.


def decode(text: bytes | str, structure: type[StructT], place: str) -> StructT:
    """Decode JSON of a known structure.

    Args:
        text: the JSON.
        structure: the structure: a msgspec struct, or a list of them.
        place: file and line, for the error.

    Returns:
        The decoded value.

    Raises:
        FormatError: the text has a different structure; the message names the field.
    """
    try:
        return msgspec.json.decode(text, type=structure)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        has_unknown_field = "unknown field" in str(error) and " - at `" not in str(error)
        fields = ", ".join(getattr(structure, "__struct_fields__", ()))
        expected = f", expected {fields}," if has_unknown_field else ""
        raise FormatError(f"{error}{expected} in {place}") from error


def _convert_to_y_up(position: Sequence[float]) -> Vector3:
    """Convert world x, y, z to the axes of a world with y up."""
    x, y, z = position[:3]
    return x, z, 0.0 - y  # no -0.0


def _convert_from_y_up(position: Sequence[float]) -> Vector3:
    """Convert X, Y, Z of a world with y up to world x, y, z."""
    x, y, z = position[:3]
    return x, 0.0 - z, y


def _heading_to_quaternion(heading: float) -> Rotation:
    """Return the quaternion x, y, z, w, in a world with y up, that turns -z to a heading [rad]."""
    half_angle = (heading - math.pi / 2) / 2
    return 0.0, math.sin(half_angle), 0.0, math.cos(half_angle)


def _quaternion_to_heading(rotation: Rotation) -> float:
    """Return the heading [rad] to which a quaternion, in a world with y up, turns -z."""
    x, y, z, w = rotation
    return math.atan2(1 - 2 * (x * x + y * y), -2 * (x * z + w * y))


def _list_other_fields(episode: Episode, left_out_names: Container[str]) -> Json:
    """Return all fields of an episode except those with some names."""
    fields = msgspec.to_builtins(episode)
    return {name: value for name, value in fields.items() if name not in left_out_names}


def _require_position(goal: Goal) -> Vector3:
    """Return the position of a goal; raise a FormatError if it has none."""
    if goal.position is None:
        raise FormatError(f"expected positions of all goals, {goal.name or 'one'} has none")
    return goal.position


# ---------------------------------------------------------------- habitat-lab


class _State(msgspec.Struct):
    position: Vector3
    rotation: Rotation


class _View(msgspec.Struct):
    agent_state: _State
    iou: float | None  # a reader there needs the key


class _Goal(msgspec.Struct, omit_defaults=True):
    position: Vector3
    radius: float | None = None
    object_id: str | int | None = None
    object_name: str | None = None
    object_category: str | None = None
    view_points: list[_View] | None = None


class _Episode(msgspec.Struct, omit_defaults=True):
    episode_id: str | int
    scene_id: str
    start_position: Vector3
    start_rotation: Rotation
    goals: list[_Goal]
    info: dict[str, Any] | None = None
    start_room: str | int | None = None
    object_category: str | None = None
    trajectory_id: str | int | None = None
    reference_path: list[Vector3] | None = None
    instruction: dict[str, Any] | None = None

    @property
    def goals_key(self) -> str:
        """The key of the episode's goals in `_Dataset.goals_by_category`."""
        return f"{self.scene_id.rsplit('/', 1)[-1]}_{self.object_category}"


class _Dataset(msgspec.Struct, omit_defaults=True):
    episodes: list[_Episode]
    goals_by_category: dict[str, list[_Goal]] | None = None
    category_to_task_category_id: dict[str, int] | None = None
    category_to_scene_annotation_category_id: dict[str, int] | None = None
    instruction_vocab: dict[str, Any] | None = None
    navbake: Header | None = None


def encode_habitat(episode_set: EpisodeSet, format_name: str) -> bytes:
    """Encode a set as a dataset of habitat-lab.

    Args:
        episode_set: the set.
        format_name: ``habitat-pointnav``, ``habitat-objectnav`` or ``habitat-vln``.

    Returns:
        The JSON.

    Raises:
        FormatError: an episode lacks what the format needs.
    """
    dataset = _Dataset([], navbake=episode_set.header)
    goals_by_key = dict[str, tuple[Goal, ...]]()
    for index, episode in enumerate(episode_set.episodes):
        further_fields = _list_other_fields(episode, HABITAT_FIELDS)
        habitat_episode = _Episode(
            episode_id=episode.id,
            scene_id=episode.scene,
            start_position=_convert_to_y_up(episode.start),
            start_rotation=_heading_to_quaternion(episode.heading),
            goals=[],
            info={
                **episode.extra,
                "geodesic_distance": episode.distance,
                "navbake": further_fields,
            },
            start_room=episode.room,
        )
        dataset.episodes.append(habitat_episode)
        if format_name == "habitat-objectnav":
            habitat_episode.object_category = episode.goals[0].category or episode.goals[0].name
            goals_key = habitat_episode.goals_key
            if goals_by_key.setdefault(goals_key, episode.goals) != episode.goals:
                expected = (
                    f"one list of goals for {goals_key!r}, episode {episode.id!r} has another one"
                )
                hint = "draw objects by category, and give scenes names of their own"
                raise FormatError(f"habitat-objectnav has {expected}: {hint}")
            continue
        habitat_episode.goals = [_write_goal(goal) for goal in episode.goals]
        if format_name == "habitat-vln":
            if not episode.path:
                problem = f"episode {episode.id!r} has none: paths=true"
                raise FormatError(f"habitat-vln needs paths, {problem}")
            path = further_fields.pop("path")
            habitat_episode.reference_path = [_convert_to_y_up(position) for position in path]
            instruction_text = further_fields.pop("instruction", "")
            habitat_episode.instruction = {"instruction_text": instruction_text}
            habitat_episode.trajectory_id = episode.extra.get("trajectory_id", index)
    if format_name == "habitat-objectnav":
        categories = sorted(
            {str(habitat_episode.object_category) for habitat_episode in dataset.episodes}
        )
        category_ids = {category: index for index, category in enumerate(categories)}
        dataset.category_to_task_category_id = category_ids
        dataset.category_to_scene_annotation_category_id = category_ids
        dataset.goals_by_category = {
            goals_key: [_write_goal(goal, index) for index, goal in enumerate(goals)]
            for goals_key, goals in goals_by_key.items()
        }
    elif format_name == "habitat-vln":
        instruction_text = " ".join(episode.instruction or "" for episode in episode_set.episodes)
        words = sorted(set(re.findall(r"\w+", instruction_text.lower())))
        dataset.instruction_vocab = {"word_list": words}
    return msgspec.json.encode(dataset)


def _write_goal(goal: Goal, object_id: int | None = None) -> _Goal:
    """Convert a goal to habitat-lab's; with an object's id, to an entry of ObjectNav's table."""
    habitat_views = None
    if object_id is not None:
        habitat_views = [
            _View(
                _State(
                    _convert_to_y_up(view_point.position),
                    _heading_to_quaternion(view_point.heading),
                ),
                view_point.iou,
            )
            for view_point in goal.view_points
        ]
    return _Goal(
        position=_convert_to_y_up(_require_position(goal)),
        radius=goal.radius,
        object_id=object_id,
        object_name=goal.name,
        object_category=goal.category,
        view_points=habitat_views,
    )


def _read_goal(goal: _Goal, default_radius: float) -> Goal:
    """Convert a goal of habitat-lab; it gets `default_radius` [m] if it has no radius."""
    view_points = []
    for habitat_view in goal.view_points or ():
        agent_state = habitat_view.agent_state
        view_points.append(
            ViewPoint(
                _convert_from_y_up(agent_state.position),
                _quaternion_to_heading(agent_state.rotation),
                habitat_view.iou,
            )
        )
    return Goal(
        position=_convert_from_y_up(goal.position),
        radius=default_radius if goal.radius is None else goal.radius,
        name=goal.object_name,
        category=goal.object_category,
        view_points=tuple(view_points),
    )


def read_habitat(text: bytes, name: str) -> ParsedSet:
    """Read a dataset of habitat-lab: PointNav, ObjectNav or VLN, told apart by its fields.

    Args:
        text: the JSON.
        name: the name of the file, for errors.

    Returns:
        A header, and the fields of each episode.

    Raises:
        FormatError: the text is no such dataset.
    """
    dataset = decode(text, _Dataset, name)
    # episodes share goals, of which there may be thousands
    goals_by_key = {
        key: tuple(_read_goal(goal, OBJECT_RADIUS) for goal in goals)
        for key, goals in (dataset.goals_by_category or {}).items()
    }
    episodes = []
    for episode in dataset.episodes:
        extra_fields = dict(episode.info or {})
        is_foreign = "navbake" not in extra_fields
        fields: Json = {**extra_fields.pop("navbake", {})}
        if episode.start_room is not None:
            fields["room"] = str(episode.start_room)
        if episode.reference_path is not None:
            fields["path"] = [_convert_from_y_up(position) for position in episode.reference_path]
        if episode.instruction is not None:
            fields["instruction"] = episode.instruction.get("instruction_text") or None
            if is_foreign:
                extra_fields["trajectory_id"] = episode.trajectory_id
        is_object_task = episode.object_category is not None
        goals = goals_by_key.get(episode.goals_key)
        if not goals:
            radius = OBJECT_RADIUS if is_object_task else POINT_RADIUS
            goals = tuple(_read_goal(goal, radius) for goal in episode.goals)
        fields["id"] = str(episode.episode_id)
        fields["scene"] = episode.scene_id
        fields["goals"] = goals
        fields["task"] = "object" if is_object_task else "point"
        fields["start"] = _convert_from_y_up(episode.start_position)
        fields["heading"] = _quaternion_to_heading(episode.start_rotation)
        fields["distance"] = extra_fields.pop("geodesic_distance", None)
        fields["extra"] = extra_fields
        episodes.append(fields)
    return dataset.navbake or Header(), episodes


# ---------------------------------------------------------------- MINOS


def encode_minos(episode_set: EpisodeSet, _: str) -> bytes:
    """Encode a set as MINOS's table of episode states, one row per episode.

    MINOS reads ``episodeId`` as an integer: it is the episode's id if all ids are different
    integers, else the number of the row, from 0.
    """
    episode_ids = [episode.id for episode in episode_set.episodes]
    if not _are_minos_ids(episode_ids):
        episode_ids = [str(index) for index in range(len(episode_ids))]
    letter_of_task = {task: letter for letter, task in MINOS_TASKS.items()}
    csv_text = io.StringIO()
    csv_writer = csv.DictWriter(csv_text, MINOS_COLUMNS, restval="", lineterminator="\n")
    csv_writer.writeheader()
    for episode_id, episode in zip(episode_ids, episode_set.episodes, strict=True):
        goal = episode.goals[0]
        doors = episode.doors or ()
        rooms = [room.rsplit(":", 1)[-1] for room in episode.rooms or ()]
        row: Json = {
            "episodeId": episode_id,
            "task": letter_of_task[episode.task],
            "sceneId": episode.scene,
            "split": episode.split,
            "roomId": episode.room,
            "level": episode.levels[0] if episode.levels else 0,
            "startTilt": 0,
            "goalAngle": 0,
            "goalTilt": 0,
            "startAngle": math.remainder(episode.heading - math.pi / 2, 2 * math.pi),
            "goalRoomId": goal.room,
            "goalObjectId": None if goal.room else goal.name,
            "goalRoomType" if goal.room else "goalObjectType": goal.category,
            "dist": -1.0 if episode.straight is None else episode.straight,
            "pathDist": -1.0 if episode.distance is None else episode.distance,
            "pathNumDoors": len(doors),
            "pathDoorIds": ":".join(doors),
            "pathNumRooms": len(rooms),
            "pathRoomIndices": ":".join(rooms),
        }
        for path_end, position in (("start", episode.start), ("goal", _require_position(goal))):
            for axis, value in zip("XYZ", _convert_to_y_up(position), strict=True):
                row[f"{path_end}{axis}"] = value
        csv_writer.writerow(
            {
                column: f"{value:.3f}" if isinstance(value, float) else value
                for column, value in row.items()
            }
        )
    return csv_text.getvalue().encode()


def read_minos(text: bytes, _: str) -> ParsedSet:
    """Read MINOS's table of episode states, a CSV file.

    Args:
        text: the file's content.
        _: the name of the file, which is not needed.

    Returns:
        The header, which is empty, as the table has none; and for each row the keyword arguments of
        an `Episode`.
    """
    rows = list(csv.DictReader(io.StringIO(text.decode(), newline="")))
    episode_ids = [row.get("episodeId") or "" for row in rows]
    if not _are_minos_ids(episode_ids):  # tables without the column, and joined ones
        episode_ids = [str(index) for index in range(len(rows))]
    return Header(), [
        {"id": episode_id, **_read_row(row, index)}
        for index, (episode_id, row) in enumerate(zip(episode_ids, rows, strict=True))
    ]


def _are_minos_ids(episode_ids: Sequence[str]) -> bool:
    """Whether ids of episodes are different integers from 0, without leading zeros."""
    are_integers = all(re.fullmatch(r"0|[1-9][0-9]{0,17}", name) for name in episode_ids)
    return are_integers and len({*episode_ids}) == len(episode_ids)


def _read_row(row: Mapping[str, str], index: int) -> Json:
    """Convert a row of MINOS's table to the fields of an episode, without its id.

    Where the table has no column ``task``, the goal's columns tell the task. Rows of other tasks
    than ``room`` may name the room of their goal, too.
    """

    def parse_number(column: str, default_text: str | None = None) -> float:
        text = row.get(column) or default_text
        with suppress(ValueError):
            value = float(text or "nan")
            if math.isfinite(value):
                return value
        raise ValueError(f"expected a number as {column}, got {text!r} in row {index + 1}")

    def split_words(column: str) -> list[str]:
        return [word for word in (row.get(column) or "").split(":") if word]

    # the first wrong column in this order is reported
    start_position = _convert_from_y_up([parse_number("start" + axis) for axis in "XYZ"])
    goal_position = _convert_from_y_up([parse_number("goal" + axis) for axis in "XYZ"])
    straight_distance = parse_number("dist", "-1")
    distance = parse_number("pathDist", "-1")
    level = int(parse_number("level", "0"))
    name = row.get("goalObjectId")
    room = row.get("goalRoomId")
    task_letter = row.get("task")
    if task_letter:
        task = MINOS_TASKS.get(task_letter, "")
        if not task:
            letters_text = ", ".join(MINOS_TASKS)
            raise ValueError(
                f"expected one of {letters_text} as task, got {task_letter!r} in row {index + 1}"
            )
        if task == "room" and not room:
            raise ValueError(
                f"expected a goalRoomId for the task {task_letter!r} in row {index + 1}"
            )
        if task != "room":
            room = None
    elif room:
        task = "room"
    elif name:
        task = "object"
    else:
        task = "point"
    # MINOS numbers the rooms of each level; navbake's ids have the level, too
    rooms = [
        f"{level}:{room_id}" if room_id.isdigit() else room_id
        for room_id in split_words("pathRoomIndices")
    ]
    return {
        "scene": row.get("sceneId"),
        "task": task,
        "start": start_position,
        "heading": math.remainder(parse_number("startAngle") + math.pi / 2, 2 * math.pi),
        "goals": [
            {
                "position": goal_position,
                "radius": 0.0 if room else MINOS_RADIUS,
                "name": name or None,
                "room": room or None,
                "category": row.get("goalRoomType" if room else "goalObjectType") or None,
            }
        ],
        "distance": None if distance < 0 else distance,
        "straight": None if straight_distance < 0 else straight_distance,
        "split": row.get("split") or None,
        "room": row.get("roomId") or None,
        "levels": [level, level],
        "doors": split_words("pathDoorIds") or None,
        "rooms": rooms or None,
    }


# ---------------------------------------------------------------- MolmoSpaces


class _NavTask(msgspec.Struct):
    robot_base_pose: Pose
    pickup_obj_name: str
    pickup_obj_candidates: list[str] | None = None
    pickup_obj_start_pose: Pose | None = None
    succ_pos_threshold: float = MOLMOSPACES_RADIUS
    task_cls: str = "molmo_spaces.tasks.nav_task.NavToObjTask"


class _Spec(msgspec.Struct, omit_defaults=True):
    scene_dataset: str
    house_index: int
    task: _NavTask
    language: dict[str, Any]
    data_split: str = "val"
    navbake: dict[str, Any] = {}


def encode_molmospaces(episode_set: EpisodeSet, _: str) -> bytes:
    """Encode a set as MolmoSpaces' list of EpisodeSpec; scenes are named ``DATASET/INDEX``."""
    specs = []
    for episode in episode_set.episodes:
        scene_name = episode.scene if HOUSE_INDEX.search(episode.scene) else f"{episode.scene}/0"
        dataset, _, index = scene_name.rpartition("/")
        goal = episode.goals[0]
        half_heading = episode.heading / 2
        # success is judged by the distance seen from above
        is_success_planar = episode.extra.get("success") == "planar"
        nav_task = _NavTask(
            robot_base_pose=(
                *episode.start,
                math.cos(half_heading),
                0.0,
                0.0,
                math.sin(half_heading),
            ),
            pickup_obj_name=goal.name or "",
            pickup_obj_candidates=[candidate.name or "" for candidate in episode.goals],
            pickup_obj_start_pose=(*_require_position(goal), 1.0, 0.0, 0.0, 0.0),
            succ_pos_threshold=goal.radius if is_success_planar else MOLMOSPACES_RADIUS,
        )
        text = episode.instruction or f"go to the {goal.category or goal.name}"
        spec = _Spec(
            scene_dataset=dataset,
            house_index=int(index),
            task=nav_task,
            language={"task_description": text},
            data_split=episode.split or "val",
            navbake=_list_other_fields(episode, ("task", "start", "heading")),
        )
        specs.append(EPISODE_SPEC | msgspec.to_builtins(spec))
    return msgspec.json.encode(specs)


def read_molmospaces(text: bytes, name: str) -> ParsedSet:
    """Read episodes from a list of EpisodeSpec; all their tasks must be to reach an object."""
    episodes = []
    for index, spec in enumerate(decode(text, list[_Spec], name)):
        nav_task = spec.task
        if "nav" not in nav_task.task_cls.lower():
            place = f"{name}, {index}"
            raise FormatError(f"expected a way to an object, got {nav_task.task_cls!r} in {place}")
        x, y, z, qw, qx, qy, qz = nav_task.robot_base_pose
        heading = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        fields = spec.navbake or _convert_foreign_spec(spec, index)
        fields = fields | {"task": "object", "start": (x, y, z), "heading": heading}
        episodes.append(fields)
    return Header(), episodes


def _convert_foreign_spec(spec: _Spec, index: int) -> Json:
    """Return the fields of another program's episode, except task, start and heading."""
    nav_task = spec.task
    object_pose = nav_task.pickup_obj_start_pose
    radius = nav_task.succ_pos_threshold
    goals = [
        Goal(name=nav_task.pickup_obj_name, position=object_pose and object_pose[:3], radius=radius)
    ]
    for candidate in nav_task.pickup_obj_candidates or ():
        if candidate != nav_task.pickup_obj_name:
            goals.append(Goal(name=candidate, radius=radius))
    return {
        "id": str(index),
        "scene": f"{spec.scene_dataset}/{spec.house_index}",
        "split": spec.data_split,
        "instruction": spec.language.get("task_description"),
        "goals": goals,
        "extra": {"success": "planar"},
    }


SIMULATOR_FORMATS = {
    "habitat-pointnav": SetFormat(".json", ("point",), encode_habitat, read_habitat),
    "habitat-objectnav": SetFormat(".json", ("object",), encode_habitat, read_habitat),
    "habitat-vln": SetFormat(".json", ("point",), encode_habitat, read_habitat),
    "molmospaces": SetFormat(".json", ("object",), encode_molmospaces, read_molmospaces),
    "minos": SetFormat(".csv", ("point", "object", "room"), encode_minos, read_minos),
}
"""Name -> format of another program."""
