"""Replays to look at: HTML pages, images and videos of rollouts and logs."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ccdiff_env.view.page import address, page_html, write_page
    from ccdiff_env.view.sources import find_rollout, log_rollout, play_scene

__all__ = ["address", "find_rollout", "log_rollout", "page_html", "play_scene", "write_page"]


def __getattr__(name: str) -> Any:
    # imported when first named: most programs show nothing
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    room = "page" if name in ("address", "page_html", "write_page") else "sources"
    return getattr(import_module(f"{__name__}.{room}"), name)
