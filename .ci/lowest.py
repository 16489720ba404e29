"""Print a constraint for every requirement of pyproject.toml that has a lower bound: exactly
that version.
"""

import tomllib
from pathlib import Path

project = tomllib.loads(
    (Path(__file__).resolve().parents[1] / "pyproject.toml").read_text("utf-8")
)["project"]
extras = project["optional-dependencies"].values()
wanted = {*project["dependencies"], *(requirement for extra in extras for requirement in extra)}
print(
    "\n".join(
        sorted(requirement.replace(">=", "==") for requirement in wanted if ">=" in requirement)
    )
)
