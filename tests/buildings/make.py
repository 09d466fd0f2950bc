"""Makes houses at random, and knows what is true of them.

A house is a rectangle of storeys. The front zone of each storey holds the stairs, a partition
with a door parts it from the back zone, and a closet of the back zone may have no door at all.
Every riser is at most 0.19 m, every way at least 0.9 m wide and 2 m high, so that nobody can
doubt what is connected.

What counts as a storey, by "Levels" of the design: every storey does, also one drawn without its
ceiling; stairs, landings, balconies and the ground round the house lie on the storeys that there
are. A mezzanine lies over a storey's floor and, where a storey follows, under the next one's,
so that a level of its own is unavoidable. Roofs, parapets and tops of walls are none.
"""

from __future__ import annotations

from random import Random

from buildings.parts import Building, Opening, Patch, Placing, Rect, Stairway, frame, shifted
from buildings.stairs import KINDS, SOLID, Stairs, make_stairs, place_stairs

AISLE = 1.1  # floor that is kept clear before and after each stairs [m]
DOOR, HEAD = 0.95, 2.1  # width and height of a door [m]
PARTITION = 0.12  # thickness [m]
RISER_OUT = 0.2  # of the steps to an entry, at most [m]
BASES = ("ground", "slab", "plinth", "slab_only", "inset_slab", "inset_slab_only")
ROOFS = ("flat", "parapet", "gable", "solid_gable", "two_heights", "none")
ANNEXES = ("none", "garage", "carport")


