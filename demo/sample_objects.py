"""Tableware, books, a clock and a bear for the sample scene, in meters; each stands on z = 0 and faces -y.

Every function returns the objects it made.
"""

from __future__ import annotations

from math import pi

import numpy as np

from demo.sample_mesh import (
    Parts,
    ball,
    box,
    fur,
    grid,
    lathe,
    mottled,
    painted,
    picture,
    place,
    plain,
    spline,
    tube,
    writing,
)
from demo.sample_paint import bottle_label, cover


def bottle() -> Parts:
    """A wine bottle of dark glass (opaque: splats are) with a painted label."""
    glass = mottled("bottle glass", ("#1d3a24", "#2a5433"), 6, 0.16, coat_weight=0.5)
    body = lathe(
        "bottle",
        [
            (0, 0),
            (0.034, 0.001),
            (0.038, 0.008),
            (0.038, 0.15),
            (0.036, 0.172),
            (0.024, 0.2),
            (0.0155, 0.222),
            (0.0145, 0.245),
            (0.0145, 0.268),
            (0.017, 0.27),
            (0.017, 0.28),
            (0.013, 0.282),
            (0, 0.282),
        ],
        glass,
    )
    foil = lathe(
        "foil",
        [(0.0158, 0.222), (0.0152, 0.266), (0.0178, 0.269), (0.0178, 0.282), (0.012, 0.284), (0, 0.284)],
        plain("foil", "#8e2230", 0.35, metallic=0.4),
    )
    angle = np.linspace(-0.5 * pi - 2.2, -0.5 * pi + 2.2, 60)
    heights = np.array([0.045, 0.135])[:, None]
    sheet = np.stack(
        [0.0384 * np.cos(angle) + 0 * heights, 0.0384 * np.sin(angle) + 0 * heights, heights + 0 * angle], -1
    )
    label = grid("label", sheet, painted("label", bottle_label(300, 560, 11), 0.6))
    return [body, foil, label]


def cup() -> Parts:
    """A glazed mug of tea."""
    glaze = mottled("mug glaze", ("#f3efe4", "#e9e2d2", "#f6f2e9"), 25, 0.25, coat_weight=0.6)
    body = lathe(
        "mug",
        [
            (0, 0.003),
            (0.03, 0.003),
            (0.033, 0),
            (0.037, 0.003),
            (0.0405, 0.02),
            (0.0415, 0.09),
            (0.0405, 0.0925),
            (0.039, 0.09),
            (0.0385, 0.02),
            (0.034, 0.008),
            (0, 0.007),
        ],
        glaze,
    )
    tea = lathe("tea", [(0, 0.078), (0.0385, 0.078)], plain("tea", "#5a2c10", 0.08))
    loop = spline([(0.039, 0, 0.076), (0.058, 0, 0.08), (0.069, 0, 0.06), (0.06, 0, 0.034), (0.04, 0, 0.022)], 40)
    handle = tube("handle", loop, 0.0062, glaze, squash=1.25)
    stripe = lathe(
        "stripe",
        [(0.0414, 0.058), (0.04175, 0.0585), (0.0418, 0.0715), (0.0415, 0.072)],
        plain("mug stripe", "#c23b2e", 0.3),
    )
    return [body, tea, handle, stripe]


def bowl() -> Parts:
    """A wide stoneware bowl."""
    clay = mottled(
        "stoneware", ("#33586b", "#4d7c90", "#6d9aa8", "#3d6679"), 30, 0.3, 0.0006, (1, 1, 3), coat_weight=0.4
    )
    return [
        lathe(
            "bowl",
            [
                (0, 0.004),
                (0.04, 0.004),
                (0.044, 0),
                (0.05, 0.004),
                (0.078, 0.024),
                (0.098, 0.052),
                (0.106, 0.07),
                (0.1045, 0.0725),
                (0.102, 0.07),
                (0.093, 0.052),
                (0.072, 0.028),
                (0.045, 0.013),
                (0, 0.011),
            ],
            clay,
            sides=96,
        )
    ]


