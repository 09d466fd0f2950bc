"""Sets of episodes as other programs have them: habitat-lab, MINOS and MolmoSpaces.

habitat-lab (``.json.gz``): PointNav, ObjectNav and VLN, y up, rotations x, y, z, w; an agent looks
along -z. MINOS (``.csv``, ``.csv.bz2``): y up, angles about y from -z, three decimals. MolmoSpaces
(``.json``): a list of ``EpisodeSpec``, z up, poses x, y, z and w, x, y, z.

What JSON has no field for is kept in one called ``navbake``, which these programs ignore.
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
from navbake.types import Vector3

Kind = TypeVar("Kind")
Fields: TypeAlias = tuple[Header, list[Any]]
"""A header, and the fields of each episode, still to be checked."""
Rotation = tuple[float, float, float, float]
Pose = tuple[float, float, float, float, float, float, float]
# of habitat-lab's success, where a goal has none [m]
OBJECT_RADIUS = 0.1
POINT_RADIUS = 0.2
MINOS_RADIUS = 0.25  # of MINOS's point goals [m]
COLUMNS = (
    "sceneId", "split", "level", "roomId", "startX", "startY", "startZ", "startAngle", "startTilt",
    "goalRoomId", "goalRoomType", "goalObjectId", "goalObjectType", "goalX", "goalY", "goalZ",
    "goalAngle", "goalTilt", "dist", "pathDist", "pathNumDoors", "pathDoorIds", "pathNumRooms",
    "pathRoomIndices",
)  # fmt: skip
HELD = {"id", "scene", "task", "start", "heading", "goals", "distance", "room", "extra"}
"""What habitat-lab's formats have a field for."""
INDEXED = re.compile(r"/\d+$")  # ends MolmoSpaces's scenes
PLANAR = 1.5  # metres on the map from the object, MolmoSpaces's success
SPEC = {"robot": {"robot_name": "", "init_qpos": {}}, "img_resolution": [640, 480]}
"""Of an EpisodeSpec: what no navigation episode says."""


class SetFormat(NamedTuple):
    """A format of sets."""

    ending: str  #: Of its files' names.
    tasks: tuple[str, ...]  #: That it can hold.
    encode: Callable[[EpisodeSet, str], bytes]  #: Takes the format's name, too.
    read: Callable[[bytes, str], Fields]  #: Takes the file's name, too.


def decode(text: bytes | str, kind: type[Kind], where: str) -> Kind:
    """Decode JSON of a known structure; a FormatError names the field and where it stands."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        is_unknown = "unknown field" in str(error) and " - at `" not in str(error)
        fields = ", ".join(getattr(kind, "__struct_fields__", ()))
        wanted = f", expected {fields}," if is_unknown else ""
        raise FormatError(f"{error}{wanted} in {where}") from error


def _to_yup(p: Sequence[float]) -> Vector3:
    return p[0], p[2], 0.0 - p[1]


def _from_yup(p: Sequence[float]) -> Vector3:
    return p[0], 0.0 - p[2], p[1]


def _rotation(heading: float) -> Rotation:
    half = (heading - math.pi / 2) / 2
    return 0.0, math.sin(half), 0.0, math.cos(half)


def _heading(rotation: Rotation) -> float:
    """Where a rotation of a y-up world turns -z."""
    x, y, z, w = rotation
    return math.atan2(1 - 2 * (x * x + y * y), -2 * (x * z + w * y))


def _rest(episode: Episode, held: Container[str]) -> dict[str, Any]:
    """The fields of an episode but those that a format holds."""
    fields = msgspec.to_builtins(episode)
    return {key: value for key, value in fields.items() if key not in held}


def _position(goal: Goal) -> Vector3:
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
        """The key of its goals in ObjectNav's table."""
        return f"{self.scene_id.rsplit('/', 1)[-1]}_{self.object_category}"


