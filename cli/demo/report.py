"""The results of a demonstration: report.json, pictures, PLY files and two tables on the terminal."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont
from rich.console import Console
from rich.table import Table

from fastsplat_client import Client
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.jobs.operations import Operation
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


_MAX_MATCHES = 4
_SHOWN_KINDS: tuple[PictureKind, ...] = ("overlay", "relevancy")


def report_of(
    scene: Scene, operation: Operation, objects: Sequence[SceneObject], answers: Sequence[Answer]
) -> dict[str, Any]:
    """The figures of one run, from the server's answers."""
    quality = scene.quality
    return {
        "images": quality["images"],
        "registered": quality["registered"],
        "unregistered": quality.get("unregistered", []),
        "warnings": quality.get("warnings", []),
        "dictionary": [{"label": row.label, "pixels": row.pixels, "views": row.views} for row in scene.dictionary],
        "objects": [_object_of(obj) for obj in objects],
        "gaussians": scene.gaussians,
        "train_seconds": {stage.stage: round(stage.seconds, 1) for stage in operation.stages},
        "psnr": quality.get("psnr"),
        "ssim": quality.get("ssim"),
        "held_out": quality.get("held_out"),
        "assessment": to_plain(scene.assessment),
        "queries": [_query_of(answer) for answer in answers],
    }


def _object_of(obj: SceneObject) -> dict[str, Any]:
    return {
        "id": obj.id,
        "name": obj.name,
        "probability": obj.probability,
        "suggestions": {suggestion.name: suggestion.probability for suggestion in obj.suggestions},
        "kind": obj.surface or obj.kind,
        "gaussians": obj.gaussian_count,
    }


def _query_of(answer: Answer) -> dict[str, Any]:
    return {
        "text": answer.text,
        "outcome": answer.outcome,
        "probability": answer.probability,
        "sentence": answer.sentence,
        "results": [
            {name: getattr(match, name) for name in ("label", "probability", "relevancy", "gaussian_count", "relevant")}
            for match in answer.matches
        ],
        "objects": [
            {"id": obj.id, "name": obj.name, "center": obj.box.center.position, "size": obj.box.size}
            for obj in answer.objects or ()
            if obj.box is not None
        ],
    }


def save_pictures(client: Client, scene: Scene, answers: Sequence[Answer], view: str, folder: Path) -> None:
    """Saves view, overlay, relevancy picture and PLY per question, their sheet, and the scene's PLY."""
    (folder / "view.png").write_bytes(client.picture(scene.id, "rgb", view))
    panels = [("rendered", folder / "view.png"), ("everything that is there", folder / "objects.png")]
    for answer in answers:
        text = answer.text
        stem = re.sub(r"\W+", "-", text).strip("-") or "query"
        for kind in _SHOWN_KINDS:
            (folder / f"{stem}-{kind}.png").write_bytes(
                client.picture(scene.id, kind, view, text=text, version=answer.version)
            )
        panels.append((f"“{text}” {answer.sentence}", folder / f"{stem}-overlay.png"))
        (masked,) = client.query(scene.id, text, outputs=["mask3d"], mask3d_encoding="ply", version=answer.version)
        (folder / f"{stem}-mask.ply").write_bytes(masked.mask3d or b"")
    write_sheet(panels, folder / "summary.jpg")
    client.download_scene(scene.id, folder / "scene.ply")


def write_report(report: Mapping[str, Any], folder: Path) -> None:
    """Write `report.json` into the folder."""
    (folder / "report.json").write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n")


def print_report(report: Mapping[str, Any], console: Console) -> None:
    """The dictionary and the ranked answers, for people."""
    facts = f"{report['registered']} of {report['images']} images registered, {report['gaussians']} Gaussians"
    if report["psnr"] is not None:
        facts += f", {report['psnr']:.2f} dB on {report['held_out']:g} held-out views"
    console.print(f"\n[bold]{facts}[/bold]")
    if assessment := report["assessment"]:
        console.print(f"The scene is {assessment['grade']}.")
        for finding in assessment["findings"]:
            console.print(f"- {finding['message']} {finding['advice']}")
    table = Table(
        "object", "name", "kind", "Gaussians", title="Everything that is there, before anybody named anything"
    )
    for obj in report["objects"]:
        table.add_row(str(obj["id"]), _name_of(obj), obj["kind"], f"{obj['gaussians']:,}")
    console.print(table)
    table = Table(
        "query",
        "outcome",
        "answer",
        "probability",
        "Gaussians",
        title="Questions and answers, the same over REST and gRPC; dim: not relevant",
    )
    for query in report["queries"]:
        for rank, match in enumerate(query["results"][:_MAX_MATCHES]):
            first = (query["text"], query["outcome"]) if rank == 0 else ("", "")
            likely = match["relevancy"] if match["probability"] is None else match["probability"]
            figures = (match["label"], f"{likely:.3f}", str(match["gaussian_count"]))
            table.add_row(*first, *figures, style="" if match["relevant"] else "dim")
        table.add_section()
    console.print(table)


def _name_of(obj: Mapping[str, Any]) -> str:
    if obj["name"]:
        return f"{obj['name']} {obj['probability']:.2f}"
    return " or ".join(f"{name}? {probability:.2f}" for name, probability in obj["suggestions"].items())