class House:
    """A house that is being built; see `make_building`."""

    def __init__(self, seed: int, **wanted: str) -> None:
        self.rng = rng = Random(seed)
        self.wanted = wanted
        self.made = Building()
        self.made.placing = Placing(
            rng.random() < 0.5, rng.randrange(4), rng.uniform(-1, 1), rng.uniform(-1, 1)
        )
        self.num_storeys = int(self._pick("storeys", ("1", "1", "2", "2", "3", "4", "5")))
        mezzanine = self._pick("mezzanine", ("no", "no", "no", "yes")) == "yes"
        kinds = KINDS if not mezzanine else ("half_landing", "spiral")
        self.kind = self._pick("stairs", kinds) if self.num_storeys > 1 else "none"
        self.well = self._pick("well", ("open", "railing", "closed"))
        self.treads = self._pick("treads", ("thin", "thick", "solid"))
        self.base, self.roof = self._pick("base", BASES), self._pick("roof", ROOFS)
        self.wall = round(rng.choice([rng.uniform(0.05, 0.3), rng.uniform(0.3, 0.8)]), 3)
        self.made.features["wall"] = "thick" if self.wall >= 0.3 else "thin"
        self.short = rng.choice([-0.002, -0.001, 0.0, 0.001, 0.002])
        self.made.features["walls end"] = f"{1000 * self.short:+.0f} mm"
        self.slab = rng.uniform(0.1, 0.25)
        self.ground_height = {
            "slab": rng.uniform(0.02, 0.24),
            "plinth": rng.uniform(0.3, 0.6),
            "slab_only": rng.choice([0.0, 0.1]),
        }.get(self.base, 0.0)
        height = rng.uniform(2.6, 3.2) + self.slab
        self.rises = [height] * self.num_storeys
        self.mezzanine = rng.uniform(2.3, 2.6) if mezzanine else 0.0
        if mezzanine:
            self.rises[0] = 2 * self.mezzanine + rng.uniform(0.0, 0.3)
        self.stairs = self._stairs()
        self._size()

    def _pick(self, feature: str, words: tuple[str, ...]) -> str:
        drawn = self.rng.choice(words)  # drawn even if not used: other features stay the same
        self.made.features[feature] = word = self.wanted.get(feature, drawn)
        return word

    def _stairs(self) -> list[Stairs]:
        """The stairs of each storey; all have one seed, so that equal rises get equal stairs."""
        seed = self.rng.random()
        guard = 0.1 if self.well == "closed" else 0.05
        rises = self.rises[:-1]
        return [make_stairs(self.kind, rise, self.slab, guard, Random(seed)) for rise in rises]

    def _size(self) -> None:
        rng, wall = self.rng, self.wall
        sizes = [s.size for s in self.stairs] or [(3.0, 1.5)]
        along, across = max(s[0] for s in sizes), max(s[1] for s in sizes)
        if self.mezzanine:
            across += 2.3
        inner_x = max(along + 2 * AISLE + 0.2, 7.0) + rng.uniform(0, 1.5)
        self.partition = wall + across + AISLE + rng.uniform(0, 0.5)
        self.x1 = wall + inner_x
        self.y1 = self.partition + PARTITION + rng.uniform(2.2, 3.5)
        self.outer: Rect = (0.0, 0.0, self.x1 + wall, self.y1 + wall)
        self.inner: Rect = (wall, wall, self.x1, self.y1)
        self.floor = [self.ground_height]
        for rise in self.rises:
            self.floor.append(self.floor[-1] + rise)

    # ------------------------------------------------------------ storeys

    def stairs_at(self, number: int) -> tuple[float, float]:
        """Where the stairs that begin on a storey stand; they stand over each other."""
        stairs = self.stairs[number]
        if self.kind == "l_shape":
            return self.x1 - stairs.size[0], self.wall
        return self.wall + AISLE + 0.1, self.wall

    def build_storey(self, number: int) -> None:
        made, z = self.made, self.floor[number]
        is_last = number == self.num_storeys - 1
        top = self.floor[number + 1] - (0.0 if is_last else self.slab)
        foot = z if self.base not in ("inset_slab_only",) or number else z - self.slab
        if is_last and self.roof == "none":
            # of a mezzanine, too: nobody should step from it onto the walls
            top = z + self.rng.uniform(2.4, 3.0) + (0.0 if number else self.mezzanine)
        end = top + self.short
        self._outer_walls(number, foot, end)
        holes: list[Rect] = []
        if number:
            stairs, (x, y) = self.stairs[number - 1], self.stairs_at(number - 1)
            holes = [shifted(rect, x, y) for rect in stairs.openings]
            made.slab(self.outer, z, self.slab, holes)
            for rect in stairs.bridges:
                made.slab(shifted(rect, x, y), z, self.slab)
                made.maybe.append(Patch("", shifted(rect, x, y), z))
        self._rooms(number, z, end, tuple(holes))
        made.maybe.append(Patch("", self.outer, z, tuple(holes)))
        if not is_last:
            self._put_stairs(number, z)
        self._guards(number, z, end)

    def _outer_walls(self, number: int, foot: float, end: float) -> None:
        made, wall, z = self.made, self.wall, self.floor[number]
        x1, y1 = self.x1, self.y1
        door = []
        if number == 0 and self.base not in ("slab_only", "inset_slab_only"):
            has_door = self._pick("entry", ("door", "door", "none")) == "door"
            if has_door:
                door = [Opening(wall + 0.1, wall + 0.1 + DOOR, z + HEAD)]
                made.maybe.append(Patch("", (0.0, 0.0, wall, y1), z))
                self._steps()
        made.wall((0.0, 0.0, x1 + wall, wall), foot, end)
        made.wall((0.0, wall, wall, y1), foot, end, door)
        made.wall((x1, wall, x1 + wall, y1), foot, end)
        made.wall((0.0, y1, x1 + wall, y1 + wall), foot, end, self._balcony(number, z))

    def _steps(self) -> None:
        """Steps from the ground to the entry, or a drop that nobody can take."""
        made, y0, y1 = self.made, self.wall, self.wall + DOOR + 0.3
        if self.ground_height <= 0.25:
            made.joined.append(("outdoors", "storey 0"))
            return
        if self._pick("steps", ("steps", "drop")) == "drop":
            return
        made.joined.append(("outdoors", "storey 0"))
        number = int(self.ground_height / RISER_OUT)
        for i in range(1, number + 1):
            rect = (-0.3 * (number + 1 - i), y0, 0.0, y1)
            made.add(rect, 0.0, self.ground_height * i / (number + 1))
        made.stairs.append(Stairway((-0.3 * number, y0, 0.1, y1), 0.0, self.ground_height))

    def _balcony(self, number: int, z: float) -> list[Opening]:
        if number == 0 or self._pick(f"balcony {number}", ("no", "no", "yes")) == "no":
            self.made.features.pop(f"balcony {number}", None)
            return []
        made, edge = self.made, self.y1 + self.wall
        del made.features[f"balcony {number}"]
        made.features["balcony"] = "yes"
        x, width = self.wall + 0.4, self.rng.uniform(2.2, 3.0)
        rect = (x, edge, x + width, edge + 1.6)
        made.slab(rect, z, 0.15)
        for side in frame(rect, 0.05)[1:]:
            made.add(side, z, z + 1.0)
        place = f"balcony {number}"
        made.floors.append(Patch(place, rect, z))
        made.joined.append((place, self._back(number)))
        return [Opening(x + 0.3, x + 0.3 + DOOR, z + HEAD)]

    def _back(self, number: int) -> str:
        return f"storey {number}" if self.mezzanine and number == 0 else f"back {number}"

    def _rooms(self, number: int, z: float, end: float, holes: tuple[Rect, ...]) -> None:
        """The front and back zones, and what parts them."""
        made, rng, place = self.made, self.rng, f"storey {number}"
        x0, y0, x1, y1 = self.inner
        if self.mezzanine and number == 0:
            made.floors.append(Patch(place, self.inner, z, holes))
            self._build_mezzanine(z)
            return
        yp = self.partition
        door = x0 + rng.uniform(0.3, 2.0)
        openings = [Opening(door, door + DOOR, z + HEAD)]
        made.floors.append(Patch(place, (x0, y0, x1, yp), z, holes))
        back = f"back {number}"
        made.joined.append((place, back))
        xp = x1
        if self._pick("closet", ("no", "sealed", "door")) != "no":
            xp = x0 + rng.uniform(3.6, x1 - x0 - 2.0)
            closet = f"closet {number}"
            made.wall((xp, yp + PARTITION, xp + PARTITION, y1), z, end)
            made.floors.append(Patch(closet, (xp + PARTITION, yp + PARTITION, x1, y1), z))
            if made.features["closet"] == "door":
                at = xp + PARTITION + 0.3
                openings.append(Opening(at, at + DOOR, z + HEAD))
                made.joined.append((place, closet))
        made.floors.append(Patch(back, (x0, yp + PARTITION, xp, y1), z))
        made.wall((x0, yp, x1, yp + PARTITION), z, end, openings)

    def _build_mezzanine(self, z: float) -> None:
        """A mezzanine over the back of the lowest storey, with straight stairs along its edge."""
        made, rng = self.made, self.rng
        x0, _, x1, y1 = self.inner
        top, edge = z + self.mezzanine, self.partition
        stairs = make_stairs("straight", self.mezzanine, 0.2, 0.05, rng)
        x, y = x0 + AISLE, edge - stairs.size[1]
        self._treads(stairs, x, y, z)
        landing = (x + stairs.size[0], y, x + stairs.size[0] + 1.0, edge)
        rect = (x0, edge, x1, y1)
        made.slab(rect, top, 0.2)
        made.slab(landing, top, 0.2)
        if self.well == "railing":
            made.add((x0, edge, landing[0], edge + 0.05), top, top + 1.0)
            made.add((landing[2], edge, x1, edge + 0.05), top, top + 1.0)
        made.floors.append(Patch("mezzanine", rect, top))
        made.floors.append(Patch("mezzanine", landing, top))
        made.joined.append(("storey 0", "mezzanine"))
        made.levels += 1

    def _put_stairs(self, number: int, z: float) -> None:
        stairs, (x, y) = self.stairs[number], self.stairs_at(number)
        self._treads(stairs, x, y, z, solid=number == 0)
        self.made.joined.append((f"storey {number}", f"storey {number + 1}"))

    def _treads(self, stairs: Stairs, x: float, y: float, z: float, solid: bool = True) -> None:
        thickness = 0.06 if self.treads == "thin" else 0.2
        thickness = SOLID if solid and self.treads == "solid" else thickness
        place_stairs(self.made, stairs, x, y, z, thickness)

    def _guards(self, number: int, z: float, end: float) -> None:
        """Railings round the opening in a floor, or walls from storey to storey."""
        if self.well == "open":
            return
        at = [k for k in (number - 1, number) if 0 <= k < len(self.stairs)]
        if self.well == "railing":
            at = at[:1] if number else []
        if self.mezzanine and number == 0:
            at = []
        for k in at[:1]:
            x, y = self.stairs_at(k)
            for guard in self.stairs[k].guards:
                rect, top = shifted(guard, x, y), z + 1.0 if self.well == "railing" else end
                self.made.add(rect, z, top)
                # the flight that goes on passes the railing's top at a step's height
                self.made.maybe.append(Patch("", rect, top))

    # ------------------------------------------------------------ round the storeys

    def build_base(self) -> None:
        made, outer = self.made, self.outer
        if self.base == "slab_only":
            made.slab(outer, self.ground_height, 0.2)
            return
        if self.base == "inset_slab_only":
            made.slab(self.inner, 0.0, 0.2)
            return
        land = (-2.5, -2.5, outer[2] + 6.0, outer[3] + 2.5)
        made.plane = self._pick("land", ("plane", "box")) == "plane"
        if not made.plane:
            made.slab(land, 0.0, 0.3)
        if self.ground_height:
            made.add(outer, 0.0, self.ground_height)
        if self.base == "inset_slab":
            made.add(self.inner, -0.05, 0.0)
        reach = (-99.0, -99.0, 99.0, 99.0) if made.plane else land
        made.floors.append(Patch("outdoors", reach, 0.0, (outer,)))

    def build_annex(self) -> None:
        """A garage or a carport beside the house, on its ground."""
        made, rng, x = self.made, self.rng, self.outer[2]
        if self.base in ("slab_only", "inset_slab_only"):
            return
        kind = self._pick("annex", ANNEXES)
        width, depth, top = rng.uniform(3.0, 3.8), rng.uniform(4.5, 5.5), rng.uniform(2.3, 2.6)
        rect = (x, 0.3, x + width, 0.3 + depth)
        if kind == "carport":
            for cx in (rect[0] + 0.1, rect[2] - 0.3):
                for cy in (rect[1] + 0.1, rect[3] - 0.3):
                    made.add((cx, cy, cx + 0.14, cy + 0.14), 0.0, top)
        if kind == "garage":
            gate = rng.uniform(1.2, 3.0)
            middle = x + width / 2
            a, b = max(middle - gate / 2, x + 0.01), min(middle + gate / 2, x + width - 0.2)
            made.features["gate"] = "narrow" if gate < 1.8 else "wide"
            front, right, back, _ = frame(rect, 0.15)
            made.wall(front, 0.0, top + self.short, [Opening(a, b, min(2.2, top))])
            made.wall(right, 0.0, top + self.short)
            made.wall(back, 0.0, top + self.short)
        if kind != "none":
            made.slab(rect, top + 0.15, 0.15)

    def build_roof(self) -> None:
        made, rng = self.made, self.rng
        x0, y0, x1, y1 = self.outer
        low = self.floor[-1]
        if self.roof == "none":
            return
        if self.roof in ("gable", "solid_gable"):
            over = rng.choice([0.0, 0.3])
            ridge, middle = low + rng.uniform(0.35, 0.8) * (y1 - y0) / 2, (y0 + y1) / 2
            eave = low - over * (ridge - low) / (middle - y0)
            ends = ((x0 - over, y0 - over, eave), (x0 - over, y1 + over, eave))
            if self.roof == "solid_gable":
                low_points = [(x0, y0, low), (x0, y1, low), (x0, middle, ridge)]
                made.prisms.append([*low_points, *((x1, y, z) for _, y, z in low_points)])
                return
            for x, y, z in ends:
                line = [(x, y, z), (x, middle, ridge)]
                both = [*line, *((x1 + over, b, c) for _, b, c in line)]
                made.prisms.append([(a, b, c + t) for a, b, c in both for t in (0.0, 0.12)])
            return
        over = rng.choice([0.0, 0.4])
        top = low + self.slab
        made.slab((x0 - over, y0 - over, x1 + over, y1 + over), top, self.slab)
        if self.roof == "parapet":
            for side in frame((x0 - over, y0 - over, x1 + over, y1 + over), 0.15):
                made.add(side, top, top + rng.uniform(0.3, 0.9))
        if self.roof == "two_heights":
            share = rng.uniform(0.3, 0.6)
            made.add((x0, y0, x0 + share * (x1 - x0), y1), top, top + rng.choice([0.2, 0.5, 0.9]))


