"""Example parts for tissue, one part in each file; `pyproject.toml` names them as entry points."""

from pathlib import Path

__all__ = ["CUSHION", "DRILLING", "MATERIALS"]

HERE = Path(__file__).parent
MATERIALS = HERE / "materials.toml"
DRILLING = HERE / "toy_drilling.toml"
CUSHION = HERE / "toy_cushion.toml"
