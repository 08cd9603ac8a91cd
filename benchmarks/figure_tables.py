"""The tables of figures in README and docs, written from `benchmarks/results/*.json`: `make figures`.

A page has a region `<!-- figures: NAME -->` ... `<!-- end -->` for each table; what is between is replaced. Below a
table stand the result files that it was made of, with their commits and dates and how many sources have changed since.
The same of one result file is written into a paragraph, between `<!-- source: NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.sources import changes_since, module_of

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

_TABLE = re.compile(r"(<!-- figures: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
_SOURCE = re.compile(r"(<!-- source: (\S+) -->).*?(<!-- end -->)")

Row = Sequence[str]
Document = Mapping[str, Any]


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Attributes:
        files: the result files that it is made of, by their names without the ending.
        head: titles of its columns.
        rows: makes the rows from the files' contents, in the order of `files`.
    """

    files: tuple[str, ...]
    head: tuple[str, ...]
    rows: Callable[..., Iterator[Row]]


def write_tables(text: str, results: Path = RESULTS) -> str:
    """A page with all its tables written anew.

    Raises:
        KeyError: a region names no table, or a result file lacks a figure.
        OSError: a result file is missing.
    """
    text = _TABLE.sub(lambda found: f"{found[1]}\n{render(TABLES[found[2]], results)}\n{found[3]}", text)
    return _SOURCE.sub(lambda found: f"{found[1]}{_source(found[2], results)}{found[3]}", text)


def render(table: Table, results: Path = RESULTS) -> str:
    """The Markdown of one table and the line about its sources.

    Raises:
        KeyError, OSError: as `write_tables`.
    """
    documents = [json.loads((results / f"{name}.json").read_text()) for name in table.files]
    lines = [table.head, ["---"] * len(table.head), *table.rows(*documents)]
    said = "; ".join(_source(name, results) for name in table.files)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines) + f"\n<sub>{said}</sub>\n"


def _source(name: str, results: Path) -> str:
    """Where the figures of one result file come from: its commits, dates, and what changed since."""
    text = (results / f"{name}.json").read_text()
    module = module_of(name, text)
    runs = {(run["date"][:10], run["commit"], changes_since(run, module)) for run in _runs(json.loads(text))}
    said = ", ".join(f"{commit} ({day}; {changes})" for day, commit, changes in sorted(runs))
    return f"`benchmarks/results/{name}.json`: {said}"


def _runs(value: object) -> Iterator[Document]:
    """The records in a result file that say when and of which commit they were taken."""
    if isinstance(value, Mapping) and {"date", "commit"} <= value.keys():
        yield value
    for child in value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ():
        yield from _runs(child)


def _count(share: float, of: int) -> str:
    """A share of a small sample as a count."""
    return f"{round(share * of)} of {of}"


def _right(tally: Document) -> str:
    return _count(tally["right"], tally["questions"])


def _with_interval(figure: Document) -> str:
    low, high = figure["interval"]
    return f"{figure['value']:.2f} ({low:.2f} to {high:.2f})"


def _megabytes(count: float) -> str:
    return f"{count / 1e6:.1f} MB"


def _summary(default: Document, objects: Document, absence: Document, subscriptions: Document) -> Iterator[Row]:
    """Of README alone: its links begin at the repository's root."""
    sample, found, figures = default["sample"], objects["rows"], absence["figures"]
    alone = "docs/method.md#from-photos-alone"
    seconds = sum(sample["stage_seconds"].values())
    yield f"[sample photos with poses to a scene]({alone}), default models and preset", f"{seconds:.0f} s"
    names = ("sample", "tabletop")
    pictures = " and ".join(f"{default[name]['figures']['psnr']:.1f} dB" for name in names)
    yield f"[PSNR of unseen views]({alone}), two scenes", pictures
    recall = " and ".join(_count(found[name]["objects_recall_50"], found[name]["objects_true"]) for name in names)
    yield f"[objects found]({alone}), ready to be named by a click", recall
    said = " and ".join(f"{figures[key]['value'] * 100:.0f} %" for key in ("found_and_named", "rightly_absent"))
    reliable = "docs/asking.md#how-far-an-answer-can-be-relied-on"
    yield f"[asked in other words: found; absent objects said to be absent]({reliable})", said
    within = f"95 % within {subscriptions['p95_ms']:.0f} ms"
    yield "[answers to 30 camera poses a second](docs/robots.md#4-stream-poses-get-masks), beside a training", within


