"""What stands in kitchens, in meters; every function draws its colors from `rng`."""

from __future__ import annotations

import numpy as np

from benchmarks.rooms.materials import Material, mottled, painted, plain, worded
from benchmarks.rooms.shapes import Meshes, ball, bar, board, box, curve, grid, lathe, part, placed, tube
from demo.sample_paint import bottle_label

Random = np.random.Generator

GLAZES = ("#b8352b", "#2f5f8f", "#e0b23c", "#3f7d5a", "#e8e2d4", "#7a4f8a", "#d9743a", "#2c3440", "#5aa3a8")
WOODS = (("#5a3a22", "#8a6038", "#6e4a2a"), ("#a87a48", "#caa06a", "#b98c58"), ("#3a2216", "#6b4127", "#52301d"))


def pick(rng: Random, options: tuple[str, ...], but: str = "") -> str:
    """One of them, another than `but`."""
    left = [option for option in options if option != but]
    return left[int(rng.integers(len(left)))]


def grained(rng: Random, along: int = 0, gloss: float = 0.04) -> Material:
    """Wood whose grain runs along an axis of the object."""
    stretch = [1.0, 1.0, 1.0]
    stretch[along] = 0.12
    return mottled(WOODS[int(rng.integers(len(WOODS)))], 70, 1.2, gloss, stretch=stretch)


def steel(along: int = 0) -> Material:
    """Brushed along an axis of the object."""
    stretch = [1.0, 1.0, 1.0]
    stretch[along] = 0.1
    return mottled(("#a3a9ae", "#ced3d7"), 110, 1.0, polish=35, stretch=stretch, metal=True)


def mug(rng: Random) -> Meshes:
    """Outside of one color, inside and handle of another: one object of two materials."""
    color = pick(rng, GLAZES)
    outer, inner = mottled((color, color), 30, 0.0, 0.06, 60, uneven=0.12), plain(pick(rng, GLAZES, color), 0.06, 60)
    body = lathe([(0, 0.002), (0.03, 0.0), (0.036, 0.004), (0.0405, 0.02), (0.0415, 0.088), (0.0405, 0.0915)], outer)
    inside = lathe([(0.0405, 0.0915), (0.0385, 0.0895), (0.0375, 0.02), (0.032, 0.008), (0, 0.007)], inner)
    loop = curve([(0.039, 0, 0.076), (0.058, 0, 0.08), (0.069, 0, 0.06), (0.06, 0, 0.034), (0.04, 0, 0.022)], 24)
    return [*body, *inside, *part("handle", [tube(loop, 0.006, inner, squash=1.25)])]


def bottle(rng: Random) -> Meshes:
    """Of dark glass, opaque, with a cap and a paper label."""
    color = pick(rng, ("#1d3a24", "#4a2312", "#27384f"))
    glass, cap = mottled((color, color), 9, 0.0, 0.09, 90, uneven=0.3), plain(pick(rng, GLAZES), 0.05, 40)
    profile = [(0, 0), (0.034, 0.001), (0.038, 0.008), (0.038, 0.15), (0.036, 0.172), (0.024, 0.2), (0.0155, 0.222)]
    body = lathe([*profile, (0.0145, 0.245), (0.0145, 0.262)], glass)
    top = lathe([(0.0165, 0.25), (0.0168, 0.281), (0.013, 0.284), (0, 0.284)], cap)
    label = _band(0.0385, 0.045, 0.135, painted(bottle_label, 180, 330, int(rng.integers(1 << 30))), 4.4)
    return [*body, *part("cap", top), *part("label", label)]


def jar(rng: Random) -> Meshes:
    """Of preserves, with a lid and a label."""
    name, color = (("PLUM", "#5a1f3a"), ("HONEY", "#d08a1f"), ("OLIVES", "#5f6b2a"), ("PEPPER", "#a3301f"))[
        int(rng.integers(4))
    ]
    body = lathe(
        [(0, 0), (0.036, 0.001), (0.041, 0.01), (0.041, 0.085), (0.034, 0.1)],
        mottled((color, color), 60, 0.0, 0.08, 80, uneven=0.35),
    )
    lid = lathe([(0.036, 0.096), (0.0365, 0.116), (0.033, 0.119), (0, 0.119)], plain(pick(rng, GLAZES), 0.08, 40))
    paper = worded((120, 300), pick(rng, ("#f3ead2", "#e9efe4", "#f6e0d4")), ((name, 0.3, 0.4), ("250 g", 0.14, 0.75)))
    return [*body, *part("lid", lid), *part("label", _band(0.0416, 0.022, 0.074, painted(lambda: paper), 3.4))]


