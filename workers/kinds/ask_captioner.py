"""Stages of a job that asks the server's captioner about a new scene.

It is asked about the version at the job's start; its suggestions go into the current one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.jobs.nameless_objects import said_by, sheets_of
from fastsplat.service.query.edits.suggested_names import MAX_SUGGESTED, suggest_names
from fastsplat.workers.job.protocol import Job, Stage
from fastsplat.workers.job.results import intact
from fastsplat.workers.kinds.look_again import open_current, write_renamed
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.jobs.name_suggestions import CaptionerResult, SuggestIn
from fastsplat_contract.messages.contact_sheets import ContactSheet
from fastsplat_contract.messages.scenes import Edit

_SAID = "said.json"


def _ask(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "asking": queries the captioner, bounded in time and requests."""

    def sheets() -> Iterator[ContactSheet]:
        for number, sheet in enumerate(sheets_of(open_current(job), job.upload, job.version), start=1):
            yield sheet
            progress(ProgressEvent("asking", 0.5, f"asked about {number} contact sheets of objects"))

    said = said_by(job.settings.captioner, sheets())
    result = CaptionerResult(len(said.names), said.objects, said.refused, said.problem, "")
    answer = {"names": to_plain(SuggestIn(said.names)), "result": to_plain(result)}
    (folder / _SAID).write_text(json.dumps(answer))


def _suggest(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "suggesting": adds suggestions to existing objects; without any publishes nothing."""
    path = job.result("asking") / _SAID
    with intact(path):
        answer = json.loads(path.read_text())
        names = from_plain(SuggestIn, answer["names"]).suggestions[:MAX_SUGGESTED]
    index = open_current(job)
    there = {obj.id for obj in index.objects.listed_with_parts}
    names = tuple(suggestion for suggestion in names if suggestion.object_id in there)
    progress(ProgressEvent("suggesting", 0.5, f"{len(names)} names suggested"))
    result = {**answer["result"], "suggested": len(names)}
    if not names:
        summary = {"parent": job.version, "edits": [], "result": result}
        (folder / "summary.json").write_text(json.dumps(summary))
        return
    edits = [to_plain(Edit("suggest", suggestions=names))]
    write_renamed(job, suggest_names(index.objects, names), folder, {"edits": edits, "result": result})


ASK_CAPTIONER: Mapping[str, Stage] = {"asking": _ask, "suggesting": _suggest}