def _reads(document: Document) -> Iterator[Row]:
    whole = document["lines"]
    cpu = max(row["cpu_seconds"] * 26 / row["photos"] for row in document["rooms"])
    yield "lines said, letter for letter", _count(document["recall"], whole)
    yield "right of all that objects say", f"{document['precision'] * 100:.0f} %"
    yield f"lines said with a probability from {document['threshold']:.2f}", _count(document["recall_at_95"], whole)
    yield "CPU seconds for 26 photos, at most", f"{cpu:.0f}"


def _raster(document: Document) -> Iterator[Row]:
    for row in document["rows"]:
        if row["backend"] == "cpu" and row["threads"] == 2 and row.get("backward_ms") and row["gaussians"] != 20000:
            size = f"{row['width']}×{row['height']}"
            yield row["isa"], f"{row['gaussians']:,}", size, f"{row['forward_ms']:.0f}", f"{row['backward_ms']:.0f}"


def _gpu(*documents: Document) -> Iterator[Row]:
    for document in documents:
        for row in (*document["training"], *document["rendering"]):
            cells = f"{row['width']}×{row['height']}", f"{row['ms']:.1f}", f"{row['peak_mib']:.0f}"
            yield row["what"], f"{row['gaussians']:,}", *cells


def _gpu_joint(document: Document) -> Iterator[Row]:
    for what, name in {"joint": "colors, geometry and codes", "rgb": "colors and geometry alone"}.items():
        runs = [run for run in document["runs"] if run["what"] == what]
        cells = (" ".join(f"{run[key]:.{digits}f}" for run in runs) for key, digits in (("train_s", 1), ("psnr", 1)))
        yield name, *cells, f"{max(run['peak_mib'] for run in runs)}"


def _trade(document: Document) -> Iterator[Row]:
    for data in dict.fromkeys(row["data"] for row in document["rows"]):
        for row in document["rows"]:
            if row["data"] == data and "perception" not in row:
                cells = [f"{row['gaussians']:,}", f"{row['psnr_cc']:.2f}", f"{row['ssim']:.3f}", f"{row['miou']:.3f}"]
                cells += [_megabytes(row["bytes"]), f"{row['cpu_s']:.0f}", f"{row['label_map_ms']:.0f}"]
                yield f"{data}, {row['factor']}, {row['value']}", f"{row['iterations']:,}", *cells


def _perception(document: Document) -> Iterator[Row]:
    for row in document["rows"]:
        if "perception_cpu_s" in row:
            cells = (f"{row['miou']:.2f}", f"{row['perception_cpu_s']:.0f}", f"{row['peak_mb']:.0f}")
            yield f"{row['factor']}: {row['value']}", *cells


def _default_path(document: Document) -> Iterator[Row]:
    for name, run in document.items():
        figures = run["figures"]
        cells = [f"{run['names_right']} of {run['names']}", f"{figures['miou']:.2f}", f"{figures['clicks_miou']:.2f}"]
        stages = run["stage_seconds"]
        cells += [f"{figures['psnr']:.1f} dB", f"{figures['ssim']:.3f}", f"{run['gaussians']:,}"]
        cells += [f"{run['bytes'] / 1e6:.1f} MB", f"{stages['perception']:.0f}", f"{stages['training']:.0f}"]
        yield name, *cells


def _objects(document: Document) -> Iterator[Row]:
    for name, row in document["rows"].items():
        if "objects_true" in row:
            found = [_count(row[f"objects_recall_{share}"], row["objects_true"]) for share in (50, 75)]
            yield name, *found, _count(row["objects_precision"], row["objects_judged"]), f"{row['clicks_miou']:.2f}"


