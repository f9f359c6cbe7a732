"""Images and videos of rollouts."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError
from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.scenes.scene_types import AGENT_KINDS
from ccdiff_env.system.files import writing
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.view import render
from ccdiff_env.view.captions import DRIVER_TITLES, agent_titles, driver_of, is_collision, still
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.render import LOOK, NUMBERS
from ccdiff_env.view.sources import log_rollout

GAP = 6  #: Pixels between videos side by side.
HOLD_S = 1.6  #: The last image stays so long: the verdict can be read.
FPS = 10.0  #: Images per second.


class Video:
    """Draws steps of one rollout.

    ``size`` in pixels shows ``span_m`` metres across; in the middle is the agent ``follow`` (an id
    or a name on its page; the first agent by default), or the point ``centre_m`` of the scene.
    ``captions`` are title, time, verdict, names, scale bar and legend; ``theme`` is ``"light"`` or
    ``"dark"``. A :class:`ConfigError` names an agent that is not there.
    """

    def __init__(
        self,
        rollout: Rollout,
        *,
        size: tuple[int, int] = (720, 720),
        span_m: float = 90.0,
        follow: str | None = None,
        centre_m: tuple[float, float] | None = None,
        captions: bool = True,
        theme: str = "light",
        title: str | None = None,
    ) -> None:
        self._names = [short for short, _ in agent_titles(rollout.scene)]
        known = [*rollout.agent_ids, *self._names]
        if follow is not None and follow not in known:
            expected = f"expected an id or a name on its page: {', '.join(self._names)}"
            raise ConfigError(f"no agent {follow!r} in {rollout.scene.name}, {expected}")
        self._rollout, self.num_steps, self.dt_s = rollout, rollout.num_steps, rollout.dt_s
        self._size, self._span_m = size, span_m
        #: Index of who is followed.
        self.middle = 0 if follow is None else known.index(follow) % len(self._names)
        self._captions, self.theme = captions, theme
        self._title = rollout.scene.name if title is None else title
        self._fate = outcome(rollout)
        vehicles = np.array(rollout.scene.agent_types) == "vehicle"
        # of a moment alone, the log says who is parked
        whole = rollout if rollout.num_steps > 1 else log_rollout(rollout.scene)
        self._parked = still(whole) & vehicles
        self._there = _there(rollout)
        self._centres = _centres(rollout, self.middle)
        if centre_m is not None:
            self._centres = np.tile(np.asarray(centre_m, np.float32), (rollout.num_steps, 1))
        self._drivers = [driver_of(rollout, i) for i in range(len(rollout.agent_ids))]
        colours = render.all_colours(theme)
        self._legend = [(colours[name], title) for name, title in _legend(rollout, self._drivers)]
        self._number = {name: i for i, name in enumerate(rollout.agent_ids)}

    @property
    def moment(self) -> int:
        """The step that matters: of a contact, else the middle."""
        if self._fate.tone == "bad":
            return round(self._fate.decided_s / self._rollout.dt_s)
        return (self.num_steps - 1) // 2

    def svg(self, step: int) -> str:
        """Draw a step as SVG; see :meth:`frame`."""
        return str(self._drawn(step, svg=True))

    def pixels(self, point: npt.NDArray[np.float32], step: int) -> npt.NDArray[np.float64]:
        """Return where a point of the scene [2] is in the image of a step, pixels from the top
        left.
        """
        x, y = (point - self._centres[step]) * (self._size[0] / self._span_m)
        return np.array([self._size[0] / 2 + x, self._size[1] / 2 - y])

    def frame(self, step: int) -> render.Image:
        """Draw a step as an image [H, W, 3]; a :class:`ConfigError` says which steps there are."""
        image: render.Image = self._drawn(step)
        return image

    def _drawn(self, step: int, *, svg: bool = False) -> Any:
        captions, run = self._captions, self._rollout
        if not 0 <= step <= run.num_steps - 1:
            raise ConfigError(f"step is {step}, expected 0 to {run.num_steps - 1}")
        there = np.flatnonzero(self._there[:, step])
        # an ego at its goal stays where it was last
        last = [np.flatnonzero(run.valid[i, : step + 1])[-1] for i in there]
        centre = self._centres[step]
        plan = next((p for p in reversed(run.plans) if p.made_at <= step), None)
        recent = [
            event
            for event in run.events
            if is_collision(run, event) and 0 <= step - event.step < LOOK["MARK_S"] / run.dt_s
        ]
        hit = {self._number[i] for e in recent for i in (e.agent_id, e.partner_id) if i}
        kinds = run.scene.agent_types
        caption = self._title + (f"  {step * run.dt_s:.1f} s" if run.num_steps > 1 else "")
        if run.num_steps > 1 and step * run.dt_s > self._fate.decided_s - 1e-6:
            caption += f"  {self._fate.text}"
        numbers = [[AGENT_KINDS.index(kinds[i]), NUMBERS[self._drivers[i]]] for i in there]
        looks = np.array(numbers, np.uint8).reshape(-1, 2)
        return _native.render_arrays(
            run.position[there, last],
            run.heading[there, last],
            np.ascontiguousarray(run.scene.sizes[there, :2], np.float32),
            looks[:, 0].copy(),
            looks[:, 1].copy(),
            np.array([i in hit for i in there], bool),
            self._parked[there],
            (there == self._number.get("ego")) & ~run.valid[there, step],
            scene=run.scene,
            step_idx=run.start_step + step,
            size=self._size,
            span_m=self._span_m,
            centre_m=(float(centre[0]), float(centre[1])),
            up_rad=math.pi / 2,
            route_m=np.zeros((0, 2), np.float32),
            trails=list(self._trails(step, there)),
            samples=[*self._meant(step, False), *self._planned(plan, selected=False)],
            plans=[*self._planned(plan, selected=True), *self._meant(step, True)],
            collisions_m=self._marks(recent, step),
            names=[self._names[i] for i in there] if captions else [],
            caption=caption if captions else "",
            scale_bar=captions,
            legend=self._legend if captions else [],
            theme=self.theme,
            svg=svg,
        )

    def _trails(
        self, step: int, there: npt.NDArray[np.int64]
    ) -> Iterator[tuple[npt.NDArray[np.float32], int]]:
        run = self._rollout
        first = max(0, step - round(LOOK["TRAIL_S"] / run.dt_s))
        for i in there:
            line = run.position[i, first : step + 1][run.valid[i, first : step + 1]]
            if len(line) > 1 and np.ptp(line, axis=0).max() > 0.5:
                yield np.ascontiguousarray(line), NUMBERS[self._drivers[i]]

    def _marks(self, events: Sequence[RolloutEvent], step: int) -> npt.NDArray[np.float32]:
        """Points [N, 2] half way between those that met."""
        run = self._rollout
        both = (sorted(self._number[i] for i in (e.agent_id, e.partner_id) if i) for e in events)
        pairs = [list(pair) for pair in dict.fromkeys(map(tuple, both))]
        there = [pair for pair in pairs if run.valid[pair, step].all()]
        points = [run.position[pair, step].mean(axis=0) for pair in there]
        return np.array(points, np.float32).reshape(-1, 2)

    def _meant(self, step: int, chosen: bool) -> Iterator[tuple[npt.NDArray[np.float32], int]]:
        """Yield what the ego's planner means to do: what it chose, or the other candidates."""
        made = [meant for meant in self._rollout.intentions if meant.made_at <= step]
        for meant in made[-1:]:
            for way in meant.trajectories[:1] if chosen else meant.trajectories[1:]:
                yield np.ascontiguousarray(way[:, :2], np.float32), NUMBERS["ego"]

    def _planned(
        self, plan: TrafficPlan | None, *, selected: bool
    ) -> Iterator[tuple[npt.NDArray[np.float32], int]]:
        """Yield the selected samples of those that follow the plan, or the others."""
        if plan is None:
            return
        for row, agent in enumerate(plan.agents):
            if not plan.follows_plan[row]:
                continue
            driver = "adversary" if plan.guided[row] else self._drivers[agent]
            for number, sample in enumerate(plan.samples[:, row, :, :2]):
                chosen = number == plan.selected_sample[row]
                if chosen == selected and np.isfinite(sample).all():
                    yield np.ascontiguousarray(sample, np.float32), NUMBERS[driver]


