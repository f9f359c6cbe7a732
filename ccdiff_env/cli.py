"""The command line as a module of the package: ``python -m ccdiff_env.cli <verb>``."""

from __future__ import annotations

from ccdiff_env_cli import main

__all__ = ["main"]

if __name__ == "__main__":
    raise SystemExit(main())
