"""Photos placed, points, errors and seconds by COLMAP's defaults and by the service.

`python -m benchmarks.poses --data DIR [--sets kitchen/1,plush/2] [--methods colmap,fastsplat] [--label NAME]` writes
`benchmarks/results/poses.json`, a row a case and method; rows measured again are replaced. `--label` is written beside
"fastsplat", so that releases can be compared. CPU seconds count where the machine is busy; wall seconds do not.
"""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.poses.cases import METHODS, Case, measure
from benchmarks.provenance import RESULTS, begin, parser_of, write_results

_SETS = "kitchen/1,kitchen/2,kitchen/3,plush/1,plush/2,plush/3,tabletop/1,tabletop/2,tabletop/3,skull/1,skull/2,skull/3"
_RESULT = RESULTS / "poses.json"
_CHOSEN_ON = "rules of pairs and models: on some of these sets, see docs/photos.md"


def main() -> None:
    """Measure, print and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the sets, each with images/")
    parser.add_argument("--sets", default=_SETS, help="NAME/STEP, ...")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--label", default="", help="what the service's rows are called besides")
    options = parser.parse_args()
    start = begin()
    rows: list[dict[str, Any]] = json.loads(_RESULT.read_text())["rows"] if _RESULT.exists() else []
    for entry in options.sets.split(","):
        name, _, step = entry.partition("/")
        for method in options.methods.split(","):
            # A process each, so that seconds and memory are this case's alone.
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                row = pool.submit(measure, Case(name, int(step or 1)), method, options.data).result()
            row["label"] = options.label if method == "fastsplat" else ""
            print(json.dumps({key: value for key, value in row.items() if key != "warnings"}), flush=True)
            rows = [other for other in rows if _key(other) != _key(row)] + [row]
            rows.sort(key=_key)
            write_results("poses", start, options, _CHOSEN_ON, {"rows": rows})


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return row["name"], row["step"], row["method"], row["label"]


if __name__ == "__main__":
    main()