def can(rng: Random) -> Meshes:
    """A tin with a paper sleeve."""
    name = ("BEANS", "SOUP", "CORN", "TUNA")[int(rng.integers(4))]
    ends = [
        (0, 0),
        (0.037, 0),
        (0.038, 0.003),
        (0.037, 0.006),
        (0.037, 0.104),
        (0.038, 0.107),
        (0.037, 0.11),
        (0.034, 0.108),
        (0, 0.108),
    ]
    ground = pick(rng, GLAZES)
    paper = worded(
        (200, 420),
        ground,
        ((name, 0.22, 0.3), ("in water", 0.08, 0.55), ("400 g", 0.1, 0.78)),
        "#fdf8ea" if ground != "#e8e2d4" else "#333333",
    )
    return [
        *lathe(ends, steel()),
        *part("label", _band(0.0376, 0.008, 0.102, painted(lambda: paper, gloss=0.05), 2 * np.pi)),
    ]


def _band(radius: float, low: float, high: float, material: Material, width: float) -> Meshes:
    """Paper around a vessel, its middle in front; `width` in radians."""
    angle = np.linspace(-0.5 * (np.pi + width), 0.5 * (width - np.pi), 48)
    heights = np.linspace(low, high, 3)[:, None]
    sheet = [radius * np.cos(angle) + 0 * heights, radius * np.sin(angle) + 0 * heights, heights + 0 * angle]
    return [grid(np.stack(sheet, axis=-1), material)]


def bowl(rng: Random) -> Meshes:
    """Wide and hollow."""
    color, inside = pick(rng, GLAZES), pick(rng, GLAZES)
    outer = [(0, 0.004), (0.04, 0.004), (0.044, 0), (0.05, 0.004), (0.078, 0.024), (0.098, 0.052), (0.106, 0.07)]
    inner = [(0.106, 0.07), (0.102, 0.07), (0.093, 0.052), (0.072, 0.028), (0.045, 0.013), (0, 0.011)]
    clay = mottled((color, color), 35, 0.0, 0.05, 45, uneven=0.25)
    return [*lathe(outer, clay, sides=48), *lathe(inner, plain(inside, 0.05, 45), sides=48)]


def plate(rng: Random) -> Meshes:
    """With a painted rim."""
    profile = [(0, 0.004), (0.075, 0.004), (0.082, 0), (0.088, 0.003), (0.124, 0.014), (0.125, 0.016), (0.122, 0.0165)]
    white = plain("#e9e6de", 0.06, 60)
    rim = lathe([(0.104, 0.0128), (0.121, 0.0172)], plain(pick(rng, GLAZES, "#e8e2d4"), 0.06, 60), sides=48)
    return [
        *lathe(profile, white, sides=48),
        *lathe([(0.122, 0.0165), (0.09, 0.0085), (0, 0.0075)], white, sides=48),
        *rim,
    ]


def knife(rng: Random) -> Meshes:
    """A blade and a handle of another material; it lies on its side along x."""
    along = np.linspace(0, 1, 16)
    low = np.interp(along, [0, 0.5, 0.8, 1], [-0.02, -0.019, -0.012, 0.012])
    middle, half = (low + 0.014) / 2, np.maximum((0.014 - low) / 2, 0.0005)
    blade = bar(np.stack([0.018 + 0.15 * along, middle], axis=1), half, 0.002, steel(), 0.007)
    handle = [ball((0.058, 0.0135, 0.0085), grained(rng), (-0.034, -0.001, 0.0085), boxy=0.45)]
    return [*part("blade", blade), *part("handle", handle)]


