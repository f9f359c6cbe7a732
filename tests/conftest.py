"""Fixtures that several test files share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory):
    """Built scenes of tests go to a folder of their own, not to the user's."""
    before = os.environ.get("CCDIFF_CACHE")
    os.environ["CCDIFF_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["CCDIFF_CACHE"]
    else:
        os.environ["CCDIFF_CACHE"] = before


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder with the real data; skips the test where there is none."""
    here = Path(__file__).resolve().parents[1]
    candidates = [os.environ.get("CCDIFF_DATA"), here.parent / "shared" / "data"]
    for candidate in candidates:
        if candidate and (Path(candidate) / "nuscenes").is_dir():
            return Path(candidate)
    pytest.skip("no real data: neither CCDIFF_DATA nor ../shared/data holds a nuscenes folder")
