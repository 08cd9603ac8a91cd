"""Print the product's dependencies, or those of one extra, as requirements: `python requirements.py [EXTRA]`."""

import sys
import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
listed = project["optional-dependencies"][sys.argv[1]] if len(sys.argv) > 1 else project["dependencies"]
# The client is built from this repository, like the product itself.
print("\n".join(requirement for requirement in listed if not requirement.startswith("fastsplat")))
