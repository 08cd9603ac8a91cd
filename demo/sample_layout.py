"""Where each object stands on the sample scene's table: meters from the table's middle, turned about z."""

from __future__ import annotations

from collections.abc import Callable

from demo.sample_flora import plant, tulips, vase
from demo.sample_food import apple, banana, donut, orange
from demo.sample_mesh import Parts, place
from demo.sample_objects import book, bottle, bowl, clock, cup, knife, plate, teddy

_RED = ("#8a1520", "#a81c26", "#b5242a", "#c95a4a")
_GREEN = ("#7f9c30", "#94ae42", "#a2b850", "#bcc66c")

# Label: builders of its copies. Labels have ids from 1 in this order, and so have objects, every copy counted; the room
# adds the table itself.
OBJECTS: dict[str, tuple[Callable[[], Parts], ...]] = {
    "apple": (
        lambda: place(apple(_RED, 1), 0.045, -0.005, 0.4, 0.016, 0.15),
        lambda: place(apple(_GREEN, 2), -0.06, -0.2, 1.9, 0.0, 0.0),
    ),
    "banana": (lambda: place(banana(), 0.15, -0.2, 0.2),),
    "book": (
        lambda: place(book(0), -0.27, -0.13, 0.3),
        lambda: place(book(1), -0.27, -0.13, 0.3),
    ),
    "bottle": (lambda: place(bottle(), 0.19, 0.27, 0.1),),
    "bowl": (lambda: place(bowl(), 0.08, 0.03, 0.0),),
    "clock": (lambda: place(clock(), -0.35, 0.06, 0.08, 0.0005, -0.1, 1.1),),
    "cup": (lambda: place(cup(), -0.1, -0.02, 0.35),),
    "donut": (
        lambda: place(donut(("#3a1d10", "#522b18"), 9), 0.335, -0.015, 0.0, 0.012),
        lambda: place(donut(("#e79bb4", "#efb3c6"), 10), 0.285, -0.115, 0.0, 0.012),
    ),
    "knife": (lambda: place(knife(), -0.16, -0.33, 0.12),),
    "orange": (
        lambda: place(orange(1), 0.115, 0.065, 0.8, 0.02, 0.4),
        lambda: place(orange(2), 0.02, -0.31, 2.0, 0.0, 0.25),
    ),
    "plate": (lambda: place(plate(), 0.31, -0.065, 0.0),),
    "potted plant": (lambda: place(plant(), -0.245, 0.28, 0.0, scale=0.92),),
    "teddy bear": (lambda: place(teddy(), -0.005, 0.25, -0.05, scale=1.12),),
    "tulip": (lambda: place(tulips(), 0.34, 0.16, 0.0),),
    "vase": (lambda: place(vase(), 0.34, 0.16, 0.0),),
}
