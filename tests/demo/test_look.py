"""The demonstration says how its result is looked at, and that command is there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from demo.__main__ import how_to_look

_MAKEFILE = (Path(__file__).parents[2] / "Makefile").read_text()


def test_make_look_serves_what_make_demo_trains() -> None:
    assert how_to_look(Path("demo-output")) == "make look"
    (recipe,) = re.findall(r"^look:.*\n((?:\t.*\n)+)", _MAKEFILE, re.MULTILINE)
    assert "FASTSPLAT_DATA_DIR=demo-output/service" in recipe and "serve --no-auth" in recipe


def test_another_output_is_served_by_name() -> None:
    folder, program, *rest = shlex.split(how_to_look(Path("else where")))
    assert folder == "FASTSPLAT_DATA_DIR=else where/service" and rest == ["serve", "--no-auth"]
    assert Path(program).is_file()
