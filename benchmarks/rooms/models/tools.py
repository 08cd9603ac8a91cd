"""Tools and what belongs to a workshop, in meters. Flat ones lie along x."""

from __future__ import annotations

import numpy as np

from benchmarks.rooms.materials import mottled, painted, plain, worded
from benchmarks.rooms.models.tableware import GLAZES, Random, grained, pick, steel
from benchmarks.rooms.shapes import Meshes, ball, bar, box, curve, lathe, part, placed, resting, ring, tube

_GRIPS = ("#b8352b", "#e0a21c", "#2f5f8f", "#3f7d5a", "#d9743a")


def hammer(rng: Random) -> Meshes:
    """A steel head on a wooden handle; lying."""
    iron = mottled(("#4b4f54", "#6b7076"), 90, 1.0, polish=25, metal=True)
    face = lathe(
        [(0, 0), (0.0135, 0.001), (0.0145, 0.006), (0.011, 0.014), (0.011, 0.03), (0.013, 0.032)], iron, sides=24
    )
    head = [
        *placed(face, 0.115, -0.055, tip=-np.pi / 2, z=0.016),
        *box((0.028, 0.036, 0.026), iron, (0.115, -0.006, 0.016)),
    ]
    claw = np.linspace(0, 1, 12)
    head += bar(
        np.stack([0.115 + 0.02 * claw**2, 0.012 + 0.05 * claw], axis=1), 0.012 * (1 - 0.4 * claw), 0.009, iron, 0.011
    )
    shaft = [
        tube(
            [(-0.2, 0, 0.016), (-0.12, 0, 0.016), (0, 0, 0.016), (0.13, 0, 0.016)],
            [0.013, 0.0155, 0.0105, 0.0105],
            grained(rng),
            squash=0.8,
        )
    ]
    return [*part("head", head), *part("handle", shaft)]


def screwdriver(rng: Random) -> Meshes:
    """A blade in a grip of another color; lying."""
    grip = plain(pick(rng, _GRIPS), 0.06, 40)
    profile = [
        (0, 0),
        (0.012, 0.002),
        (0.0155, 0.012),
        (0.015, 0.05),
        (0.0125, 0.075),
        (0.0145, 0.086),
        (0.008, 0.096),
        (0, 0.097),
    ]
    handle = placed(lathe(profile, grip, sides=16, count=26), -0.1, roll=np.pi / 2, z=0.0155)
    blade = [
        tube([(-0.006, 0, 0.0155), (0.1, 0, 0.0155), (0.115, 0, 0.0155)], [0.0035, 0.0035, 0.0028], steel(), sides=10)
    ]
    return [*part("handle", handle), *part("shaft", blade)]


def wrench(rng: Random) -> Meshes:
    """An open-ended one, thin and flat."""
    metal = steel()
    meshes = bar([(-0.085, 0), (-0.04, 0), (0.04, 0), (0.085, 0)], [0.0095, 0.0075, 0.0075, 0.0095], 0.006, metal)
    for side, size in ((1, 0.015), (-1, 0.0125)):
        arc = np.linspace(0.75, 2 * np.pi - 0.75, 22) + (0 if side > 0 else np.pi) + 0.25
        center = np.array([side * (0.085 + 0.9 * size), 0.0])
        jaw = center + size * np.stack([np.cos(arc), np.sin(arc)], axis=1)
        meshes += bar(jaw, 0.006, 0.007, metal)
    return meshes


def pliers(rng: Random) -> Meshes:
    """Two halves that cross, with colored grips; one object."""
    metal, grip = steel(), plain(pick(rng, _GRIPS), 0.05, 30)
    halves: Meshes = []
    for side in (-1, 1):
        jaw = curve([(0.0, 0), (0.02, side * 0.013), (0.045, side * 0.009), (0.07, side * 0.0035)], 12)
        halves += part("jaws", bar(jaw, [0.009] * 6 + [0.008, 0.007, 0.006, 0.005, 0.004, 0.003], 0.008, metal, 0.002))
        leg = curve([(0.0, 0), (-0.03, -side * 0.014), (-0.075, -side * 0.024), (-0.125, -side * 0.02)], 16)
        path = np.concatenate([leg, np.full((16, 1), 0.008)], axis=1)
        halves += part("grips", [tube(path, np.linspace(0.0075, 0.0085, 16), grip, sides=10)])
    return [*halves, *part("jaws", lathe([(0, 0.012), (0.0085, 0.012), (0.0085, 0.0)], metal, sides=16))]


