"""Print the lowest versions that pyproject.toml allows, of what slipfree runs with, as constraints.

``python .ci/lowest.py > lowest.txt && pip install -c lowest.txt '.[xarray,view,cluster,ros]'``
"""

import re
import tomllib
from pathlib import Path

EXTRAS = ("xarray", "view", "cluster")  # those of users

project = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text())["project"]
extras = project["optional-dependencies"]
for requirement in sum((extras[name] for name in EXTRAS), project["dependencies"]):
    print(re.sub(r"^([\w.-]+)>=([\d.]+).*", r"\1==\2", requirement))