def _there(rollout: Rollout) -> npt.NDArray[np.bool_]:
    """Who is drawn at each step [A, T]: an ego that has reached its goal stays where it did."""
    there = rollout.valid.copy()
    for event in rollout.events:
        ego = rollout.agent_ids.index(event.agent_id)
        if event.kind == "goal" and event.agent_id == "ego" and there[ego, : event.step].any():
            there[ego, event.step :] = True
    return there


def _legend(rollout: Rollout, drivers: Sequence[str]) -> list[tuple[str, str]]:
    """Colours and titles of everybody in a rollout, in the order of the page's legend."""
    kinds = rollout.scene.agent_types
    seen = {"static" if k == "static" else d for k, d in zip(kinds, drivers, strict=True)}
    listed = [(name, title) for name, title in DRIVER_TITLES.items() if name in seen]
    return [("static obstacle" if n == "static" else n, title) for n, title in listed]


def _centres(rollout: Rollout, agent: int) -> npt.NDArray[np.float32]:
    """Where an agent is at each step [T, 2]; where it is absent, at the nearest step."""
    steps = np.flatnonzero(rollout.valid[agent])
    if not len(steps):
        raise ConfigError(f"agent {rollout.agent_ids[agent]!r} is never present in the rollout")
    gaps = np.abs(np.arange(rollout.num_steps)[:, None] - steps[None, :])
    centres: npt.NDArray[np.float32] = rollout.position[agent, steps[gaps.argmin(axis=1)]]
    return centres


def side_by_side(videos: Sequence[Video], step: int) -> render.Image:
    """Draw a step of each video side by side; videos that are over show their last."""
    images = [video.frame(min(step, video.num_steps - 1)) for video in videos]
    gap = np.full((images[0].shape[0], GAP, 3), 255, np.uint8)
    parts = [part for image in images for part in (gap, image)]
    return np.concatenate(parts[1:], axis=1)


def save_video(videos: Sequence[Video], path: Path) -> None:
    """Write a video (``.gif``, ``.mp4``) of runs side by side, :data:`FPS` images a second."""
    save = {".gif": render.save_gif, ".mp4": render.save_mp4}[path.suffix.lower()]
    last, every = max(video.num_steps for video in videos) - 1, 1.0 / (FPS * videos[0].dt_s)
    steps = [int(k * every + 1e-6) for k in range(math.ceil(last / every - 1e-9))] + [last]
    images = [side_by_side(videos, step) for step in steps]
    aside = path.with_name(f".{os.getpid()}{path.suffix}")
    with writing(path):  # whole or not at all
        try:
            save(np.stack(images + images[-1:] * round(HOLD_S * FPS)), aside, FPS)
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)
