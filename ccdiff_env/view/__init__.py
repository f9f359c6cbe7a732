"""Replays to look at: HTML pages, pictures and films of rollouts and logs."""

from __future__ import annotations

from ccdiff_env.view.page import page, write_page
from ccdiff_env.view.sources import find_rollout, log_rollout, play_scene

__all__ = ["find_rollout", "log_rollout", "page", "play_scene", "write_page"]
