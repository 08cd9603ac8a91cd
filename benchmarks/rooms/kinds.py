"""The kinds of rooms: each draws its objects, their looks and their places from a random generator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.rooms.arranging import Build, Ground, Room, arc, extent
from benchmarks.rooms.groups import (
    before_wall,
    hung_flat,
    photographed,
    put_across,
    put_corner,
    put_filled,
    put_flush,
    put_hollow,
    put_more,
    put_pile,
    put_row,
    put_stack,
    put_thin,
    upon,
)
from benchmarks.rooms.materials import mottled
from benchmarks.rooms.models import furniture, office, tableware, tools, toys
from benchmarks.rooms.models.tableware import Random
from benchmarks.rooms.shapes import board, placed, resting

_STONE = (("#b9b4ab", "#d6d2c9", "#8f8a82"), ("#4a4d52", "#6b6e73", "#383a3e"), ("#d9d4c6", "#efece2", "#b8b09c"))


def desk(rng: Random) -> Room:
    """A desk before a wall."""
    room, ground = before_wall(rng, (1.35, 0.75), tableware.grained(rng))
    computer = rng.uniform() < 0.5
    if computer:
        room.put("tv", ground.at(office.monitor(rng), -0.1, 0.2, float(rng.uniform(-0.15, 0.15))))
        keys = room.put("keyboard", ground.at(office.keyboard(rng), -0.05, -0.03, float(rng.uniform(-0.1, 0.1))))
        room.note("thin", keys)
    else:
        room.put("laptop", ground.at(office.laptop(rng), -0.08, 0.08, float(rng.uniform(-0.2, 0.2))))
    room.put("mouse", ground.at(office.mouse(rng), 0.24, -0.02, float(rng.uniform(-0.3, 0.3))))
    put_pile(room, rng, ground, (0.47, 0.18), 3)
    pages = ground.at(office.notebook(rng), -0.47, -0.23, float(rng.uniform(-0.15, 0.15)))
    notes = room.put("notebook", pages)
    pen = room.put("pen", upon(pages, office.pen(rng), rng))
    room.note("on a pattern", pen, notes)
    room.note("thin", pen)
    lamp = room.put("lamp", ground.at(office.desk_lamp(rng), -0.52, 0.2, 0.4))
    room.note("two materials", lamp)
    put_thin(room, rng, ground, [("cell phone", office.phone), ("scissors", tools.scissors), ("ruler", office.ruler)])
    put_hollow(room, rng, ground, [("cup", tableware.mug), ("pen cup", office.pen_cup), ("tape", tools.tape_roll)])
    put_more(room, rng, ground, [("clock", office.clock), ("photo frame", office.photo_frame)], turns=0.5)
    put_more(room, rng, ground, [("cable", office.cable), ("stapler", office.stapler), ("pencil", office.pencil)])
    return photographed(room, rng, (0, 0, 0.06), 1.05)


def kitchen(rng: Random) -> Room:
    """A counter: what one cooks with, fruit in a bowl, a place mat."""
    stone = mottled(_STONE[int(rng.integers(len(_STONE)))], 60, 1.3, 0.05, 40)
    room, ground = before_wall(rng, (1.4, 0.7), stone)
    put_filled(room, rng, ground, (0.3, 0.1), ("bowl", placed(tableware.bowl(rng), scale=1.25)), 4)
    plank = ground.at(tableware.cutting_board(rng), -0.14, -0.17, float(rng.uniform(-0.3, 0.3)))
    cutting = room.put("cutting board", plank)
    blade = room.put("knife", upon(plank, placed(tableware.knife(rng), y=-0.06), rng, 0.25))
    room.note("two materials", blade)
    room.note("thin", blade, cutting)
    loaf = room.put("bread", upon(plank, placed(tableware.bread(rng), y=0.045), rng, 0.2))
    room.note("touching", loaf, cutting)
    mat = ground.at(furniture.rug(rng, (0.38, 0.28)), 0.36, -0.19, float(rng.uniform(-0.1, 0.1)))
    cloth = room.put("place mat", mat)
    dish = room.put("plate", upon(mat, placed(tableware.plate(rng), -0.05), rng, 0.3))
    room.note("on a pattern", dish, cloth)
    spoon = room.put("spoon", upon(mat, placed(tableware.spoon(rng), 0.135, turn=np.pi / 2), rng, 0.06))
    room.note("on a pattern", spoon, cloth)
    put_more(room, rng, ground, [("toaster", tableware.toaster), ("kettle", tableware.kettle)], turns=0.6, area=0.5)
    put_hollow(room, rng, ground, [("cup", tableware.mug), ("pan", tableware.pan), ("cup", tableware.mug)])
    tin = ground.place(tableware.can(rng))
    if tin is not None:
        low = room.put("can", tin)
        high = room.put("can", upon(tin, tableware.can(rng), rng))
        room.note("stacked", low, high)
    put_more(
        room, rng, ground, [("bottle", tableware.bottle), ("jar", tableware.jar), ("jar", tableware.jar)], turns=0.5
    )
    put_more(room, rng, ground, [("banana", tableware.banana), ("lemon", tableware.lemon), ("fork", tableware.fork)])
    return photographed(room, rng, (0.03, 0, 0.06), 1.1)


def workshop(rng: Random) -> Room:
    """Tools that hang on a wall of wood above a bench with more of them."""
    wood = mottled(("#b98d58", "#d0a870", "#a87c4a", "#c49a62"), 14, 1.2, stretch=(0.15, 1, 1))
    room, ground = before_wall(rng, (1.5, 0.42), tableware.grained(rng), wall=wood, wall_height=2.0)
    hanging: list[tuple[str, Build]] = [
        ("saw", tools.saw),
        ("hammer", tools.hammer),
        ("wrench", tools.wrench),
        ("pliers", tools.pliers),
        ("screwdriver", tools.screwdriver),
        ("brush", tools.brush),
        ("scissors", tools.scissors),
        ("clamp", tools.clamp),
        ("chisel", tools.chisel),
    ]
    board = Ground(rng, (-0.7, 0.3), (0.52, 0.98))
    for number in rng.permutation(len(hanging)):
        label, build = hanging[int(number)]
        hung = board.place(placed(build(rng), turn=np.pi / 2), gap=0.02, turns=0.12)
        if hung is not None:
            put_flush(room, label, placed(hung, tip=np.pi / 2), 0.209)
    low = room.put("wrench", hung_flat(placed(tools.wrench(rng), 0.62, turn=0.6), 0.47, 0.208))
    high = room.put("screwdriver", hung_flat(placed(tools.screwdriver(rng), 0.62, turn=2.2), 0.47, 0.2))
    room.note("crossed", low, high)
    put_more(room, rng, ground, [("toolbox", tools.toolbox), ("paint tin", tools.paint_tin)], turns=0.4)
    put_across(room, rng, ground, ("hammer", tools.hammer), ("chisel", tools.chisel), 0.03)
    put_hollow(room, rng, ground, [("crate", tools.crate), ("tape", tools.tape_roll)])
    put_more(room, rng, ground, [("tape measure", tools.tape_measure), ("jar", tableware.jar), ("cup", tableware.mug)])
    room.poses = arc(rng, (0, 0.12, 0.45), ((2, 1.45, 9, 44), (18, 1.45, 10, 48), (36, 1.4, 7, 40)))
    return room


def shelf(rng: Random) -> Room:
    """A shelf before a wall: rows and piles of books, vessels, a plant."""
    room = Room()
    wide, deep, high = 1.0, 0.28, 1.25
    put_corner(room, rng, floor=-0.01, back=deep / 2 + 0.005, width=3.2, side=None)
    room.put("shelf", furniture.shelf(rng, (wide, deep, high), 4))
    kinds: list[tuple[str, Build]] = [
        ("vase", tableware.vase),
        ("clock", office.clock),
        ("photo frame", office.photo_frame),
        ("teddy bear", lambda r: placed(toys.teddy(r), scale=0.85)),
        ("jar", tableware.jar),
        ("bowl", tableware.bowl),
        ("cup", tableware.mug),
        ("basket", toys.basket),
    ]
    order = iter(rng.permutation(len(kinds)).tolist())
    for level, height in enumerate(furniture.shelf_heights(high, 4)):
        ground = Ground(rng, (-wide / 2 + 0.03, -deep / 2), (wide / 2 - 0.03, deep / 2), height)
        left = level % 2 == 0
        if level < 3:
            put_row(room, rng, ground, -wide / 2 + 0.035 if left else 0.04, int(rng.integers(6, 9)))
        if level in (0, 1):
            put_pile(room, rng, ground, (0.3 if left else -0.33, -0.01), 3)
        if level == 3:
            room.put("potted plant", ground.at(placed(furniture.plant(rng), scale=1.1), -0.3, 0.0))
        for _ in range(2):
            label, build = kinds[next(order)]
            meshes = ground.place(build(rng), turns=0.4)
            if meshes is not None:
                number = room.put(label, meshes)
                if label in ("bowl", "cup", "basket", "vase"):
                    room.note("hollow", number)
                if label == "cup":
                    room.note("two materials", number)
    room.window = (0.5, -0.8, 0.6)
    room.poses = arc(rng, (0, 0, 0.66), ((-3, 1.6, 8, 42), (12, 1.65, 10, 48), (28, 1.6, 8, 42)))
    return room


def lying_tools(rng: Random) -> Room:
    """Tools that lie on each other on a workbench."""
    room, ground = before_wall(rng, (1.2, 0.8), tableware.grained(rng))
    put_filled(
        room,
        rng,
        ground,
        (0.38, 0.22),
        ("crate", tools.crate(rng)),
        3,
        [("tape", tools.tape_roll), ("jar", tableware.jar), ("tape measure", tools.tape_measure)],
    )
    pairs: list[tuple[tuple[str, Build], tuple[str, Build], float]] = [
        (("wrench", tools.wrench), ("hammer", tools.hammer), 0.012),
        (("pliers", tools.pliers), ("screwdriver", tools.screwdriver), 0.016),
        (("saw", tools.saw), ("chisel", tools.chisel), 0.014),
        (("screwdriver", tools.screwdriver), ("wrench", tools.wrench), 0.02),
    ]
    for low, high, height in pairs:
        put_across(room, rng, ground, low, high, height)
    rag = ground.place(furniture.rug(rng, (0.24, 0.18)))
    if rag is not None:
        cloth = room.put("cloth", rag)
        cutter = room.put("scissors", upon(rag, tools.scissors(rng), rng))
        room.note("on a pattern", cutter, cloth)
        room.note("thin", cutter)
    put_hollow(room, rng, ground, [("tape", tools.tape_roll), ("cup", tableware.mug)])
    first = ground.place(tools.paint_tin(rng))
    if first is not None:
        room.put("paint tin", first)
    put_thin(room, rng, ground, [("brush", tools.brush), ("ruler", office.ruler), ("pencil", office.pencil)])
    put_more(room, rng, ground, [("tape measure", tools.tape_measure), ("clamp", tools.clamp)])
    return photographed(room, rng, (0, 0, 0.03), 1.0)


def chairs(rng: Random) -> Room:
    """A corner of a room: chairs around a table, a couch or a cabinet, a rug."""
    room = Room()
    put_corner(room, rng, floor=0.0, back=1.5, width=4.4, side=-2.3)
    rug = furniture.rug(rng, (2.0, 1.4))
    carpet = room.put("rug", placed(rug, 0.35, -0.2, z=0.001))
    room.put("dining table", placed(furniture.table(rng, (1.15, 0.75, 0.74)), 0.35, -0.15))
    style = rng.integers(1 << 30)
    for x, y, turn in ((0.05, -0.78, np.pi), (0.7, -0.74, np.pi), (0.1, 0.5, 0.0), (1.22, -0.1, -np.pi / 2)):
        seat = furniture.chair(np.random.default_rng(style))
        sat = room.put("chair", resting(placed(seat, x, y, turn + float(rng.uniform(-0.25, 0.25))), 0.005))
        room.note("on a pattern", sat, carpet)
    if rng.uniform() < 0.5:
        soft = room.put("couch", placed(furniture.couch(rng), -1.4, 0.2, np.pi / 2))
        pillow = room.put("cushion", placed(furniture.cushion(rng), -1.36, 0.4, np.pi / 2 + 0.2, 0.5))
        room.note("touching", pillow, soft)
        room.put("lamp", placed(furniture.floor_lamp(rng), -1.5, 1.22))
    else:
        chest = room.put("cabinet", placed(furniture.cabinet(rng, (0.9, 0.42, 0.78)), -1.0, 1.27))
        pot = room.put("vase", placed(tableware.vase(rng), -1.2, 1.25, z=0.78, scale=1.5))
        room.note("touching", pot, chest)
        put_stack(room, [("book", office.book(rng)) for _ in range(3)], (-0.75, 1.22), 0.78, rng)
        room.put("lamp", placed(furniture.floor_lamp(rng), -1.62, 0.3))
    room.put("potted plant", placed(furniture.plant(rng), 1.55, 1.1, scale=3.0))
    pail = room.put("bucket", placed(furniture.bucket(rng), -0.62, -0.62, 0.6, 0.001))
    room.note("hollow", pail)
    room.put("stool", placed(furniture.stool(rng), -1.25, -0.75))
    bowl = placed(tableware.bowl(rng), scale=1.5)
    ground = Ground(rng, (-0.2, -0.5), (0.9, 0.2), 0.74)
    put_filled(room, rng, ground, (0.35, -0.1), ("bowl", bowl), 4)
    put_hollow(room, rng, ground, [("cup", lambda r: placed(tableware.mug(r), scale=1.2))])
    put_more(room, rng, ground, [("bottle", tableware.bottle), ("book", office.book)])
    for x, z in ((-0.4, 1.5), (0.9, 1.45)):
        room.put(
            "picture",
            placed(placed(furniture.framed_print(rng), scale=1.5), x + float(rng.uniform(-0.1, 0.1)), 1.499, z=z),
        )
    room.window = (0.9, -0.5, 0.8)
    room.poses = arc(rng, (-0.05, 0.15, 0.62), ((10, 3.1, 9, 35), (20, 3.0, 10, 38), (34, 2.8, 8, 35)), 0.1)
    return room


def shop(rng: Random) -> Room:
    """A display of goods on steps: rows of like objects that touch, fruit in baskets."""
    room, _ = before_wall(rng, (1.5, 0.75), tableware.grained(rng))
    steps = [
        mesh
        for k, (y, z) in enumerate(((0.22, 0.3), (0.06, 0.16)))
        for mesh in placed(board((1.35, 0.16, z), tableware.grained(np.random.default_rng(k))), 0, y)
    ]
    room.put("rack", steps)
    goods: list[tuple[str, Build]] = [
        ("can", tableware.can),
        ("jar", tableware.jar),
        ("box", toys.carton),
        ("bottle", tableware.bottle),
    ]
    order = rng.permutation(4)
    for level, (y, z) in enumerate(((0.22, 0.3), (0.06, 0.16))):
        x = -0.6
        for which in (order[2 * level], order[2 * level + 1]):
            label, build = goods[int(which)]
            row: list[int] = []
            look = int(rng.integers(1 << 30))
            for _ in range(int(rng.integers(4, 6))):
                meshes = placed(build(np.random.default_rng(look)), turn=float(rng.uniform(-0.08, 0.08)))
                wide = extent(meshes)[1][0] - extent(meshes)[0][0]
                row.append(room.put(label, placed(meshes, x + wide / 2, y, z=z)))
                x += wide + float(rng.uniform(0.001, 0.006))
            room.note("touching", *row)
            x += 0.06
    ground = Ground(rng, (-0.72, -0.36), (0.72, -0.03))
    put_filled(room, rng, ground, (-0.45, -0.19), ("basket", toys.basket(rng)), 6)
    put_filled(room, rng, ground, (0.5, -0.19), ("bowl", placed(tableware.bowl(rng), scale=1.35)), 4)
    mat = ground.at(furniture.rug(rng, (0.42, 0.26)), 0.02, -0.19)
    cloth = room.put("cloth", mat)
    for spot in (-0.12, 0.0, 0.12):
        sweet = room.put("donut", upon(mat, placed(toys.donut(rng), spot), rng, 0.0))
        room.note("on a pattern", sweet, cloth)
    room.note("hollow", sweet)
    put_more(room, rng, ground, [("knife", tableware.knife), ("cup", tableware.mug), ("scissors", tools.scissors)])
    return photographed(room, rng, (0, 0.05, 0.14), 1.25)


def playroom(rng: Random) -> Room:
    """Toys on the floor of a room, some in a box, blocks in towers."""
    room = Room()
    put_corner(room, rng, floor=0.0, back=0.95, width=3.0, side=-1.2)
    mat = placed(furniture.rug(rng, (1.3, 0.95)), 0.0, 0.1, z=0.001)
    carpet = room.put("rug", mat)
    ground = Ground(rng, (-0.75, -0.45), (0.75, 0.62), 0.005)
    put_filled(
        room,
        rng,
        ground,
        (-0.45, 0.4),
        ("crate", placed(tools.crate(rng), scale=1.1)),
        4,
        [("duck", toys.duck), ("toy car", toys.car), ("block", toys.block), ("orange", tableware.orange)],
    )
    for where in ((0.12, 0.4), (-0.2, -0.15)):
        cubes = [("block", placed(toys.block(rng), scale=1.3)) for _ in range(int(rng.integers(3, 5)))]
        put_stack(room, cubes, where, 0.005, rng, 0.008)
        ground.at(placed(toys.block(rng), scale=1.6), *where)
    pet = room.put(
        "teddy bear", ground.at(placed(toys.teddy(rng), scale=1.2), 0.42, 0.35, float(rng.uniform(-0.4, 0.4)))
    )
    room.note("on a pattern", pet, carpet)
    put_pile(room, rng, ground, (0.55, -0.1), 3)
    put_across(room, rng, ground, ("ruler", office.ruler), ("pen", office.pen), 0.005)
    put_thin(room, rng, ground, [("rope", toys.skipping_rope)])
    put_hollow(room, rng, ground, [("bowl", tableware.bowl)])
    items: Sequence[tuple[str, Build]] = [
        ("sports ball", toys.sports_ball),
        ("toy car", toys.car),
        ("toy car", toys.car),
        ("robot", toys.robot),
        ("stacking rings", toys.rings),
        ("duck", toys.duck),
        ("block", toys.block),
        ("scissors", tools.scissors),
        ("cup", tableware.mug),
    ]
    put_more(room, rng, ground, items)
    return photographed(room, rng, (0, 0.08, 0.1), 1.45)
