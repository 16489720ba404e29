"""Fixtures of the tests of geometry."""

import pytest


@pytest.fixture
def parsed_here(monkeypatch):
    """Parse files within this process, because each child process takes 0.3 s to import VTK.

    The child process itself is tested by `test_isolated_parser` and by the tests of faults.
    """
    from vtkmodules.vtkCommonCore import vtkOutputWindow

    from meshes.base import isolated_parser

    window = vtkOutputWindow.GetInstance()
    monkeypatch.setattr(
        isolated_parser, "_asked", lambda request, *_: isolated_parser._answer(request)
    )
    yield
    vtkOutputWindow.SetInstance(window)
