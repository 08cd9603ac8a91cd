"""The scenes of papers' tables, trained and measured here, and printed beside their figures.

    python -m benchmarks.published FOLDER [--address URL --sha256 DIGEST] [--scenes bed teatime ...] [--preset best]
                                   [--labels detected] [--iterations 4000]

FOLDER holds scenes of one of these sets as its authors publish them, at any depth: 3D-OVS (`bed`, `covered_desk`),
LERF-OVS (`ramen`, `teatime`, `waldo_kitchen`, with `label/`), LERF-Mask (`figurines`, `ramen`, `teatime`, with
`test_mask/`) or Mip-NeRF 360 (`bicycle`, `garden` and so on). Cameras are read of a COLMAP model, a transforms.json or
LLFF's `poses_bounds.npy`. With --address, a ZIP archive is fetched, compared with its SHA-256 digest and unpacked into
it first: where the sets are published is said by their authors, and no copy of them is kept here. Figures are counted
as the tables of these sets count them, minutes are those of all stages. Labels are what the models of the settings find
of the set's texts, which needs an open-set detector (FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR); Mip-NeRF 360 has no
texts. Every row goes to benchmarks/results/published.json.
"""

from __future__ import annotations

import hashlib
import tempfile
import urllib.request
import zipfile
from pathlib import Path
from typing import get_args

from benchmarks.default_path.__main__ import measure
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.train_eval import TrainingLabels
from benchmarks.provenance import RESULTS, parser_of, put_row
from benchmarks.published.llff import with_transforms
from benchmarks.published.paper import PAPER, SCENES, set_of, tables
from fastsplat.service.planning.presets import apply_preset, override_training
from fastsplat.service.settings import load_settings
from fastsplat_contract.jobs.operations import PresetName

_PIECE = 1 << 20


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--address", default="")
    parser.add_argument("--sha256", default="")
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=SCENES)
    parser.add_argument("--preset", choices=get_args(PresetName), default="best")
    parser.add_argument("--labels", choices=("detected", "discovered", "default"), default="detected")
    parser.add_argument("--iterations", type=int, help="in place of the preset's seconds")
    options = parser.parse_args()
    if options.address:
        fetch(options.address, options.sha256, options.folder)
    settings = apply_preset(load_settings(), options.preset)
    if options.iterations is not None:
        settings = override_training(settings, iterations=options.iterations)
        training = settings.training.model_copy(update={"time_budget_s": None, "evaluations": 0})
        settings = settings.model_copy(update={"training": training})
    measured = {}
    for name, folder in scenes_in(options.folder).items():
        if name in options.scenes:
            with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
                dataset = read_dataset(with_transforms(folder, Path(work)), settings.capture)
                data_set = set_of(dataset)
                if data_set not in PAPER or name not in PAPER[data_set][0].scenes:
                    raise SystemExit(f"{folder} is read as {data_set}, which has no {name}: are its annotations there?")
                labels: TrainingLabels = options.labels if dataset.dictionary.entries else "default"
                row = measure(dataset, settings, name, labels=labels, preset=options.preset)
            put_row(RESULTS / "published.json", f"{data_set} {name}", row)
            measured[data_set, name] = row
    if not measured:
        raise SystemExit(f"{options.folder} has none of the scenes {', '.join(options.scenes)}")
    print(tables(measured))


def fetch(address: str, sha256: str, folder: Path) -> None:
    """Fetch a ZIP archive and unpack it into `folder`; nothing is unpacked of another one than was meant.

    Raises:
        SystemExit: no digest is given, or the archive has another one.
        OSError: it cannot be fetched or written.
    """
    if not sha256:
        raise SystemExit("--address needs --sha256, the digest of the archive")
    digest = hashlib.sha256()
    with tempfile.TemporaryFile() as archive:
        with urllib.request.urlopen(address) as answer:
            while piece := answer.read(_PIECE):
                digest.update(piece)
                archive.write(piece)
        if digest.hexdigest() != sha256.lower():
            raise SystemExit(f"{address} has the digest {digest.hexdigest()}, and not {sha256}")
        with zipfile.ZipFile(archive) as opened:
            opened.extractall(folder)


def scenes_in(folder: Path) -> dict[str, Path]:
    """Folders of the papers' scenes below `folder`, by name as in `PAPER`; those of LERF-OVS' labels are none.

    Raises:
        SystemExit: two folders have one name.
    """
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        name = path.name.lower().replace("-", "_")
        if name in SCENES and path.is_dir() and path.parent.name != "label":
            if name in found:
                raise SystemExit(f"{found[name]} and {path} are both called {name}: name a folder with one of them")
            found[name] = path
    return found


if __name__ == "__main__":
    main()