def teddy() -> Parts:
    """A sitting plush bear."""
    coat = mottled("plush", ("#8f6238", "#ad7b48", "#c08f5e"), 40, 0.9, sheen_weight=0.2)
    light = mottled("light plush", ("#dcc09a", "#ecd8b8"), 60, 0.9)
    black = plain("button", "#15100e", 0.15, coat_weight=0.8)
    shapes = [
        ("body", (0.058, 0.05, 0.066), (0, 0, 0.064), (), coat),
        ("head", (0.053, 0.049, 0.048), (0, -0.006, 0.16), (), coat),
        ("ear left", (0.02, 0.01, 0.02), (-0.041, 0.0, 0.202), (0, -0.4, 0), coat),
        ("ear right", (0.02, 0.01, 0.02), (0.041, 0.0, 0.202), (0, 0.4, 0), coat),
        ("arm left", (0.02, 0.02, 0.045), (-0.066, -0.02, 0.087), (-0.5, 0.55, 0), coat),
        ("arm right", (0.02, 0.02, 0.045), (0.066, -0.02, 0.087), (-0.5, -0.55, 0), coat),
        ("leg left", (0.026, 0.05, 0.025), (-0.045, -0.062, 0.026), (0, 0, -0.3), coat),
        ("leg right", (0.026, 0.05, 0.025), (0.045, -0.062, 0.026), (0, 0, 0.3), coat),
        ("tummy", (0.04, 0.02, 0.045), (0, -0.036, 0.064), (), light),
        ("snout", (0.024, 0.022, 0.019), (0, -0.05, 0.148), (), light),
        ("pad left", (0.018, 0.006, 0.018), (-0.06, -0.109, 0.026), (0, 0, -0.3), light),
        ("pad right", (0.018, 0.006, 0.018), (0.06, -0.109, 0.026), (0, 0, 0.3), light),
        ("inner left", (0.012, 0.004, 0.012), (-0.041, -0.0095, 0.202), (0, -0.4, 0), light),
        ("inner right", (0.012, 0.004, 0.012), (0.041, -0.0095, 0.202), (0, 0.4, 0), light),
    ]
    parts = [ball(name, radii, material, centre, turn) for name, radii, centre, turn, material in shapes]
    for k, obj in enumerate(parts):
        area = float(np.prod(np.sort(obj.dimensions)[1:]))
        fur(obj, int(90_000 * area) + 60, 0.0062 if k < 9 else 0.004, seed=k)
    parts += [ball(f"eye {s}", (0.0065, 0.005, 0.0065), black, (s * 0.02, -0.051, 0.172)) for s in (-1, 1)]
    parts += [ball("nose", (0.0095, 0.006, 0.0065), black, (0, -0.0735, 0.155))]
    smile = spline([(-0.012, -0.066, 0.138), (0, -0.073, 0.142), (0.012, -0.066, 0.138)], 16)
    parts += [tube("mouth", smile, 0.0012, black, 8)]
    ribbon = plain("ribbon", "#b5283a", 0.5)
    neck = np.linspace(0, 2 * pi, 50)
    parts += [
        tube(
            "ribbon",
            np.stack([0.042 * np.cos(neck), 0.037 * np.sin(neck) - 0.003, 0.12 + 0.004 * np.sin(neck)], axis=1),
            0.006,
            ribbon,
            12,
        )
    ]
    parts += [
        ball(f"bow {s}", (0.018, 0.007, 0.011), ribbon, (s * 0.018, -0.05, 0.116), (0, s * 0.3, 0)) for s in (-1, 1)
    ]
    return parts


def clock() -> Parts:
    """A twin-bell alarm clock at ten past ten."""
    teal, brass = plain("enamel", "#1f7a80", 0.25, coat_weight=0.6), plain("brass", "#c9983e", 0.28, metallic=0.9)
    ink, white = plain("ink", "#161616", 0.5), plain("dial", "#f7f3e8", 0.5)
    centre, front = np.array([0, 0, 0.075]), -0.0265
    rim = [
        (0, 0.027),
        (0.05, 0.027),
        (0.058, 0.02),
        (0.06, 0),
        (0.06, -0.022),
        (0.057, -0.027),
        (0.052, -0.0275),
        (0.051, -0.024),
    ]
    case, dial = lathe("case", [(r, -h) for r, h in rim], teal), lathe("dial", [(0.0525, 0.0255), (0, 0.0255)], white)
    for obj in (case, dial):
        obj.rotation_euler, obj.location = (pi / 2, 0, 0), centre
    parts: Parts = [case, dial]
    for hour in range(1, 13):
        angle = pi / 2 - hour * pi / 6
        at = centre + np.array([0.041 * np.cos(angle), front + 0.0002, 0.041 * np.sin(angle)])
        parts.append(writing(str(hour), 0.0165, at, (pi / 2, 0, 0), ink))
    for length, width, hours in ((0.024, 0.0052, 10.17), (0.037, 0.0036, 2.0)):
        angle = pi / 2 - hours * pi / 6
        hand = box(
            "hand",
            (length, 0.001, width),
            ink,
            (centre + 0.42 * length * np.array([np.cos(angle), 0, np.sin(angle)]) + (0, front - 0.001, 0)).tolist(),
            0,
        )
        hand.rotation_euler = (0, -angle, 0)
        parts.append(hand)
    parts.append(ball("hub", (0.004, 0.002, 0.004), brass, centre + np.array([0, front - 0.002, 0])))
    for side in (-1, 1):
        bell = lathe("bell", [(0.024, 0), (0.023, 0.008), (0.016, 0.016), (0, 0.019)], brass)
        bell.location, bell.rotation_euler = centre + np.array([side * 0.035, 0, 0.056]), (0, side * 0.5, 0)
        parts += [
            bell,
            tube(
                "leg",
                [(side * 0.035, 0, 0.035), (side * 0.045, 0, 0.015), (side * 0.05, 0, 0.004)],
                [0.006, 0.006, 0.0075],
                brass,
                16,
            ),
        ]
    parts.append(
        tube(
            "hanger",
            spline([(-0.02, 0, 0.14), (-0.012, 0, 0.168), (0.012, 0, 0.168), (0.02, 0, 0.14)], 24),
            0.0024,
            brass,
            12,
        )
    )
    return parts


