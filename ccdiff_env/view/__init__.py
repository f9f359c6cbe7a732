"""Replays to look at: HTML pages, images and videos of rollouts and logs."""

from __future__ import annotations

from ccdiff_env.view.page import address, page_html, write_page
from ccdiff_env.view.sources import find_rollout, log_rollout, play_scene

__all__ = ["address", "find_rollout", "log_rollout", "page_html", "play_scene", "write_page"]
