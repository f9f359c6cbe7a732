"""What notebooks show of rollouts: their ``_repr_html_``."""

from __future__ import annotations

import html

from ccdiff_env.record.rollout import Rollout

HEIGHT = 560  #: Of the frame that a replay is shown in, pixels.


def rollout_html(rollout: Rollout) -> str:
    """Return the replay page in a frame that can do nothing but run its own scripts."""
    # imported here: most programs show no notebook
    from ccdiff_env.view.page import page_html

    page = html.escape(page_html(rollout), quote=True)
    return (
        f'<iframe sandbox="allow-scripts" title="{html.escape(repr(rollout), quote=True)}" '
        f'style="width: 100%; height: {HEIGHT}px; border: 1px solid #8888; border-radius: 8px" '
        f'srcdoc="{page}"></iframe>'
    )


Rollout._repr_html_ = rollout_html  # type: ignore[attr-defined]
