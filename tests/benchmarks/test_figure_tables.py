"""Tables of figures in the pages are those of the result files, and say where they come from."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from benchmarks.figure_tables import PAGES, RESULTS, TABLES, render, write_tables
from benchmarks.rooms.__main__ import mean_of
from benchmarks.sources import module_of, sources_of


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_of_a_page_are_those_of_the_result_files(page: Path) -> None:
    assert write_tables(page.read_text()) == page.read_text(), f"{page.name} is out of date: run make figures"


def test_every_table_stands_in_a_page_and_every_region_is_closed() -> None:
    text = "".join(page.read_text() for page in PAGES)
    named = re.findall(r"<!-- (figures|source): (\S+) -->", text)
    assert {name for kind, name in named if kind == "figures"} == set(TABLES)
    assert len(named) == text.count("<!-- end -->")
    outside = re.sub(r"<!-- (figures|source): .*?<!-- end -->", "", text, flags=re.DOTALL)
    assert not re.findall(r"benchmarks/results/\w+\.json", outside), "without what changed since: <!-- source: NAME -->"


def test_every_row_of_a_quoted_file_has_a_commit_and_a_date_and_its_benchmark_is_here() -> None:
    quoted = set(re.findall(r"benchmarks/results/(\w+)\.json", "".join(page.read_text() for page in PAGES)))
    for name in sorted(quoted):
        document = json.loads(text := (RESULTS / f"{name}.json").read_text())
        rows = document.get("rows", document)
        for row in [document] if "date" in document else rows.values() if isinstance(rows, dict) else rows:
            about = row.get("provenance", row)
            assert re.fullmatch(r"[0-9a-f]{12} \d{4}-\d\d-\d\d", f"{about['commit']} {about['date'][:10]}"), name
        assert sources_of(module_of(name, text)), name


def test_a_page_follows_its_result_file(tmp_path: Path) -> None:
    shutil.copytree(RESULTS, tmp_path, dirs_exist_ok=True)
    page = "text\n<!-- figures: subscriptions -->\nold\n<!-- end -->\nmore\n"
    before = write_tables(page, tmp_path)
    document = json.loads((tmp_path / "subscriptions.json").read_text())
    (tmp_path / "subscriptions.json").write_text(json.dumps({**document, "dropped": 4711, "commit": "0123abc"}))
    after = write_tables(before, tmp_path)
    assert "4711" not in before and "| 4711 |" in after and "0123abc (" in after
    assert after.startswith("text\n") and after.endswith("<!-- end -->\nmore\n") and "old" not in after


def test_means_of_rooms_are_of_those_that_have_a_figure(tmp_path: Path) -> None:
    shares = ("recall_50", "recall_75", "precision", "mean_iou", "clicks_miou", "outside_box")
    counts = {"names_given_right": 3, "names_given": 4, "names_known": 3, "names_knowable": 6}
    rows = {name: {**dict.fromkeys(shares, share), **counts} for name, share in (("desk-2", 0.5), ("shop-1", 1.0))}
    rows["shop-1"] |= {"names_stated_right": 1, "names_stated": 1, "floor_iou": 0.5}
    rows["desk-2"] |= {"floor_iou": float("nan")}
    assert mean_of(list(rows.values()))["floor_iou"] == 0.5
    about = {"date": "2026-11-24", "commit": "0123abc", "kept": [{"date": "2026-11-23", "commit": "0456def"}]}
    (tmp_path / "rooms.json").write_text(json.dumps({"rows": rows, "mean": mean_of(list(rows.values())), **about}))
    *_, desk, shop, mean, _, said = render(TABLES["rooms"], tmp_path).splitlines()
    assert desk.startswith("| desk-2 | 0.50 |") and "| 3 of 4 | – | 3 of 6 |" in desk
    assert "| 3 of 4 | 1 of 1 | 3 of 6 |" in shop and "0123abc (" in said and "0456def (" in said
    assert mean.startswith("| mean | 0.75 |") and "| 75% | 100% | 50% |" in mean