def _rooms(document: Document) -> Iterator[Row]:
    for name, row in (*document["rows"].items(), ("mean", document["mean"])):
        cells = [f"{row[key]:.2f}" for key in ("recall_50", "recall_75", "precision", "mean_iou", "clicks_miou")]
        for part, whole in (("given_right", "given"), ("stated_right", "stated"), ("known", "knowable")):
            counted = f"names_{whole}" in row
            text = f"{row[f'names_{part}']} of {row[f'names_{whole}']}" if counted else "–"
            cells.append(f"{row[f'names_{part}_share']:.0%}" if name == "mean" and text != "–" else text)
        yield name, *cells, f"{row['outside_box']:.1%}"


def _names(document: Document) -> Iterator[Row]:
    for row in document["rows"]:
        between = f"{row['from']:.0%} to {row['to']:.0%}"
        yield between, f"{row['predicted']:.0%}", f"{row['right']} of {row['objects']}"


def _absence(document: Document) -> Iterator[Row]:
    figures, questions = document["figures"], document["questions"]
    for title, name, wanted in (
        ("found and rightly named", "found_and_named", "≥ 0.92"),
        ("rightly said to be absent", "rightly_absent", "≥ 0.88"),
        ("area under the ROC of presence", "auroc", "≥ 0.97"),
        ("calibration error of the leading answer", "leading_ece", "≤ 0.04"),
        ("label sets of 90 % that hold an acceptable label", "label_sets_covered_present", "0.87 to 0.93"),
        ('that say "nothing here" where nothing is', "label_sets_covered_absent", "0.87 to 0.93"),
    ):
        yield title, _with_interval(figures[name]), wanted
    for title, name in (
        ("asked by a synonym", "synonym"),
        ("by a kind", "kind"),
        ("by a use", "use"),
        ("absent: objects of elsewhere", "far"),
        ("absent: objects of a household", "household"),
        ("absent: near misses", "near"),
    ):
        yield title, _count(figures[name]["value"], questions[name]), ""


def _questions(document: Document) -> Iterator[Row]:
    row = document["rows"]["validation"]
    for scene, tally in {**row["by_scene"], "all": {"right": row["right"], "questions": row["questions"]}}.items():
        yield scene, f"{tally['right']} of {tally['questions']}"


def _presence(document: Document) -> Iterator[Row]:
    for name, row in sorted(document["rows"].items()):
        said = ("there", "denied"), ("gone", "not_here"), ("other", "cannot_say")
        denied, refused, left = (f"{row[kind].get(what, 0)} of {sum(row[kind].values())}" for kind, what in said)
        yield name, denied, refused, "{} of {}".format(*row["evasions"]), left


def _relations(document: Document) -> Iterator[Row]:
    yield "decided by how objects stand", _right(document["decided"]), "answered rightly"
    yield "", str(document["wrong"]), "answered wrongly"
    yield "", str(document["wrongly_refused"]), "refused"
    yield "not decided by it", _right(document["rightly_refused"]), "refused"


def _subscriptions(document: Document) -> Iterator[Row]:
    yield "poses answered", f"{document['answered']:,} of {document['sent']:,}"
    yield "poses passed over for a newer one", str(document["dropped"])
    latencies = ", ".join(f"{document[f'{key}_ms']:.0f} ms" for key in ("p50", "p95", "max"))
    yield "latency: median, 95 %, longest", latencies
    yield "longest pause between two answers", f"{document['longest_gap_s']:.2f} s"
    memory = document["server_mib"]
    yield "memory of the server, before and after", f"{memory['start']:.0f} and {memory['end']:.0f} MiB"


