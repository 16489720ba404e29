"""Whether this is a notebook, and what it can do."""

import sys
import warnings
from importlib import import_module
from typing import Any

__all__ = ["in_notebook", "is_interactive"]

BACKENDS = ("trame_pyvista", "pyvista.trame.jupyter")
"""Modules by which pyvista 0.49 and older ones let a notebook turn a picture by the mouse: the extra ``notebook``."""


def in_notebook() -> bool:
    """Whether a Jupyter kernel runs this."""
    module = sys.modules.get("IPython")
    shell: Any = module.get_ipython() if module is not None else None
    return shell is not None and hasattr(shell, "kernel")


def is_interactive() -> bool:
    """Whether what a notebook needs to turn a picture by the mouse is installed."""
    for name in BACKENDS:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the second name is an old one
                import_module(name)
        except ImportError:
            continue
        return True
    return False
