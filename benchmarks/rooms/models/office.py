"""What lies on desks and shelves, in meters."""

from __future__ import annotations

import numpy as np

from benchmarks.rooms.materials import F32, Material, mottled, painted, plain, worded
from benchmarks.rooms.models.tableware import GLAZES, Random, pick, steel
from benchmarks.rooms.shapes import Mesh, Meshes, ball, bar, board, box, lathe, part, placed, ring, sheet, tube
from demo.sample_paint import cover, hex_rgb, print_landscape

_BOARDS = ("#1f4e79", "#9c2f2f", "#2f6a4a", "#6b3f7a", "#c98a2a", "#26323f", "#b5573a", "#3d7f8c")
_TITLES = ("TIDES", "GARDEN", "ATLAS", "RIVER", "STARS", "BREAD", "NORTH", "SALT", "BIRDS", "CITY")


def book(rng: Random, *, width: float = 0.0, thickness: float = 0.0) -> Meshes:
    """A hardback that lies, its spine to the left; sizes are drawn where none is stated."""
    w = width or float(rng.uniform(0.13, 0.18))
    d, h = 1.36 * w, thickness or float(rng.uniform(0.02, 0.042))
    color, title = pick(rng, _BOARDS), pick(rng, _TITLES)
    cloth = plain(color, 0.04, 20)
    paper = mottled(("#e6dcc4", "#f5eedd", "#d8cbb0"), 60, 1.0, stretch=(0.2, 0.2, 8))
    tones = (color, pick(rng, _BOARDS, color), pick(rng, _BOARDS), "#e9d9b0")
    art = painted(_cover, title, color, tones, int(rng.integers(1 << 30)), gloss=0.05, polish=40)
    corners = 0.485 * np.array([[-w, -d, 0], [w, -d, 0], [w, d, 0], [-w, d, 0]]) + (0, 0, h + 0.0006)
    letters = painted(worded, (40, 300), color, ((title, 0.6, 0.5),), "#fff4dc", gloss=0.04, polish=30)
    x, y, z = -w / 2 - 0.0026, 0.46 * d, 0.42 * h
    spine = np.array([[x, y, h / 2 - z], [x, -y, h / 2 - z], [x, -y, h / 2 + z], [x, y, h / 2 + z]])
    return [
        *part("pages", box((w - 0.01, d - 0.01, h - 0.006), paper, (0.002, 0, h / 2))),
        *box((w, d, 0.003), cloth, (0, 0, 0.0015)),
        *box((w, d, 0.003), cloth, (0, 0, h - 0.0015)),
        *box((0.004, d, h), cloth, (-w / 2, 0, h / 2)),
        sheet(corners, art),
        sheet(spine, letters),
    ]


def _cover(title: str, color: str, tones: tuple[str, ...], seed: int) -> F32:
    art = cover(220, 162, seed, tones)
    art[20:62] = worded((42, 162), color, ((title, 0.6, 0.5),), "#fff4dc")
    return art


def standing_book(rng: Random) -> Meshes:
    """A book in a row on a shelf, its spine in front."""
    lying = book(rng, width=float(rng.uniform(0.12, 0.16)))
    upright = placed(placed(lying, tip=np.pi / 2), turn=np.pi / 2)  # its front cover to the right
    low = np.min([mesh.points.min(axis=0) for mesh in upright], axis=0)
    high = np.max([mesh.points.max(axis=0) for mesh in upright], axis=0)
    return placed(upright, -(low[0] + high[0]) / 2, -low[1], z=-low[2])


def _facing_up(width: float, depth: float, height: float, material: Material, y: float = 0.0) -> Mesh:
    """A flat picture at a height, its middle at `y`."""
    x, half = width / 2, depth / 2
    return sheet(
        [(-x, y - half, height), (x, y - half, height), (x, y + half, height), (-x, y + half, height)], material
    )


