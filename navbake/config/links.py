"""Settings of named agents, and of areas and links: who may use them, and what they cost."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    model_validator,
)

from navbake.config.field_types import (
    AlsoAcceptsInSchema,
    LevelKey,
    Name,
    OneOrMore,
    OptionalName,
    Outline,
    Patterns,
    Position,
    Positive,
    Settings,
    expected_error,
    read_if_file,
    refuse_if,
    replace_error_text,
    setting,
)
from navbake.formats.shapes import read_links_or_areas
from navbake.known_names import suggest
from navbake.navgrid.links import MAX_AREAS

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Self

DEFAULT_OF_AGENT_SIZES = "that of `agent`, which is the most"
RULE_FIELDS = ("height", "gap", "patterns")  # only rules that find links (`auto`) have these
LINK_FIELDS = ("name", "kind", "one_way", "width")  # only single links have these

OptionalPositive = Annotated[
    Annotated[float, Field(gt=0)] | None, replace_error_text("a number > 0, or null")
]
OptionalLength = Annotated[
    Annotated[float, Field(ge=0)] | None, replace_error_text("a number >= 0, or null")
]
Agents = Annotated[
    list[Name] | None,
    OneOrMore,
    AlsoAcceptsInSchema("string"),
    replace_error_text("a list of names of `agents`, or null"),
]


class NamedAgent(Settings):
    """An entry of ``agents``: an agent that plans on the grid, with sizes of its own."""

    radius: OptionalLength = setting(None, "radius of its footprint [m], >= 0", "that of `agent`")
    height: OptionalPositive = setting(None, "its height [m], > 0", DEFAULT_OF_AGENT_SIZES)
    step: OptionalLength = setting(None, "its highest step [m], >= 0", DEFAULT_OF_AGENT_SIZES)
    speed: Positive = setting(1.0, "how fast it goes [m/s], > 0")


class AreaSettings(Settings):
    """An entry of ``areas``: a part of the floor that costs more, slows down, or bars agents."""

    name: Name = Field(description="its name; no default")
    room: OptionalName = setting(None, "the room whose cells it is, by id or name, or null")
    polygon: Annotated[
        Annotated[Outline, Tag("=outline")] | Annotated[None, Tag("=none")],
        Discriminator(lambda value: "=none" if value is None else "=outline"),  # for its errors
    ] = setting(None, "its outline [[x, y], …], world frame [m], or null")
    rings: list[Outline] = setting([], "of a polygon: holes in it and further parts [m]")
    level: LevelKey = setting(0, "of a polygon: its level, a number from 0, or a name")
    box: Annotated[
        Annotated[
            list[Position],
            Field(min_length=2, max_length=2),
            AfterValidator(refuse_if(lambda box: any(map(operator.ge, *box)))),
        ]
        | None,
        replace_error_text("[[x, y, z], [x, y, z]], lower corner first, or null"),
    ] = setting(None, "its box, corners [[x, y, z], [x, y, z]] [m], of floors in it, or null")
    geoms: Patterns = setting([], "the geoms on whose cells it lies, by name patterns")
    cost: Annotated[
        Literal["inf"] | Annotated[float, Field(gt=0)],
        BeforeValidator(lambda value: "inf" if value == math.inf else value),
        replace_error_text("a number > 0, or .inf"),
    ] = setting(1.0, "a path's price of a metre there, > 0, or .inf: nobody goes there")
    speed: OptionalPositive = setting(None, "the highest speed there [m/s], > 0, or null")
    agents: Agents = setting(None, "names of the agents that may enter; null for all")

    @property
    def keeps_out(self) -> bool:
        """Whether some or all agents may not enter.

        Then the area covers all cells that it touches, not only those whose centre is in it.
        """
        return self.cost == "inf" or self.agents is not None

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        """Refuse an area whose place is given not at all or in several ways."""
        place_fields = [name for name in ("room", "polygon", "box", "geoms") if getattr(self, name)]
        if len(place_fields) != 1:
            got = " and ".join(place_fields) or f"none for {self.name!r}"
            raise expected_error("one of room, polygon, box and geoms", got=got)
        return self


class LinkSettings(Settings):
    """An entry of ``links``: a connection of places, or a rule by which the bake finds some."""

    name: OptionalName = setting(None, "its name, unique; not with `auto`", "required")
    kind: Name = setting("link", "what it is: lift, drop, jump, ladder, or any other word")
    stops: Annotated[
        list[Position], replace_error_text("2 or more positions [[x, y, z], …], none for `auto`")
    ] = setting([], "where it stops, 2 or more positions [[x, y, z], …] [m]")
    one_way: bool = setting(False, "whether it leads from earlier stops to later ones only")
    width: OptionalPositive = setting(None, "diameter of agents that fit [m], > 0, or null")
    cost: OptionalLength = setting(None, "a path's price of it [m], >= 0", "its length")
    seconds: OptionalLength = setting(None, "how long it takes [s], >= 0", "cost over speed")
    agents: Agents = setting(None, "names of the agents that may use it; null for all")
    state: Literal["open", "closed"] = setting("open", "open or closed")
    auto: Annotated[
        Literal["drop", "jump", "ladder", "lift"] | None,
        replace_error_text("drop, jump, ladder, lift or null"),
    ] = setting(None, "find links of this kind: drop, jump, ladder or lift; null for a given one")
    height: OptionalPositive = setting(
        None,
        "of auto: how far a drop falls, or a jump rises at most [m], > 0",
        "1.0 for drops, a step for jumps",
    )
    gap: OptionalLength = setting(
        None,
        "of auto: between a stop and the landing, ladder or car [m], >= 0",
        "0.5; 0.6 for ladders",
    )
    patterns: Patterns = setting([], "of auto ladder, lift: name patterns", '["*ladder*"] and all')

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        """Refuse fields of rules in a link, fields of links in a rule, and a link without stops."""
        kind = "auto" if self.auto else "a given link"
        unused_fields = LINK_FIELDS if self.auto else RULE_FIELDS
        for name in unused_fields:
            if getattr(self, name) != type(self).model_fields[name].default:
                raise expected_error(f"no `{name}` with {kind}", got=f"`{name}`")
        if self.auto:
            if self.stops:
                raise expected_error("no `stops` with auto, which finds them", got="`stops`")
        elif self.name is None:
            raise expected_error("a name, or auto: drop, jump, ladder or lift", got="neither")
        elif len(self.stops) < 2:
            got = f"{len(self.stops)} for {self.name!r}"
            raise expected_error("2 stops or more", got=got, at=".stops")
        return self


def _check_names(
    entries: Sequence[AreaSettings | LinkSettings], info: ValidationInfo
) -> Sequence[AreaSettings | LinkSettings]:
    """Refuse names that are given twice, and names of agents that the section `agents` lacks."""
    agents = info.data.get("agents")
    names: set[str] = set()
    for index, entry in enumerate(entries):
        if entry.name in names:
            raise expected_error("no name twice", got=f'"{entry.name}"', at=f"[{index}].name")
        if entry.name:
            names.add(entry.name)
        for name in entry.agents or ():
            if agents is not None and name not in agents:
                text = f"a name of `agents` ({suggest(name, agents)})"
                raise expected_error(text, got=f'"{name}"', at=f"[{index}].agents")
    return entries


Areas = Annotated[
    list[AreaSettings],
    Field(max_length=MAX_AREAS),
    AfterValidator(_check_names),
    BeforeValidator(read_if_file("areas", lambda path: read_links_or_areas(path, "areas"))),
    AlsoAcceptsInSchema("string", "null"),
]
Links = Annotated[
    list[LinkSettings],
    AfterValidator(_check_names),
    BeforeValidator(read_if_file("links", lambda path: read_links_or_areas(path, "links"))),
    AlsoAcceptsInSchema("string", "null"),
]
