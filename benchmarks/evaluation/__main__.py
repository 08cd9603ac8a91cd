"""A data set of one's own: train on its training views as a job would, measure its test views.

    python -m benchmarks evaluate FOLDER [--labels given] [--preset balanced] [--split test] [--test-every 8]
                                  [--mask-label NAME]

FOLDER is a transforms.json with label maps, a COLMAP model, or a folder of LERF-OVS or 3D-OVS, with its images. Prints
a row as `benchmarks.default_path` has it: every metric, or why it was not measured. --labels says where labels come
from (`benchmarks.evaluation.train_eval.TrainingLabels`), --split validation measures some of the training views, to
choose settings by.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

from benchmarks.default_path.__main__ import measure
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.train_eval import TrainingLabels
from benchmarks.evaluation.validation_split import Split
from benchmarks.provenance import parser_of
from fastsplat.service.planning.presets import apply_preset
from fastsplat.service.settings import load_settings
from fastsplat_contract.jobs.operations import PresetName


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--labels", choices=get_args(TrainingLabels), default="given")
    parser.add_argument("--preset", choices=get_args(PresetName), default="balanced")
    parser.add_argument("--split", choices=get_args(Split), default="test")
    parser.add_argument("--test-every", type=int, default=8, help="one view in so many tests, without a split")
    parser.add_argument("--mask-label", default="", help="what binary masks show, for data sets that do not say")
    options = parser.parse_args()
    settings = apply_preset(load_settings(), options.preset)
    dataset = read_dataset(
        options.folder,
        settings.capture,
        test_every=options.test_every,
        mask_label=options.mask_label,
        split=options.split,
    )
    row = measure(dataset, settings, options.folder.name, labels=options.labels, preset=options.preset)
    print(json.dumps(row, indent=1, ensure_ascii=False))


if __name__ == "__main__":
    main()
