"""Grafana's dashboard: Prometheus computes each of its expressions over what a server's metrics say."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import LimitSettings
from fastsplat.service.store.rows.records import NewJob
from tests.api.served import on_free_ports, served
from tests.scenes import stand_in_models

_DASHBOARD = Path(__file__).parents[2] / "docker/grafana.json"
_MINUTES = 120  # of the series: the longest range of an expression is an hour


@pytest.fixture(scope="module")
def promtool() -> str:
    tool = shutil.which("promtool")
    if tool is None:
        pytest.skip("promtool is not here: apt-get install prometheus")
    return tool


@pytest.fixture(scope="module")
def scrape(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Of a server that answered, refused, and has a job that failed and one that waits."""
    folder = tmp_path_factory.mktemp("metrics")
    models = stand_in_models(folder / "models", "minilm_l6_int8")
    settings = on_free_ports(data_dir=folder, models=models, limits=LimitSettings(burst=3, rate_per_s=0.001))
    with open_service(settings) as service, served(service, settings) as faces:
        address = f"http://127.0.0.1:{faces.ports.metrics}/metrics"
        for name in ("a", "b"):
            service._store.scenes.create(NewJob(f"s{name}", f"o{name}", "", "", "", f"u{name}", {}))
        claim = service._store.jobs.claim("oa")
        done = {"stage": "TRAIN", "fraction": 1.0, "message": "", "seconds": 12.5, "metrics": {}}
        service._store.jobs.report(claim, [done])
        error = {"kind": "INTERNAL", "reason": "X", "message": "", "stage": "TRAIN", "details": {}}
        service._store.jobs.fail(claim, error)
        statuses = {faces.rest.get("/v1/scenes").status_code for _ in range(5)}
        assert statuses == {200, 429}
        httpx.get(address, timeout=60)  # finds which jobs have ended; the next scrape has their stages
        return httpx.get(address, timeout=60).text


def _targets() -> Iterator[tuple[str, str]]:
    """Each expression with the label that its legend shows, or "" for none."""
    for panel in json.loads(_DASHBOARD.read_text())["panels"]:
        for target in panel["targets"]:
            labels = re.findall(r"\{\{(\w+)\}\}", target.get("legendFormat", ""))
            yield target["expr"], labels[0] if labels else ""


def _series(scrape: str) -> list[dict[str, str]]:
    """Every sample of a scrape, read once a minute: counters grow by as much each time, the rest stays."""
    series = []
    for family in text_string_to_metric_families(scrape):
        for sample in family.samples:
            labels = ", ".join(f"{name}={json.dumps(value)}" for name, value in sample.labels.items())
            grows = family.type in ("counter", "histogram")
            values = f"0+{sample.value}x{_MINUTES}" if grows else f"{sample.value}x{_MINUTES}"
            series.append({"series": f"{sample.name}{{{labels}}}", "values": values})
    return series


def _complaints(promtool: str, folder: Path, series: list[dict[str, str]], targets: list[tuple[str, str]]) -> str:
    """promtool's complaints unless all give numbers and their label. (`group`: 1 for any result; `>= 0` drops NaN.)"""
    cases = []
    for expression, label in targets:
        query, sample = f"({expression}) >= 0", {"labels": "{}", "value": 1}
        if label:
            query, sample["labels"] = f'label_replace({query}, "told", "yes", "{label}", ".+")', '{told="yes"}'
        cases.append({"expr": f"group by (told) ({query})", "eval_time": f"{_MINUTES}m", "exp_samples": [sample]})
    file = folder / "dashboard.yaml"
    tests = [{"interval": "1m", "input_series": series, "promql_expr_test": cases}]
    file.write_text(yaml.safe_dump({"evaluation_interval": "1m", "tests": tests}, width=1000))
    done = subprocess.run([promtool, "test", "rules", file], capture_output=True, text=True)
    said = done.stdout + done.stderr
    assert (done.returncode == 0) == ("SUCCESS" in said), said
    return "" if done.returncode == 0 else said


def test_every_expression_gives_numbers_with_the_label_of_its_legend(
    promtool: str, scrape: str, tmp_path: Path
) -> None:
    targets = list(_targets())
    assert len(targets) > 8 and all("fastsplat_" in expression for expression, _ in targets)
    assert _complaints(promtool, tmp_path, _series(scrape), targets) == ""


@pytest.mark.parametrize(
    "target",
    [
        ("sum(fastsplat_queued_calls", ""),
        ("sum(fastsplat_job)", ""),
        ("sum by (state) (fastsplat_jobs)", "status"),
        ("histogram_quantile(0.5, sum by (stage) (rate(fastsplat_job_stage_seconds_bucket[1h])))", "stage"),
    ],
    ids=["no expression", "no such metric", "no such label", "a quantile without buckets"],
)
def test_what_would_stay_empty_is_found(promtool: str, scrape: str, tmp_path: Path, target: tuple[str, str]) -> None:
    assert _complaints(promtool, tmp_path, _series(scrape), [target])


def test_prometheus_has_no_complaint_about_the_metrics(promtool: str, scrape: str) -> None:
    done = subprocess.run([promtool, "check", "metrics"], input=scrape, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
