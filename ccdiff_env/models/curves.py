"""Curves of a training: files, TensorBoard."""

from __future__ import annotations

import csv
from pathlib import Path

from ccdiff_env.system.files import read_text, write_aside

__all__ = ["Curves"]


class Curves:
    """Loss and validation curves: CSV files, and TensorBoard where it is installed."""

    def __init__(self, out: Path, step: int) -> None:
        self._out = out
        for name in ("loss.csv", "validation.csv"):
            _truncate_after(out / name, step)
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            self._board = None
        else:
            self._board = SummaryWriter(str(out / "tensorboard"), purge_step=step)

    def write(self, name: str, step: int, values: dict[str, float]) -> None:
        """Append a row to ``<name>.csv``."""
        path = self._out / f"{name}.csv"
        fresh = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(["step", *values])
            writer.writerow([step, *(f"{v:.6g}" for v in values.values())])
        if self._board is not None:
            for key, value in values.items():
                self._board.add_scalar(f"{name}/{key}", value, step)

    def close(self) -> None:
        """Flush TensorBoard."""
        if self._board is not None:
            self._board.close()


def _truncate_after(path: Path, step: int) -> None:
    """Drop rows past a step, which a killed run wrote after its last checkpoint."""
    if not path.exists():
        return
    rows = read_text(path).splitlines(keepends=True)
    kept = [r for r in rows if not r.split(",")[0].isdigit() or int(r.split(",")[0]) <= step]
    write_aside(path, "".join(kept))