def laptop(rng: Random) -> Meshes:
    """Open; a picture on its screen."""
    gray, black = plain(pick(rng, ("#a9acb0", "#6c7076", "#3a3d42")), 0.06, 35), plain("#141518", 0.05)
    base = [ball((0.165, 0.115, 0.009), gray, (0, 0, 0.009), boxy=0.2)]
    pad = _facing_up(0.09, 0.065, 0.0186, plain("#83878c", 0.06), -0.0675)
    keys = [_facing_up(0.28, 0.11, 0.0186, painted(_keys, 5, 13), 0.035), pad]
    lid = [ball((0.165, 0.005, 0.11), gray, (0, 0, 0.11), boxy=0.2)]
    frame = _screen(
        0.31, 0.2, 0.11, -0.0054, black, painted(_desktop, int(rng.integers(1 << 30)), gloss=0.05, polish=90)
    )
    return [*base, *part("keyboard", keys), *part("screen", placed([*lid, *frame], 0, 0.118, z=0.014, tip=-0.3))]


def monitor(rng: Random) -> Meshes:
    """On a foot."""
    black = plain("#18191c", 0.06, 35)
    panel = box((0.52, 0.025, 0.31), black, (0, 0, 0.28))
    foot = [*box((0.2, 0.16, 0.012), black, (0, 0.03, 0.006)), *box((0.05, 0.02, 0.2), black, (0, 0.03, 0.1))]
    screen = _screen(
        0.49, 0.28, 0.28, -0.0128, black, painted(_desktop, int(rng.integers(1 << 30)), gloss=0.05, polish=90)
    )
    return [*part("stand", foot), *panel, *part("screen", screen)]


def _screen(width: float, height: float, middle: float, y: float, rim: Material, display: Material) -> Meshes:
    def flat(w: float, h: float, at: float, material: Material) -> Meshes:
        x, z = w / 2, h / 2
        return [sheet([(-x, at, middle - z), (x, at, middle - z), (x, at, middle + z), (-x, at, middle + z)], material)]

    return [*flat(width, height, y, rim), *flat(0.95 * width, 0.93 * height, y - 0.0006, display)]


def _desktop(seed: int) -> F32:
    rng, picture = np.random.default_rng(seed), print_landscape(180, 300, seed)
    picture[30:120, 40:150] = hex_rgb("#f4f4f2")
    for line in range(7):
        picture[42 + 10 * line : 45 + 10 * line, 48 : 48 + int(rng.integers(40, 95))] = hex_rgb("#55595e")
    return picture


def _keys(rows: int, columns: int) -> F32:
    picture = np.broadcast_to(hex_rgb("#1b1c1f"), (rows * 16, columns * 16, 3)).copy()
    for row in range(rows):
        for column in range(columns):
            picture[row * 16 + 2 : row * 16 + 14, column * 16 + 2 : column * 16 + 14] = hex_rgb("#3b3e43")
            picture[row * 16 + 5 : row * 16 + 9, column * 16 + 5 : column * 16 + 8] = hex_rgb("#d5d7da")
    return picture


def keyboard(rng: Random) -> Meshes:
    """Thin, on the desk."""
    body = [ball((0.22, 0.066, 0.011), plain("#2a2c30", 0.05), (0, 0, 0.011), boxy=0.2)]
    return [*body, _facing_up(0.42, 0.112, 0.0226, painted(_keys, 5, 18))]


def mouse(rng: Random) -> Meshes:
    """Of a computer."""
    color = pick(rng, ("#1f2023", "#d9dadb", "#4a5a6a"))
    return [
        ball((0.032, 0.055, 0.019), plain(color, 0.07, 40), (0, 0, 0.016), boxy=0.8),
        ball((0.005, 0.013, 0.004), plain("#77797c"), (0, -0.025, 0.034)),
    ]


