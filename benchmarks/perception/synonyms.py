"""Does the cosine of two names tell synonyms from neighbours? Usage: synonyms.py MODEL_DIRECTORY [ENCODER].

Prints the cosines of pairs that are one thing under two names, and of pairs that are two things a detector confuses,
which is where the rule "closer than a threshold and in the same place" would be put to use. The threshold is good if
it keeps the second list out; what it then still catches of the first list is its worth.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fastsplat.service.perception.text.open_text_encoder import open_text_encoder

SAME = """couch/sofa, cup/mug, tv/television, cell phone/mobile phone, teddy bear/stuffed toy, teddy bear/plush doll,
bicycle/bike, potted plant/houseplant, refrigerator/fridge, hair drier/hairdryer, trash can/garbage bin,
frying pan/skillet, headset/headphones, monitor/computer screen, backpack/rucksack, soda can/beverage can,
dining table/table, mouse/computer mouse, remote/remote control, jacket/coat, carpet/rug, faucet/tap, oven/stove,
airplane/aeroplane, motorcycle/motorbike, donut/doughnut, handbag/purse, cabinet/cupboard, curtain/drape,
picture frame/photo frame""".replace("\n", " ").split(", ")

DIFFERENT = """fork/spoon, knife/fork, apple/orange, knife/scissors, bed/couch, keyboard/laptop, bowl/cup, cake/bread,
wine glass/cup, bottle/vase, chair/couch, chair/stool, dining table/desk, tv/laptop, cell phone/remote, dog/cat,
sheep/goat, handbag/backpack, car/truck, bus/train, microwave/oven, book/notebook, toilet/sink, orange/lemon,
baseball bat/baseball glove, skis/snowboard, teddy bear/bear, hot dog/dog, pillow/blanket,
toothbrush/hairbrush""".replace("\n", " ").split(", ")


def _main(models: Path, name: str = "minilm_l6_int8") -> None:
    encoder = open_text_encoder(name, models)
    cosines = {}
    for title, pairs in (("one thing", SAME), ("two things", DIFFERENT)):
        rows = []
        for pair in pairs:
            first, second = encoder.encode(pair.split("/"))
            rows.append((float(first @ second), pair))
        cosines[title] = rows
        print(title, *(f"  {cosine:.3f} {pair}" for cosine, pair in sorted(rows, reverse=True)), sep="\n")
    for threshold in (0.5, 0.6, 0.7, 0.75, 0.8, 0.85, 0.9):
        caught, wrong = (
            sum(cosine > threshold for cosine, _ in cosines[title]) for title in ("one thing", "two things")
        )
        print(
            f"threshold {threshold:.2f}: catches {caught}/{len(SAME)} synonyms, merges {wrong}/{len(DIFFERENT)} others"
        )


if __name__ == "__main__":
    _main(Path(sys.argv[1]), *sys.argv[2:])