class _Content(msgspec.Struct, omit_defaults=True):
    episodes: list[_Episode]
    goals_by_category: dict[str, list[_Goal]] | None = None
    category_to_task_category_id: dict[str, int] | None = None
    category_to_scene_annotation_category_id: dict[str, int] | None = None
    instruction_vocab: dict[str, Any] | None = None
    navbake: Header | None = None


def encode_habitat(content: EpisodeSet, form: str) -> bytes:
    """Encode as a dataset of habitat-lab."""
    whole = _Content([], navbake=content.header)
    table = dict[str, tuple[Goal, ...]]()
    for number, e in enumerate(content.episodes):
        rest = _rest(e, HELD)
        info = {**e.extra, "geodesic_distance": e.distance, "navbake": rest}
        written = _Episode(e.id, e.scene, _to_yup(e.start), _rotation(e.heading), [], info, e.room)
        whole.episodes.append(written)
        if form == "habitat-objectnav":
            written.object_category = e.goals[0].category or e.goals[0].name
            key = written.goals_key
            if table.setdefault(key, e.goals) != e.goals:
                other = f"one list of goals for {key!r}, episode {e.id!r} has another one"
                hint = "draw objects by category, and give scenes names of their own"
                raise FormatError(f"habitat-objectnav has {other}: {hint}")
            continue
        written.goals = [_write_goal(goal) for goal in e.goals]
        if form == "habitat-vln":
            if not e.path:
                raise FormatError(f"habitat-vln needs paths, episode {e.id!r} has none: paths=true")
            written.reference_path = [_to_yup(p) for p in rest.pop("path")]
            written.instruction = {"instruction_text": rest.pop("instruction", "")}
            written.trajectory_id = e.extra.get("trajectory_id", number)
    if form == "habitat-objectnav":
        categories = sorted({str(e.object_category) for e in whole.episodes})
        whole.category_to_task_category_id = {name: k for k, name in enumerate(categories)}
        whole.category_to_scene_annotation_category_id = whole.category_to_task_category_id
        whole.goals_by_category = {
            key: [_write_goal(goal, k) for k, goal in enumerate(goals)]
            for key, goals in table.items()
        }
    elif form == "habitat-vln":
        texts = " ".join(e.instruction or "" for e in content.episodes)
        whole.instruction_vocab = {"word_list": sorted(set(re.findall(r"\w+", texts.lower())))}
    return msgspec.json.encode(whole)


def _write_goal(goal: Goal, number: int | None = None) -> _Goal:
    """A point; with a number, an object of ObjectNav's table."""
    states = ((_State(_to_yup(v.position), _rotation(v.heading)), v.iou) for v in goal.view_points)
    views = None if number is None else [_View(*state) for state in states]
    at = _to_yup(_position(goal))
    return _Goal(at, goal.radius, number, goal.name, goal.category, views)


def _read_goal(goal: _Goal, radius: float) -> Goal:
    """A goal, with a radius where it says none [m]."""
    states = ((view.agent_state, view.iou) for view in goal.view_points or ())
    views = (ViewPoint(_from_yup(s.position), _heading(s.rotation), iou) for s, iou in states)
    return Goal(
        position=_from_yup(goal.position), radius=radius if goal.radius is None else goal.radius,
        name=goal.object_name, category=goal.object_category, view_points=tuple(views),
    )  # fmt: skip