def phone(rng: Random) -> Meshes:
    """A cell phone that lies, thin, its screen lit."""
    body = [ball((0.036, 0.075, 0.0045), plain("#101114", 0.08, 60), (0, 0, 0.0045), boxy=0.18)]
    icons = np.broadcast_to(hex_rgb(pick(rng, ("#2b3a67", "#3b6a5a", "#6a3b4f"))), (120, 56, 3)).copy()
    for row in range(4):
        for column in range(3):
            top, left = 14 + 24 * row, 6 + 16 * column
            icons[top : top + 12, left : left + 12] = hex_rgb(pick(rng, GLAZES))
    return [*body, *part("screen", [_facing_up(0.064, 0.138, 0.0096, painted(lambda: icons, gloss=0.06, polish=90))])]


def pen(rng: Random) -> Meshes:
    """Lying along x, very thin, with a cap of another color."""
    color = plain(pick(rng, GLAZES), 0.08, 60)
    cap = plain(pick(rng, ("#1b1c1f", "#1f3f7a", "#8a1c1c")), 0.08, 60)
    body = tube(
        [(-0.07, 0, 0.0052), (0.03, 0, 0.0052), (0.062, 0, 0.0052), (0.072, 0, 0.0052)],
        [0.0045, 0.0045, 0.004, 0.0008],
        color,
        sides=10,
    )
    return [body, *part("cap", [tube([(-0.075, 0, 0.0052), (-0.025, 0, 0.0052)], 0.0052, cap, sides=10)])]


def pencil(rng: Random) -> Meshes:
    """Lying along x."""
    paint = plain(pick(rng, ("#e0a21c", "#b8352b", "#2f5f8f", "#3f7d5a")), 0.07, 40)
    body = tube([(-0.08, 0, 0.004), (0.07, 0, 0.004)], 0.0038, paint, sides=6)
    tip = tube([(0.07, 0, 0.004), (0.088, 0, 0.004)], [0.0038, 0.0006], plain("#d9b98a"), sides=6)
    return [
        body,
        tip,
        *part("rubber", [tube([(-0.09, 0, 0.004), (-0.08, 0, 0.004)], 0.0039, plain("#d98a92"), sides=8)]),
    ]


def ruler(rng: Random) -> Meshes:
    """Of wood, thin, lying along x."""
    scale = np.broadcast_to(hex_rgb("#dcb778"), (24, 620, 3)).copy()
    for tick in range(0, 600, 2):
        scale[: 12 if tick % 20 == 0 else 5, 10 + tick] = hex_rgb("#2d2218")
    return [*board((0.31, 0.028, 0.003), plain("#c99f5e")), _facing_up(0.31, 0.028, 0.0034, painted(lambda: scale))]


def notebook(rng: Random) -> Meshes:
    """Open, lined, with a spiral; thin."""
    pages = np.broadcast_to(hex_rgb("#f4f0e4"), (260, 360, 3)).copy()
    for line in range(28, 250, 13):
        pages[line, 12:348] = hex_rgb("#9fb4cc")
        for left in (16, 196):
            if rng.uniform() < 0.6:
                pages[line - 6 : line - 2, left : left + int(rng.integers(60, 150)) : 3] = hex_rgb("#2a3350")
    spiral = [
        tube(np.array([(0, y, 0.004), (0.004, y, 0.012), (-0.004, y, 0.012)]), 0.001, steel(), sides=6)
        for y in np.linspace(-0.095, 0.095, 16)
    ]
    return [
        *board((0.304, 0.214, 0.008), plain(pick(rng, _BOARDS))),
        _facing_up(0.3, 0.21, 0.0086, painted(lambda: pages)),
        *part("spiral", spiral),
    ]


def desk_lamp(rng: Random) -> Meshes:
    """A foot, two arms and a shade."""
    color = plain(pick(rng, GLAZES), 0.07, 40)
    foot = lathe([(0, 0), (0.075, 0.0), (0.078, 0.012), (0.05, 0.02), (0, 0.022)], color)
    arms = [
        tube([(0, 0, 0.02), (-0.09, 0, 0.2)], 0.006, steel()),
        tube([(-0.09, 0, 0.2), (0.07, 0, 0.36)], 0.006, steel()),
    ]
    shade = lathe([(0.016, 0.06), (0.02, 0.05), (0.062, -0.03), (0.06, -0.03), (0.0, 0.03)], color)
    return [*foot, *part("arms", arms), *part("shade", placed(shade, 0.09, z=0.345, roll=-0.6))]