def make_building(seed: int, **wanted: str) -> Building:
    """A house from its seed; features can be given, as ``roof="flat"``."""
    house = House(seed, **wanted)
    house.made.levels = house.num_storeys
    house.build_base()
    for number in range(house.num_storeys):
        house.build_storey(number)
    house.build_roof()
    house.build_annex()
    if wanted.get("coordinates") == "round":
        round_off(house.made)
    return house.made


def round_off(made: Building, unit: float = 0.05) -> None:
    """Move all that is drawn in plan to multiples of a length [m]: centres of cells lie on faces.

    What becomes thinner than that is as thick as it; spiral stairs stay as they are.
    """

    def near(rect: Rect) -> Rect:
        x0, y0, x1, y1 = (round(round(value / unit) * unit, 9) for value in rect)
        return x0, y0, max(x1, round(x0 + unit, 9)), max(y1, round(y0 + unit, 9))

    made.placing = made.placing._replace(x=0.0, y=0.0)
    made.boxes = [box._replace(rect=near(box.rect)) for box in made.boxes]
    for patches in (made.floors, made.maybe):
        patches[:] = [
            one._replace(rect=near(one.rect), holes=tuple(map(near, one.holes))) for one in patches
        ]
    for k, one in enumerate(made.stairs):  # a tread may have moved out of it by as much
        x0, y0, x1, y1 = near(one.rect)
        made.stairs[k] = one._replace(rect=(x0 - unit, y0 - unit, x1 + unit, y1 + unit))
