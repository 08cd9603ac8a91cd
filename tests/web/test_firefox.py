"""The page in another browser than the one that all other tests drive."""

from __future__ import annotations

from pathlib import Path

from fastsplat_contract.messages.queries import QueryRequest
from tests.web.firefox import firefox
from tests.web.places import Place

_CANVAS = "document.querySelector('canvas[role=application]')"


def test_a_first_visit_leads_to_a_scene_and_an_answer(place: Place, tmp_path: Path) -> None:
    (answer,) = place.service.answers.query(QueryRequest(place.scene_id, ("mug",))).answers
    with firefox(tmp_path) as visit:
        visit.go(f"{place.url}/")
        visit.until("document.querySelector('.card img')?.naturalWidth")
        visit.click(".card img")
        visit.until(f"{_CANVAS}?.dataset.shown?.endsWith(' plain')")
        visit.click("input[type=search]")
        visit.type("mug")
        visit.until("document.querySelector('.verdict.here')")
        assert visit.evaluate("document.querySelector('.verdict').textContent") == answer.sentence
        visit.until(f"{_CANVAS}.dataset.drawn === 'webgl' && {_CANVAS}.dataset.shown.endsWith(' answer')")
        assert not visit.troubles
        assert visit.evaluate("window.cspReports.length") == 0
        assert len(visit.addresses) > 8
        assert all(address.startswith((f"{place.url}/", "blob:", "data:")) for address in visit.addresses)
