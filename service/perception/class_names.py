"""Built-in lists of class names."""

from __future__ import annotations

from fastsplat.service.common.dictionary import dictionary_of

COCO_80 = tuple(
    """person, bicycle, car, motorcycle, airplane, bus, train, truck, boat, traffic light, fire hydrant, stop sign,
    parking meter, bench, bird, cat, dog, horse, sheep, cow, elephant, bear, zebra, giraffe, backpack, umbrella,
    handbag, tie, suitcase, frisbee, skis, snowboard, sports ball, kite, baseball bat, baseball glove, skateboard,
    surfboard, tennis racket, bottle, wine glass, cup, fork, knife, spoon, bowl, banana, apple, sandwich, orange,
    broccoli, carrot, hot dog, pizza, donut, cake, chair, couch, potted plant, bed, dining table, toilet, tv, laptop,
    mouse, remote, keyboard, cell phone, microwave, oven, toaster, sink, refrigerator, book, clock, vase, scissors,
    teddy bear, hair drier, toothbrush""".replace("\n   ", "").split(", ")
)
"""The 80 classes of the COCO detection challenge, in the order of detector outputs."""

_MORE = """table, desk, shelf, cabinet, drawer, wardrobe, stool, armchair, sofa cushion, pillow, blanket, carpet,
curtain, window, door, mirror, picture frame, lamp, ceiling lamp, candle, plate, pan, pot, kettle, coffee
machine, jar, can, mug, glass, tray, basket, box, bag, backpack, tissue box, towel, soap, bucket, trash
can, vacuum cleaner, fan, heater, radiator, power outlet, light switch, printer, monitor, loudspeaker,
headphones, camera, pen, notebook, toy, doll, ball, guitar, piano, shoe, hat, jacket, helmet, watch,
flower, tree, plant, fence, bicycle, sign, ladder, toolbox, hammer, screwdriver, fire extinguisher,
sculpture""".replace("\n", " ").split(", ")

TAGS = tuple(entry.label for entry in dictionary_of((*COCO_80, *_MORE)).entries)
"""Default prompts of an open-set detector: about 150 objects of homes, offices, streets."""