def _serve(document: Document) -> Iterator[Row]:
    phases = {row["phase"]: row for row in document["rows"]}
    rest, many = phases["overhead of rest"], phases["50 clients"]
    medians = ", ".join(f"{rest['p50_ms'][key]:.1f} ms" for key in ("in_process", "rest", "grpc"))
    yield "a small question: in process, REST, gRPC (median)", medians
    rate = f"{many['count'] / many['seconds']:.0f} answers a second"
    yield "50 clients at once", f"{rate}, 99 % within {many['p99_ms']:.0f} ms"
    cold = phases["a cold scene of 1M Gaussians"]["seconds"]
    yield "first answer of a scene of a million Gaussians", f"{max(cold):.1f} s"
    growth = phases["mixed requests"]
    yield f"memory after {growth['requests']:,} mixed requests", f"{growth['growth'] * 100:+.1f} %"


def _servers(document: Document) -> Iterator[Row]:
    names = {"ranking": "ranking", "mask": "ranking and a 2D mask"}
    for row in sorted(document["rows"], key=lambda row: list(names).index(row["question"])):
        cpu = row["cpu_ms"]
        cells = [
            f"{row['servers']}",
            f"{row['questions_a_second']:.0f}",
            f"{row['p50_ms']:.0f}",
            f"{row['p99_ms']:.0f}",
        ]
        cells += [f"{cpu['servers']:.1f}", f"{cpu['database']:.2f}", f"{1e3 / cpu['servers']:.0f}"]
        yield names[row["question"]], *cells, f"{cpu['servers'] / cpu['database']:.0f}"


def _workers(document: Document) -> Iterator[Row]:
    for row in document["rows"]:
        workers, jobs, busy = row["workers"], row["jobs_a_day"], row["database"]
        yield f"{workers}", f"{jobs:,.0f}", f"{jobs / workers:.0f}", f"{busy:.1%}", f"{row['longest_turn_s']:.2f} s"


def _day(document: Document) -> Iterator[Row]:
    for row in document["nodes"]:
        shares = (f"{row['shares'][part]:.0%}" for part in ("database", "opening", "store", "listing"))
        yield f"{row['nodes']:,}", f"{row['queue']['jobs_a_day']:,.0f}", *shares


def _page(document: Document) -> Iterator[Row]:
    for row in document["rows"]:
        drawn = "browser, WebGL without a GPU" if row["webgl"] else "server"
        seconds = (f"{row[key]:.1f} s" for key in ("scene_shown_s", "ready_s", "enter_to_glow_s"))
        loaded = _megabytes(sum(row["bytes"].values()))
        yield f"{row['scene']}, {row['gaussians']:,}", drawn, *seconds, f"{row['frames_per_s']:.0f}", loaded


def _lighthouse(document: Document) -> Iterator[Row]:
    for page, row in document["lighthouse"].items():
        moments = f"{row['largest-contentful-paint_s']:.1f} s", f"{row['total-blocking-time_s']:.2f} s"
        yield page, f"{row['performance']}", f"{row['accessibility']}", *moments


def _localization(document: Document) -> Iterator[Row]:
    for name, run in document.items():
        held, foreign = run["held_out"], run["others"]
        errors = f"{held['size_percent_median']:.3f} % of the size, {held['degrees_median']:.3f}°"
        inside = _count(held["inside_95"], held["photos"])
        wrong = f"{foreign['accepted']} of {foreign['photos']}"
        yield name, f"{held['right']} of {held['photos']}", errors, inside, wrong


def _changes(document: Document) -> Iterator[Row]:
    for name, row in document.items():
        error = row["move_error_cm_median"]
        moved = "–" if error is None else f"{error:.1f} cm"
        cells = f"{row['found']} of {row['changes']}", f"{row['wrong']}", f"{row['f1']:.2f}"
        yield name, *cells, f"{row['unchanged_wrong']} in {row['unchanged']}", moved