def clock(rng: Random) -> Meshes:
    """A round alarm clock at ten past ten."""
    enamel, ink = plain(pick(rng, GLAZES), 0.08, 50), plain("#161616")
    case = lathe([(0, -0.027), (0.05, -0.027), (0.058, -0.02), (0.06, 0), (0.06, 0.024), (0.054, 0.028)], enamel)
    dial = worded((160, 160), "#f5f1e6", (("12", 0.12, 0.12), ("6", 0.12, 0.88), ("9        3", 0.12, 0.5)), "#161616")
    front = [
        sheet(
            [(-0.054, -0.0282, -0.054), (0.054, -0.0282, -0.054), (0.054, -0.0282, 0.054), (-0.054, -0.0282, 0.054)],
            painted(lambda: dial),
        )
    ]
    rim = placed([ring(0.056, 0.006, enamel)], tip=np.pi / 2, y=-0.027)
    hands = []
    for length, hours in ((0.026, 10.17), (0.04, 2.0)):
        angle = np.pi / 2 - hours * np.pi / 6
        hands.append(
            tube([(0, -0.0295, 0), (length * np.cos(angle), -0.0295, length * np.sin(angle))], 0.0016, ink, sides=6)
        )
    feet = [tube([(x, 0, -0.045), (1.2 * x, 0, -0.066)], 0.006, steel()) for x in (-0.038, 0.038)]
    whole = [*placed(case, tip=np.pi / 2), *part("dial", [*front, *hands]), *rim, *feet]
    return placed(whole, z=0.072)


def pen_cup(rng: Random) -> Meshes:
    """Hollow, empty."""
    color = pick(rng, GLAZES)
    wall = mottled((color, color), 60, 0.0, 0.05, 30, uneven=0.3)
    return [
        *lathe([(0, 0), (0.04, 0), (0.04, 0.1), (0.037, 0.1)], wall),
        *lathe([(0.037, 0.1), (0.037, 0.006), (0, 0.006)], plain("#3a3a3a")),
    ]


def stapler(rng: Random) -> Meshes:
    """A base and an arm of another color."""
    t = np.linspace(0, 1, 10)
    arm = bar(
        np.stack([-0.06 + 0.13 * t, 0 * t], axis=1), 0.014 - 0.003 * t, 0.022, plain(pick(rng, GLAZES), 0.07, 40), 0.016
    )
    return [*board((0.14, 0.032, 0.012), plain("#232427", 0.06)), *part("arm", placed(arm, roll=-0.08))]


def photo_frame(rng: Random) -> Meshes:
    """A picture in a wooden frame that leans."""
    picture = painted(print_landscape, 160, 120, int(rng.integers(1 << 30)), gloss=0.06, polish=80)
    wood = plain(pick(rng, ("#3a2618", "#1d1d1f", "#c9a36a")), 0.05, 30)
    print_ = sheet(
        [(-0.065, -0.0105, 0.02), (0.065, -0.0105, 0.02), (0.065, -0.0105, 0.19), (-0.065, -0.0105, 0.19)], picture
    )
    return placed([*box((0.16, 0.02, 0.21), wood, (0, 0, 0.105)), *part("picture", [print_])], tip=-0.2, z=0.003)


def cable(rng: Random) -> Meshes:
    """In coils, lying: thin, with a hole."""
    t = np.linspace(0, 1, 90)
    angle, radius = 2 * np.pi * 3.4 * t, 0.05 + 0.006 * np.sin(9 * t)
    path = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.005 + 0.004 * t], axis=1)
    return [tube(path, 0.0034, plain(pick(rng, GLAZES), 0.05), sides=8)]
