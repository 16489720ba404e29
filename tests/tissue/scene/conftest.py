"""Parts from outside the package in its tables, for a test."""

import pytest


@pytest.fixture
def added():
    """Add a part to a table until the test ends."""
    places = []

    def add(table, name, part):
        table.add(name, part)
        places.append((table, name))

    yield add
    for table, name in places:
        table.remove(name)