def book(number: int) -> Parts:
    """A hardback: 0 lies below, 1 on top of it and turned."""
    paper = mottled("pages", ("#e6dcc4", "#f5eedd", "#d8cbb0"), 40, 0.9, 0, (0.2, 0.2, 60))
    colour, art, title, letters = (
        ("#1f4e79", cover(440, 330, 21, ("#163a5c", "#1f4e79", "#2f6a9c", "#c98a4a")), "TIDES", "#f7e7c4"),
        ("#9c2f2f", cover(440, 330, 33, ("#7c2230", "#a93a34", "#d0643f", "#e9b260")), "GARDEN", "#fff4dc"),
    )[number]
    w, d, h = (0.15, 0.205, 0.026) if number else (0.17, 0.23, 0.03)
    base = 0.0306 if number else 0.0
    board = plain(f"board {number}", colour, 0.6)
    parts: Parts = [
        box("pages", (w - 0.008, d - 0.01, h - 0.005), paper, (0.002, 0, base + h / 2), 0.0005),
        box("back", (w, d, 0.003), board, (0, 0, base + 0.0015), 0.001),
        box("front", (w, d, 0.003), board, (0, 0, base + h - 0.0015), 0.001),
        box("spine", (0.004, d, h), board, (-w / 2, 0, base + h / 2), 0.0015),
        picture(
            f"cover {number}",
            np.array([[-w, -d, 0], [w, -d, 0], [w, d, 0], [-w, d, 0]]) * 0.485 + (0, 0, base + h + 0.0004),
            art,
            0.45,
        ),
        writing(title, 0.03, (0, d * 0.24, base + h + 0.0008), (0, 0, 0), plain(f"letters {number}", letters, 0.5)),
        writing(
            "a field guide" if number else "a handbook",
            0.014,
            (0, d * 0.1, base + h + 0.0008),
            (0, 0, 0),
            plain(f"small {number}", letters, 0.5),
        ),
        writing(
            title,
            h * 0.7,
            (-w / 2 - 0.0022, 0, base + h / 2),
            (pi / 2, 0, -pi / 2),
            plain(f"spine letters {number}", letters, 0.5),
        ),
    ]
    return place(parts, 0.006, 0.004, 0.3) if number else parts


def plate() -> Parts:
    """A small plate with a painted rim."""
    return [
        lathe(
            "plate",
            [
                (0, 0.004),
                (0.08, 0.004),
                (0.082, 0),
                (0.088, 0.003),
                (0.124, 0.014),
                (0.125, 0.016),
                (0.122, 0.0165),
                (0.09, 0.0085),
                (0, 0.0075),
            ],
            plain("porcelain", "#efece4", 0.25, coat_weight=0.4),
        ),
        lathe(
            "rim", [(0.108, 0.0132), (0.12, 0.0166)], mottled("rim paint", ("#1f4e79", "#4f83b5", "#2a5d8e"), 90, 0.3)
        ),
    ]


def knife() -> Parts:
    """A kitchen knife with a riveted wooden handle, lying on its side."""
    steel = mottled("blade steel", ("#aeb4b9", "#d3d7da"), 70, 0.28, 0, (0.15, 1, 1), metallic=0.9)
    wood = mottled("handle wood", ("#3a2216", "#6b4127", "#52301d"), 40, 0.5, 0, (0.2, 1, 1))
    along = np.linspace(0, 1, 40)
    low = np.interp(along, [0, 0.5, 0.8, 1], [-0.019, -0.018, -0.011, 0.012])
    across = np.linspace(0, 1, 6)
    y = low[:, None] + (0.014 - low[:, None]) * across
    blade = grid("blade", np.stack([0.02 + 0.14 * along[:, None] + 0 * across, y, 0.008 + 0 * y], axis=-1), steel)
    blade.modifiers.new("thick", "SOLIDIFY").thickness = 0.0018
    parts = [blade, box("handle", (0.105, 0.024, 0.015), wood, (-0.034, 0.001, 0.0085), 0.005)]
    parts += [ball("rivet", (0.003, 0.003, 0.001), steel, (x, 0.001, 0.016)) for x in (-0.065, -0.034, -0.003)]
    return parts