def read_habitat(text: bytes, name: str) -> Fields:
    """Read a dataset of habitat-lab: PointNav, ObjectNav or VLN, by the fields of its episodes."""
    content = decode(text, _Content, name)
    episodes = []
    # episodes share goals, of which there may be thousands
    table = {
        key: tuple(_read_goal(goal, OBJECT_RADIUS) for goal in goals)
        for key, goals in (content.goals_by_category or {}).items()
    }
    for e in content.episodes:
        extra = dict(e.info or {})
        is_object = e.object_category is not None
        is_foreign = "navbake" not in extra
        known: dict[str, Any] = {**extra.pop("navbake", {})}
        if e.start_room is not None:
            known["room"] = str(e.start_room)
        if e.reference_path is not None:
            known["path"] = [_from_yup(p) for p in e.reference_path]
        if e.instruction is not None:
            known["instruction"] = e.instruction.get("instruction_text") or None
            extra |= {"trajectory_id": e.trajectory_id} if is_foreign else {}
        radius = OBJECT_RADIUS if is_object else POINT_RADIUS
        goals = table.get(e.goals_key) or [_read_goal(goal, radius) for goal in e.goals]
        episodes.append(known | {
            "id": str(e.episode_id), "scene": e.scene_id, "goals": goals,
            "task": "object" if is_object else "point",
            "start": _from_yup(e.start_position), "heading": _heading(e.start_rotation),
            "distance": extra.pop("geodesic_distance", None), "extra": extra,
        })  # fmt: skip
    return content.navbake or Header(), episodes


# ---------------------------------------------------------------- MINOS


def encode_minos(content: EpisodeSet, _: str) -> bytes:
    """Encode as MINOS's table of episode states, a row an episode."""
    file = io.StringIO()
    table = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
    table.writeheader()
    for e in content.episodes:
        goal = e.goals[0]
        doors = e.doors or ()
        rooms = [room.rsplit(":", 1)[-1] for room in e.rooms or ()]
        row: dict[str, Any] = {
            "sceneId": e.scene, "split": e.split, "roomId": e.room,
            "level": e.levels[0] if e.levels else 0, "startTilt": 0, "goalAngle": 0, "goalTilt": 0,
            "startAngle": math.remainder(e.heading - math.pi / 2, 2 * math.pi),
            "goalRoomId": goal.room, "goalObjectId": None if goal.room else goal.name,
            "goalRoomType" if goal.room else "goalObjectType": goal.category,
            "dist": -1.0 if e.straight is None else e.straight,
            "pathDist": -1.0 if e.distance is None else e.distance,
            "pathNumDoors": len(doors), "pathDoorIds": ":".join(doors),
            "pathNumRooms": len(rooms), "pathRoomIndices": ":".join(rooms),
        }  # fmt: skip
        for end, p in (("start", e.start), ("goal", _position(goal))):
            row |= {f"{end}{axis}": v for axis, v in zip("XYZ", _to_yup(p), strict=True)}
        table.writerow({k: f"{v:.3f}" if isinstance(v, float) else v for k, v in row.items()})
    return file.getvalue().encode()


def read_minos(text: bytes, _: str) -> Fields:
    """Read MINOS's episode states."""
    rows = csv.DictReader(io.StringIO(text.decode(), newline=""))
    return Header(), [_read_row(row, k) for k, row in enumerate(rows)]


def _read_row(row: Mapping[str, str], k: int) -> dict[str, Any]:
    def number(column: str, default: str | None = None) -> float:
        text = row.get(column) or default
        with suppress(ValueError):
            if math.isfinite(value := float(text or "nan")):
                return value
        raise ValueError(f"expected a number as {column}, got {text!r} in row {k + 1}")

    def words(column: str) -> list[str]:
        return [word for word in (row.get(column) or "").split(":") if word]

    start = _from_yup([number("start" + axis) for axis in "XYZ"])
    goal = _from_yup([number("goal" + axis) for axis in "XYZ"])
    straight = number("dist", "-1")
    distance = number("pathDist", "-1")
    level = int(number("level", "0"))
    name = row.get("goalObjectId")
    room = row.get("goalRoomId")
    return {
        "id": str(k), "scene": row.get("sceneId"),
        "task": "room" if room else "object" if name else "point",
        "start": start, "heading": math.remainder(number("startAngle") + math.pi / 2, 2 * math.pi),
        "goals": [{
            "position": goal, "radius": 0.0 if room else MINOS_RADIUS,
            "name": name or None, "room": room or None,
            "category": row.get("goalRoomType" if room else "goalObjectType") or None,
        }],
        "distance": None if distance < 0 else distance,
        "straight": None if straight < 0 else straight,
        "split": row.get("split") or None, "room": row.get("roomId") or None,
        "levels": [level, level], "doors": words("pathDoorIds") or None,
        "rooms": [f"{level}:{r}" if r.isdigit() else r for r in words("pathRoomIndices")] or None,
    }  # fmt: skip


