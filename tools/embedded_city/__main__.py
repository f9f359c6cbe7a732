"""``python -m tools.embedded_city`` generates the shipped data set anew."""

from __future__ import annotations

from pathlib import Path

from ccdiff_env.embedded import SHIPPED
from tools.embedded_city.dataset import generate, pack

path = Path(__file__).parents[2] / "ccdiff_env" / SHIPPED
pack(generate(), path)
print(f"wrote {path}, {path.stat().st_size // 1000} kB")