def scissors(rng: Random) -> Meshes:
    """Two blades that cross and two rings; one object, thin."""
    metal, grip = steel(), plain(pick(rng, _GRIPS), 0.06, 40)
    meshes: Meshes = []
    for side in (-1, 1):
        turn, level = side * 0.17, 0.003 if side > 0 else 0.0055
        blade = bar(
            [(-0.03, 0), (0.0, 0), (0.05, 0.001), (0.095, 0.004)], [0.006, 0.008, 0.0065, 0.0008], 0.0022, metal, level
        )
        shank = bar([(-0.03, 0), (-0.055, -0.004)], [0.005, 0.0055], 0.005, grip, 0.002)
        loop = placed([ring(0.019, 0.0048, grip)], -0.079, -0.006, z=0.005, scale=1.0)
        meshes += placed([*part("blades", blade), *part("handles", [*shank, *loop])], turn=turn)
    return [*meshes, ball((0.0045, 0.0045, 0.002), metal, (0, 0, 0.0085))]


def saw(rng: Random) -> Meshes:
    """A wide blade and a wooden handle with a hole; lying."""
    t = np.linspace(0, 1, 14)
    blade = bar(np.stack([-0.1 + 0.38 * t, 0.012 * (1 - t)], axis=1), 0.052 - 0.026 * t, 0.0016, steel(), 0.009)
    handle = grained(rng)
    loop = curve(
        [(-0.09, 0.062), (-0.16, 0.07), (-0.19, 0.02), (-0.175, -0.045), (-0.11, -0.05), (-0.075, 0.0), (-0.09, 0.062)],
        30,
    )
    return [*part("blade", blade), *part("handle", bar(loop, 0.014, 0.02, handle))]


def chisel(rng: Random) -> Meshes:
    """A flat blade, a wooden handle; lying."""
    blade = bar([(0, 0), (0.03, 0), (0.05, 0), (0.12, 0)], [0.004, 0.004, 0.0095, 0.0095], 0.0035, steel(), 0.0105)
    handle = lathe(
        [(0, 0), (0.011, 0.001), (0.0135, 0.02), (0.0125, 0.07), (0.01, 0.11), (0.0085, 0.115), (0, 0.116)],
        grained(rng, 2),
        sides=20,
    )
    return [*part("blade", blade), *part("handle", placed(handle, -0.114, roll=np.pi / 2, z=0.0135))]


def tape_measure(rng: Random) -> Meshes:
    """A case with a label and a bit of tape."""
    color = pick(rng, _GRIPS)
    case = [ball((0.036, 0.018, 0.034), plain(color, 0.05, 35), (0, 0, 0.034), boxy=0.35)]
    badge = lathe([(0.02, 0.0182), (0, 0.0182)], plain("#1d1d1f", 0.05), sides=24)
    tape = box((0.07, 0.014, 0.0012), plain("#e8c62a"), (0.06, 0, 0.006))
    return [*case, *part("label", placed(badge, tip=np.pi / 2, z=0.034)), *part("tape", tape)]


def brush(rng: Random) -> Meshes:
    """A flat paint brush: bristles, ferrule, handle; lying."""
    t = np.linspace(0, 1, 14)
    handle = bar(
        np.stack([-0.13 + 0.14 * t, 0 * t], axis=1),
        0.006 + 0.009 * np.sin(np.pi * t) ** 2 + 0.006 * t,
        0.011,
        plain(pick(rng, GLAZES), 0.07, 50),
        0.001,
    )
    ferrule = box((0.03, 0.046, 0.013), steel(1), (0.024, 0, 0.0065))
    bristles = bar(
        np.stack([0.038 + 0.052 * t, 0 * t], axis=1),
        0.0225 - 0.003 * t,
        0.01,
        mottled(("#3a2a1c", "#a98a5e"), 500, 1.5, stretch=(0.05, 1, 1)),
        0.0015,
    )
    return [*part("handle", handle), *part("ferrule", ferrule), *part("bristles", bristles)]


