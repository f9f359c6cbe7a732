"""Time of the layers that the presets are made of, in float32 and in bfloat16.

    OMP_NUM_THREADS=1 python benchmarks/precision.py

Prints milliseconds of processor time for a forward pass and for a training step of each. Weights
are held in the same precision as the inputs, so that casts are not counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from torch import nn

#: Name, layer, shape of the input.
LAYERS: tuple[tuple[str, Callable[[], nn.Module], tuple[int, ...]], ...] = (
    ("fast: linear 128", lambda: nn.Linear(128, 128), (2000, 128)),
    ("fast: convolution 8 to 16", lambda: nn.Conv2d(8, 16, 3, 2, 1), (64, 8, 64, 64)),
    ("paper: linear 256", lambda: nn.Linear(256, 256), (4000, 256)),
    ("paper: first convolution", lambda: nn.Conv2d(7, 64, 7, 2, 3), (16, 7, 224, 224)),
    ("paper: convolution of 64", lambda: nn.Conv2d(64, 64, 3, 1, 1), (16, 64, 56, 56)),
    ("paper: convolution of 256", lambda: nn.Conv2d(256, 256, 3, 1, 1), (16, 256, 14, 14)),
)
REPEATS = 10


def milliseconds(work: Callable[[], object]) -> float:
    """Mean processor time of a call, after two that warm up."""
    for _ in range(2):
        work()
    start = time.process_time()
    for _ in range(REPEATS):
        work()
    return (time.process_time() - start) / REPEATS * 1e3


def main() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    print(f"{'layer':28s} {'forward, ms':>20s} {'training step, ms':>20s}")
    print(f"{'':28s} {'f32':>10s}{'bf16':>10s} {'f32':>10s}{'bf16':>10s}")
    for name, make, shape in LAYERS:
        times = []
        for training in (False, True):
            for kind in (torch.float32, torch.bfloat16):
                layer, x = make().to(kind), torch.randn(shape).to(kind)

                def forward(layer: nn.Module = layer, x: torch.Tensor = x) -> torch.Tensor:
                    with torch.no_grad():
                        return layer(x)

                def step(layer: nn.Module = layer, x: torch.Tensor = x) -> None:
                    layer(x).float().square().sum().backward()

                times.append(milliseconds(step if training else forward))
        print(f"{name:28s} {times[0]:10.2f}{times[1]:10.2f} {times[2]:10.2f}{times[3]:10.2f}")


if __name__ == "__main__":
    main()
