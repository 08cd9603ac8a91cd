"""The results of a demonstration: pictures, PLY files, and a report on the terminal."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from pathlib import Path

import typer
from PIL import Image, ImageDraw, ImageFont

from fastsplat.cli.scenes.ask_command import answer_lines
from fastsplat.cli.scenes.object_commands import objects_table
from fastsplat.cli.scenes.scene_commands import scene_facts
from fastsplat_client import Client
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.queries import Answer
from fastsplat_contract.messages.scenes import Scene
from fastsplat_contract.photos.pictures import PictureKind

_COLUMNS = 3
_WIDTH = 480
_CAPTION = 44
_GAP = 6


def write_sheet(panels: Sequence[tuple[str, Path]], target: Path) -> None:
    """Writes pictures of one aspect, with captions, in rows of three as a JPEG."""
    pictures = [(caption, Image.open(path).convert("RGB")) for caption, path in panels]
    first = pictures[0][1]
    height = round(_WIDTH * first.height / first.width)
    rows = -(-len(pictures) // _COLUMNS)
    columns = min(_COLUMNS, len(pictures))
    size = (columns * (_WIDTH + _GAP) - _GAP, rows * (height + _CAPTION + _GAP) - _GAP)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(15)
    for index, (caption, picture) in enumerate(pictures):
        left = index % _COLUMNS * (_WIDTH + _GAP)
        top = index // _COLUMNS * (height + _CAPTION + _GAP)
        lines = "\n".join(textwrap.wrap(caption, 66, max_lines=2, placeholder=" …"))
        draw.text((left + 2, top + _CAPTION / 2), lines, font=font, fill="black", anchor="lm")
        sheet.paste(picture.resize((_WIDTH, height), Image.Resampling.LANCZOS), (left, top + _CAPTION))
    sheet.save(target, quality=88)


_DRAWN_KINDS: tuple[PictureKind, ...] = ("overlay", "relevancy")


def save_pictures(client: Client, scene: Scene, answers: Sequence[Answer], view: str, folder: Path) -> None:
    """Saves view, overlay, relevancy picture and PLY per question, their sheet, and the scene's PLY."""
    (folder / "view.png").write_bytes(client.picture(scene.id, "rgb", view))
    panels = [("rendered", folder / "view.png"), ("everything that is there", folder / "objects.png")]
    for answer in answers:
        text = answer.text
        stem = re.sub(r"\W+", "-", text).strip("-") or "query"
        for kind in _DRAWN_KINDS:
            (folder / f"{stem}-{kind}.png").write_bytes(
                client.picture(scene.id, kind, view, text=text, version=answer.version)
            )
        panels.append((f"“{text}” {answer.sentence}", folder / f"{stem}-overlay.png"))
        (masked,) = client.query(scene.id, text, outputs=["mask3d"], mask3d_encoding="ply", version=answer.version)
        (folder / f"{stem}-mask.ply").write_bytes(masked.mask3d or b"")
    write_sheet(panels, folder / "summary.jpg")
    client.download_scene(scene.id, folder / "scene.ply")


def print_report(scene: Scene, objects: Sequence[SceneObject], answers: Sequence[Answer]) -> None:
    """The scene, what is there before anybody named anything, and the answers, for people."""
    lines = (line for answer in answers for line in (f'"{answer.text}"', *answer_lines(answer)))
    typer.echo("\n".join(("", scene_facts(scene), "", objects_table(objects), "", *lines)))
