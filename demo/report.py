"""What the demonstration leaves behind: report.json, pictures, PLY files and two tables on the terminal."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from demo.rest import Rest
from demo.sheet import caption_of, write_sheet

_SHOWN = 4


def report_of(
    scene: Mapping[str, Any], operation: Mapping[str, Any], answers: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The figures of one run, from what the server said."""
    quality = scene["quality"]
    return {
        "images": quality["images"],
        "registered": quality["registered"],
        "unregistered": quality.get("unregistered", []),
        "warnings": quality.get("warnings", []),
        "dictionary": [{key: row[key] for key in ("label", "pixels", "views")} for row in scene["dictionary"]],
        "gaussians": scene["gaussians"],
        "train_seconds": {stage["stage"]: round(stage["seconds"], 1) for stage in operation["stages"]},
        "psnr": quality.get("psnr"),
        "ssim": quality.get("ssim"),
        "held_out": quality.get("held_out"),
        "queries": [
            {
                "text": answer["text"],
                "verdict": answer["verdict"],
                "explanation": answer.get("explanation", ""),
                "results": [
                    {key: match[key] for key in ("label", "relevancy", "gaussian_count", "relevant")}
                    for match in answer["matches"]
                ],
            }
            for answer in answers
        ],
    }


def save_evidence(rest: Rest, scene: Mapping[str, Any], answers: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """A rendered view, overlay, relevancy picture and PLY per question, a sheet of them all, and the scene's PLY."""
    scene_id, views = scene["id"], [camera["name"] for camera in scene["cameras"]]
    middle = views[len(views) // 2]
    (folder / "view.png").write_bytes(rest.picture(scene_id, "rgb", view=middle))
    panels = [("rendered", folder / "view.png")]
    for answer in answers:
        stem = re.sub(r"\W+", "-", answer["text"]).strip("-") or "query"
        for kind in ("overlay", "relevancy"):
            picture = rest.picture(scene_id, kind, view=middle, text=answer["text"])
            (folder / f"{stem}-{kind}.png").write_bytes(picture)
        panels.append((caption_of(answer), folder / f"{stem}-overlay.png"))
        rest.download(f"/v1/scenes/{scene_id}/mask.ply", {"text": answer["text"]}, folder / f"{stem}-mask.ply")
    write_sheet(panels, folder / "summary.jpg")
    rest.download(f"/v1/scenes/{scene_id}/scene.ply", {}, folder / "scene.ply")


def write_report(report: Mapping[str, Any], folder: Path) -> None:
    (folder / "report.json").write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n")


def print_report(report: Mapping[str, Any], console: Console) -> None:
    """The dictionary and the ranked answers, for people."""
    facts = f"{report['registered']} of {report['images']} images registered, {report['gaussians']} Gaussians"
    if report["psnr"] is not None:
        facts += f", {report['psnr']:.2f} dB on {report['held_out']:g} held-out views"
    console.print(f"\n[bold]{facts}[/bold]")
    table = Table("label", "views", "pixels", title="The scene's dictionary")
    for row in report["dictionary"]:
        table.add_row(row["label"], str(row["views"]), f"{row['pixels']:,}")
    console.print(table)
    table = Table(
        "query",
        "verdict",
        "answer",
        "relevancy",
        "Gaussians",
        title="Asked and answered, REST = gRPC; dim: not relevant",
    )
    for query in report["queries"]:
        for rank, match in enumerate(query["results"][:_SHOWN]):
            first = (query["text"], query["verdict"]) if rank == 0 else ("", "")
            figures = (match["label"], f"{match['relevancy']:.3f}", str(match["gaussian_count"]))
            table.add_row(*first, *figures, style="" if match["relevant"] else "dim")
        table.add_section()
    console.print(table)