TABLES: Mapping[str, Table] = {
    "summary": Table(
        ("default_path", "objects", "absence", "subscriptions"), ("on two CPU cores, no GPU", ""), _summary
    ),
    "raster": Table(("raster",), ("instructions", "Gaussians", "picture", "forward, ms", "backward, ms"), _raster),
    "gpu": Table(
        ("gpu", "gpu_million"), ("NVIDIA H200", "Gaussians", "picture", "ms", "peak MiB of the GPU's memory"), _gpu
    ),
    "gpu_joint": Table(
        ("gpu_joint",), ("1,500 steps on an NVIDIA H200", "s, by run", "PSNR, dB, by run", "peak MiB"), _gpu_joint
    ),
    "trade": Table(
        ("trade",), ("", "steps", "Gaussians", "PSNR, dB", "SSIM", "mIoU", "size", "CPU s", "a mask, ms"), _trade
    ),
    "perception": Table(("trade",), ("the sample, detected labels", "mIoU", "CPU s", "peak MB"), _perception),
    "default_path": Table(
        ("default_path",),
        (
            *("", "names right", "mIoU by them", "IoU of a click", "PSNR", "SSIM", "Gaussians", "size"),
            *("perception, s", "training, s"),
        ),
        _default_path,
    ),
    "objects": Table(
        ("objects",),
        ("", "found at IoU 0.5", "at IoU 0.75", "found objects that are right", "IoU of a click"),
        _objects,
    ),
    "rooms": Table(
        ("rooms",),
        (
            *("room", "recall at IoU 0.5", "at 0.75", "precision", "mean IoU", "one click each", "given names right"),
            *("stated names right", "named of what the detector knows", "opacity outside of the box"),
        ),
        _rooms,
    ),
    "absence": Table(("absence",), ("", "measured (95 % interval)", "wanted"), _absence),
    "names": Table(("names",), ("probability", "mean", "right"), _names),
    "questions": Table(("questions",), ("", "right"), _questions),
    "reads": Table(("reads",), ("printed lines, capitals from 20 pixels", ""), _reads),
    "changes": Table(
        ("changes",),
        ("room", "events found", "wrong ones", "F1", "events told of unchanged sets", "error of a move, median"),
        _changes,
    ),
    "presence": Table(("presence",), ("", "denied", "refused", "evaded", "left open"), _presence),
    "relations": Table(("relations",), ("questions", "", ""), _relations),
    "subscriptions": Table(
        ("subscriptions",), ("three questions, ten poses a second each, ten minutes", ""), _subscriptions
    ),
    "serve": Table(("serve",), ("", ""), _serve),
    "servers": Table(
        ("servers",),
        (
            *("question", "servers", "questions a second", "median, ms", "99 % within, ms"),
            *("ms of processors a question, of servers", "of the database", "questions a second by one core"),
            "cores of servers for one of the database",
        ),
        _servers,
    ),
    "workers": Table(
        ("workers",),
        ("workers", "jobs a day", "of each", "the database's cores are busy", "longest turn at it"),
        _workers,
    ),
    "day": Table(
        ("workers",),
        (
            *("nodes", "jobs a day", "the database's two cores", "two servers of two cores, opening scenes"),
            *("the store's bytes", "an hour, listing the store"),
        ),
        _day,
    ),
    "page": Table(
        ("page",),
        (
            *("scene, Gaussians", "moved by", "shown after", "free to move after", "from Enter to glow"),
            *("frames a second", "loaded"),
        ),
        _page,
    ),
    "lighthouse": Table(
        ("page",),
        ("Lighthouse, a phone", "performance", "accessibility", "largest paint", "blocked"),
        _lighthouse,
    ),
    "localization": Table(
        ("localization",),
        ("scene", "photos placed rightly", "median error", "inside the 95 % region", "photos of other places accepted"),
        _localization,
    ),
}
"""By the names that regions of pages use."""


def main() -> None:
    """Write the tables of all pages anew, and print the pages that changed."""
    for page in PAGES:
        before = page.read_text()
        after = write_tables(before)
        if after != before:
            page.write_text(after)
            print(page.relative_to(ROOT), file=sys.stderr)


if __name__ == "__main__":
    main()