# ---------------------------------------------------------------- MolmoSpaces


class _NavTask(msgspec.Struct):
    robot_base_pose: Pose
    pickup_obj_name: str
    pickup_obj_candidates: list[str] | None = None
    pickup_obj_start_pose: Pose | None = None
    succ_pos_threshold: float = PLANAR
    task_cls: str = "molmo_spaces.tasks.nav_task.NavToObjTask"


class _Spec(msgspec.Struct, omit_defaults=True):
    scene_dataset: str
    house_index: int
    task: _NavTask
    language: dict[str, Any]
    data_split: str = "val"
    navbake: dict[str, Any] = {}


def encode_molmospaces(content: EpisodeSet, _: str) -> bytes:
    """Encode as a list of EpisodeSpec; scenes are called ``DATASET/INDEX`` there."""
    specs = []
    for e in content.episodes:
        dataset, _, index = (e.scene if INDEXED.search(e.scene) else f"{e.scene}/0").rpartition("/")
        goal = e.goals[0]
        half = e.heading / 2
        task = _NavTask(
            (*e.start, math.cos(half), 0.0, 0.0, math.sin(half)), goal.name or "",
            [g.name or "" for g in e.goals], (*_position(goal), 1.0, 0.0, 0.0, 0.0),
            goal.radius if e.extra.get("success") == "planar" else PLANAR,
        )  # fmt: skip
        text = {"task_description": e.instruction or f"go to the {goal.category or goal.name}"}
        rest = _rest(e, ("task", "start", "heading"))
        spec = _Spec(dataset, int(index), task, text, e.split or "val", rest)
        specs.append(SPEC | msgspec.to_builtins(spec))
    return msgspec.json.encode(specs)


def read_molmospaces(text: bytes, name: str) -> Fields:
    """Read a list of EpisodeSpec whose tasks are to get to objects."""
    episodes = []
    for k, spec in enumerate(decode(text, list[_Spec], name)):
        task = spec.task
        if "nav" not in task.task_cls.lower():
            raise FormatError(f"expected a way to an object, got {task.task_cls!r} in {name}, {k}")
        x, y, z, qw, qx, qy, qz = task.robot_base_pose
        others = [n for n in task.pickup_obj_candidates or () if n != task.pickup_obj_name]
        pose = task.pickup_obj_start_pose
        radius = task.succ_pos_threshold
        goals = [Goal(name=task.pickup_obj_name, position=pose and pose[:3], radius=radius)]
        foreign: dict[str, Any] = {
            "id": str(k), "scene": f"{spec.scene_dataset}/{spec.house_index}",
            "split": spec.data_split, "instruction": spec.language.get("task_description"),
            "goals": goals + [Goal(name=other, radius=radius) for other in others],
            "extra": {"success": "planar"},
        }  # fmt: skip
        heading = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        own = {"task": "object", "start": (x, y, z), "heading": heading}
        episodes.append((spec.navbake or foreign) | own)
    return Header(), episodes


SIMULATOR_FORMATS = {
    "habitat-pointnav": SetFormat(".json", ("point",), encode_habitat, read_habitat),
    "habitat-objectnav": SetFormat(".json", ("object",), encode_habitat, read_habitat),
    "habitat-vln": SetFormat(".json", ("point",), encode_habitat, read_habitat),
    "molmospaces": SetFormat(".json", ("object",), encode_molmospaces, read_molmospaces),
    "minos": SetFormat(".csv", ("point", "object", "room"), encode_minos, read_minos),
}
"""Other programs' formats by their names."""