def tape_roll(rng: Random) -> Meshes:
    """Of adhesive tape: hollow, lying."""
    outer, core = plain(pick(rng, GLAZES), 0.06, 40), plain("#b08a5a")
    roll = lathe([(0.034, 0.0), (0.048, 0.0), (0.048, 0.025), (0.034, 0.025)], outer, sides=40)
    return [*roll, *lathe([(0.034, 0.025), (0.034, 0.0)], core, sides=40)]


def paint_tin(rng: Random) -> Meshes:
    """With a wire handle and a label all around."""
    ground = pick(rng, GLAZES)
    words, ink = (("PAINT", 0.25, 0.35), ("matt 750 ml", 0.12, 0.7)), "#fffbee" if ground != "#e8e2d4" else "#333333"
    label = painted(worded, (160, 460), ground, words, ink)
    shell = lathe([(0, 0), (0.05, 0), (0.051, 0.003), (0.05, 0.006)], steel())
    rim = lathe([(0.05, 0.104), (0.0515, 0.107), (0.05, 0.112), (0.043, 0.112), (0.042, 0.107), (0, 0.107)], steel())
    sleeve = lathe([(0.0502, 0.006), (0.0502, 0.104)], label, sides=48)
    wire = tube(
        curve(
            [(-0.052, 0, 0.09), (-0.045, -0.03, 0.06), (0, -0.062, 0.045), (0.045, -0.03, 0.06), (0.052, 0, 0.09)], 20
        ),
        0.0016,
        steel(),
        sides=8,
    )
    return [*shell, *rim, *part("label", sleeve), *part("handle", [wire])]


def toolbox(rng: Random) -> Meshes:
    """A case of sheet metal with a handle and two latches."""
    color = pick(rng, _GRIPS)
    body, lid = plain(color, 0.06, 30), plain("#2a2b2e", 0.06, 30)
    meshes = [*box((0.4, 0.2, 0.13), body, (0, 0, 0.065)), *box((0.405, 0.205, 0.055), lid, (0, 0, 0.158))]
    latches = [mesh for x in (-0.12, 0.12) for mesh in box((0.04, 0.012, 0.05), steel(2), (x, -0.105, 0.13))]
    handle = [
        tube(
            curve([(-0.09, 0, 0.186), (-0.08, 0, 0.225), (0, 0, 0.235), (0.08, 0, 0.225), (0.09, 0, 0.186)], 20),
            0.011,
            plain("#171719"),
        )
    ]
    return [*meshes, *part("latches", latches), *part("handle", handle)]


def crate(rng: Random) -> Meshes:
    """Of boards, without a lid: hollow."""
    wood = grained(rng)
    meshes = box((0.36, 0.24, 0.012), wood, (0, 0, 0.006))
    for z in (0.045, 0.115):
        for side in (-1, 1):
            meshes += box((0.36, 0.012, 0.055), wood, (0, side * 0.114, z))
            meshes += box((0.012, 0.216, 0.055), wood, (side * 0.174, 0, z))
    for x in (-0.155, 0.155):
        for y in (-0.1, 0.1):
            meshes += box((0.024, 0.016, 0.14), wood, (x, y, 0.078))
    return meshes


def clamp(rng: Random) -> Meshes:
    """A screw clamp, lying: a frame and a spindle with a wooden grip."""
    iron = plain(pick(rng, _GRIPS), 0.06, 30)
    frame = bar([(-0.09, 0.05), (-0.09, -0.045), (0.09, -0.045), (0.09, 0.05)], 0.009, 0.012, iron, 0.004)
    spindle = [tube([(-0.15, 0.045, 0.012), (0.07, 0.045, 0.012)], 0.006, steel(), sides=10)]
    grip = resting([tube([(-0.22, 0.045, 0.014), (-0.145, 0.045, 0.014)], 0.013, grained(rng))])
    return [*frame, *part("spindle", spindle), *part("handle", grip)]
