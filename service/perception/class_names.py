"""What an open-set detector looks for when nobody names anything: things of homes, offices and streets."""

from __future__ import annotations

from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.detectors.coco import COCO_80

_MORE = """table, desk, shelf, cabinet, drawer, wardrobe, stool, armchair, sofa cushion, pillow, blanket, carpet,
curtain, window, door, mirror, picture frame, lamp, ceiling lamp, candle, plate, pan, pot, kettle, coffee
machine, jar, can, mug, glass, tray, basket, box, bag, backpack, tissue box, towel, soap, bucket, trash
can, vacuum cleaner, fan, heater, radiator, power outlet, light switch, printer, monitor, loudspeaker,
headphones, camera, pen, notebook, toy, doll, ball, guitar, piano, shoe, hat, jacket, helmet, watch,
flower, tree, plant, fence, bicycle, sign, ladder, toolbox, hammer, screwdriver, fire extinguisher,
sculpture""".replace("\n", " ").split(", ")

TAGS = tuple(entry.label for entry in dictionary_of((*COCO_80, *_MORE)).entries)
"""About 150 names, each thing once."""
