"""Print the product's dependencies, or those of some extras, as requirements: `python requirements.py [EXTRA ...]`."""

import sys
import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
extras = [requirement for extra in sys.argv[1:] for requirement in project["optional-dependencies"][extra]]
# The client is built from this repository, like the product itself.
print("\n".join(line for line in extras or project["dependencies"] if not line.startswith("fastsplat")))