def fork(rng: Random) -> Meshes:
    """Lying along x, thin."""
    metal = steel()
    t = np.linspace(0, 1, 20)
    neck = bar(
        np.stack([-0.1 + 0.14 * t, 0 * t], axis=1),
        np.interp(t, [0, 0.3, 0.8, 1], [0.007, 0.005, 0.003, 0.009]),
        0.003,
        metal,
        0.001,
    )
    tines = [
        bar(np.stack([0.038 + 0.05 * t, 0 * t + y], axis=1), 0.0014, 0.003, metal, 0.003)
        for y in (-0.0082, -0.0028, 0.0028, 0.0082)
    ]
    return [*neck, *(mesh for tine in tines for mesh in tine)]


def spoon(rng: Random) -> Meshes:
    """A wooden or a steel one, lying along x."""
    metal = steel() if rng.uniform() < 0.5 else grained(rng)
    t = np.linspace(0, 1, 20)
    shaft = bar(
        np.stack([-0.1 + 0.16 * t, 0 * t], axis=1),
        np.interp(t, [0, 0.4, 1], [0.008, 0.005, 0.004]),
        0.004,
        metal,
        0.002,
    )
    return [*shaft, ball((0.03, 0.019, 0.005), metal, (0.078, 0, 0.006))]


def pan(rng: Random) -> Meshes:
    """Hollow, with a long handle along x."""
    iron = mottled(("#2c2e31", "#3a3d41"), 80, 1.0, 0.08, 30)
    outside = [(0, 0), (0.105, 0), (0.118, 0.012), (0.13, 0.048), (0.133, 0.05)]
    inside = [(0.133, 0.05), (0.127, 0.047), (0.115, 0.014), (0.102, 0.005), (0, 0.005)]
    handle = [
        tube(
            [(0.128, 0, 0.04), (0.18, 0, 0.052), (0.25, 0, 0.062), (0.31, 0, 0.064)],
            [0.007, 0.009, 0.011, 0.009],
            grained(rng),
            squash=0.6,
        )
    ]
    return [*lathe(outside, iron, sides=48), *lathe(inside, iron, sides=48), *part("handle", handle)]


def cutting_board(rng: Random) -> Meshes:
    """A plank that lies flat."""
    return board((0.34, 0.22, 0.018), grained(rng))


def bread(rng: Random) -> Meshes:
    """A loaf."""
    crust = mottled(("#7a4718", "#b9772e", "#d9a660", "#8f5a22"), 45, 1.3)
    return [ball((0.12, 0.055, 0.05), crust, (0, 0, 0.046), boxy=0.8)]


def apple(rng: Random) -> Meshes:
    """With its stalk."""
    tones = (("#8a1520", "#b5242a", "#c95a4a"), ("#7f9c30", "#a2b850", "#bcc66c"), ("#c9a23a", "#d8b84a", "#c8542e"))
    skin = mottled(tones[int(rng.integers(3))], 42, 1.1, 0.05, 40, stretch=(1, 1, 0.25))
    profile = [(0, 0.007), (0.007, 0.002), (0.015, 0.001), (0.0265, 0.012), (0.0365, 0.036), (0.0385, 0.052)]
    body = lathe([*profile, (0.0315, 0.068), (0.019, 0.0735), (0.007, 0.067), (0, 0.058)], skin, count=22)
    stalk = tube(curve([(0, 0, 0.058), (0.001, 0, 0.074), (0.007, 0.002, 0.09)], 8), 0.0017, plain("#4a3320"), sides=8)
    return [*body, stalk]


def orange(rng: Random) -> Meshes:
    """With pored peel."""
    return [
        ball((0.038, 0.0375, 0.0355), mottled(("#d9680a", "#f09a22", "#e98512"), 120, 0.8, 0.04, 30), (0, 0, 0.0355))
    ]


def lemon(rng: Random) -> Meshes:
    """Lying along x."""
    profile = [(0, -0.042), (0.006, -0.038), (0.022, -0.024), (0.0275, 0.0), (0.022, 0.024), (0.006, 0.038), (0, 0.042)]
    return placed(
        lathe(profile, mottled(("#d8b51f", "#efd23c"), 110, 0.8, 0.04, 30), count=20, sides=28), z=0.027, roll=np.pi / 2
    )


