"""The compiled extension of networks: loaded after torch, by ``models.require_networks``."""

from pathlib import Path
from typing import Any, final

from ccdiff_env._native import Scene

@final
class Trainer:
    def __new__(
        cls,
        scenes: list[Scene],
        held_out: list[Scene],
        model: str,
        training: str,
        *,
        device: str,
        stride: int,
        estimate: bool,
        teacher: str | None = None,
        start: str | None = None,
    ) -> Trainer: ...
    def run(self, steps: int) -> list[float]: ...
    def validate(
        self, count: int, *, solver_steps: int | None, num_samples: int, guidance_weight: float
    ) -> dict[str, float] | None: ...
    def cool_down(self, steps: int) -> None: ...
    @property
    def cooldown(self) -> tuple[int, int] | None: ...
    def save(self, path: str) -> None: ...
    def resume(self, path: str) -> None: ...
    def export(self, path: str, notes: str) -> None: ...
    @property
    def step(self) -> int: ...
    @property
    def num_parameters(self) -> int: ...
    @property
    def num_samples(self) -> int: ...

@final
class TrajectoryModel:
    def __new__(cls, path: str, device: str) -> TrajectoryModel: ...
    @property
    def header(self) -> str: ...
    @property
    def num_parameters(self) -> int: ...
    def plan_scenes(
        self,
        scenes: list[Scene],
        steps: list[int],
        seeds: list[int],
        *,
        solver_steps: int | None,
        num_samples: int,
        guidance_weight: float,
        guidance: str | None,
        guided: list[list[int]] | None,
        collision_targets: list[list[int]] | None,
        attention: bool,
        gradient_statistics: bool,
        follow_route: bool,
    ) -> list[dict[str, Any]]: ...

def guidance_preset(name: str) -> str: ...
def model_preset(name: str, model: str = "ccdiff") -> tuple[str, str]: ...
def training_settings(path: str) -> tuple[str, str]: ...
def config_tables() -> str: ...
def default_policies() -> str: ...
def traffic_policy(
    name: str,
    kind: str,
    options: str,
    weights: Path,
    dt_s: float,
    num_threads: int,
    scenes: list[Scene],
) -> object: ...
