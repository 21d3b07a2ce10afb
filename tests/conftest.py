"""What all tests share."""

import pytest


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    """Without a graphics card a picture in space takes as long as it has pixels."""
    monkeypatch.setattr("rve.common.drawing.space.PANEL", (350, 310))