def banana(rng: Random) -> Meshes:
    """One, lying on its side."""
    bend = np.linspace(-0.85, 0.85, 24)
    path = np.stack([0.11 * np.sin(bend), 0.11 * (np.cos(bend) - 1) + 0.02, 0 * bend + 0.0175], axis=1)
    radius = 0.0175 * np.minimum(np.interp(bend, [-0.85, -0.6, 0.6, 0.85], [0.35, 0.95, 0.95, 0.3]), 1)
    peel = mottled(("#c99a1c", "#f2cd34", "#f6d84a", "#8a6a20"), 34, 0.8, 0.04, 25)
    tips = [
        tube(np.stack([path[k], path[k] + (path[k] - path[j])]), 0.0052, plain("#4a3b1e"), sides=8)
        for k, j in ((0, 2), (-1, -3))
    ]
    return [tube(path, radius, peel, sides=10), *tips]


def pear(rng: Random) -> Meshes:
    """Standing."""
    profile = [
        (0, 0.004),
        (0.015, 0.0),
        (0.032, 0.016),
        (0.036, 0.036),
        (0.028, 0.06),
        (0.017, 0.08),
        (0.012, 0.094),
        (0, 0.099),
    ]
    skin = mottled(("#93a03a", "#b9b650", "#a8793a"), 50, 1.0, 0.04, 30)
    return [
        *lathe(profile, skin, count=24),
        tube([(0, 0, 0.095), (0.002, 0, 0.108), (0.006, 0, 0.12)], 0.0018, plain("#4a3320"), sides=8),
    ]


def vase(rng: Random) -> Meshes:
    """Painted, with a narrow neck."""
    color = pick(rng, GLAZES)
    glaze = mottled(("#f1e9da", color, "#f4eee2", color), 26, 1.2, 0.06, 55)
    profile = [
        (0, 0),
        (0.03, 0),
        (0.036, 0.01),
        (0.054, 0.06),
        (0.05, 0.105),
        (0.028, 0.145),
        (0.022, 0.165),
        (0.03, 0.185),
    ]
    return lathe([*profile, (0.027, 0.184), (0.018, 0.165), (0.02, 0.14)], glaze, count=44)


def toaster(rng: Random) -> Meshes:
    """With two slots and a lever."""
    shell, dark = plain(pick(rng, GLAZES), 0.08, 40), plain("#1b1c1e")
    body = [ball((0.14, 0.085, 0.09), shell, (0, 0, 0.1), boxy=0.3)]
    slots = [mesh for y in (-0.028, 0.028) for mesh in box((0.2, 0.018, 0.004), dark, (0, y, 0.189))]
    lever = box((0.012, 0.04, 0.016), dark, (0.145, 0, 0.12))
    return [*body, *box((0.24, 0.14, 0.014), dark, (0, 0, 0.007)), *slots, *part("lever", lever)]


def kettle(rng: Random) -> Meshes:
    """With a spout along x, a lid and a handle above."""
    enamel = plain(pick(rng, GLAZES), 0.08, 60)
    black = plain("#202022", 0.05, 30)
    body = lathe([(0, 0), (0.085, 0.002), (0.092, 0.015), (0.085, 0.08), (0.05, 0.135)], enamel, sides=40)
    lid = lathe([(0.052, 0.133), (0.035, 0.15), (0.012, 0.155), (0.012, 0.168), (0.008, 0.174), (0, 0.175)], black)
    spout = tube(curve([(0.07, 0, 0.07), (0.11, 0, 0.1), (0.135, 0, 0.142)], 12), np.linspace(0.022, 0.011, 12), enamel)
    loop = tube(
        curve([(-0.07, 0, 0.1), (-0.085, 0, 0.19), (0, 0, 0.235), (0.075, 0, 0.19), (0.062, 0, 0.115)], 28),
        0.008,
        black,
    )
    return [*body, spout, *part("lid", lid), *part("handle", [loop])]
