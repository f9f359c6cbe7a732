"""What runs with ``device="cuda"``, checked without a GPU.

Tensors that torch takes for CUDA tensors hold ordinary ones inside: every operation of libtorch,
called from Rust or not, comes by here, is refused where it mixes devices as CUDA would refuse it,
and is carried out on the processor. So the figures must be those of ``device="cpu"``. What this
cannot show: memory, speed, kernels that CUDA lacks, and the backward pass, which torch runs in a
thread of the device.
"""

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from ccdiff_env import make_vec
from ccdiff_env.cli import main
from ccdiff_env.errors import ConfigError
from ccdiff_env.models import TrajectoryModel, require_networks, shipped_weights

aten = torch.ops.aten

require_networks()

needs_no_gpu = pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU to run on")


class Pretended(torch.Tensor):
    """A tensor that says it is on CUDA."""

    @staticmethod
    def __new__(cls, held):
        """Wrap a tensor of the processor."""
        made = torch.Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device="cuda:0",
        )
        made.held = held
        return made

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        """Run an operation on the held tensors."""
        return carried_out(func, args, kwargs or {})


def carried_out(func, args, kwargs):
    """What an operation gives, on the device where CUDA would leave it."""
    tensors = [x for x in tree_leaves((args, kwargs)) if isinstance(x, torch.Tensor)]
    pretended = [x for x in tensors if isinstance(x, Pretended)]
    moves = func in (aten._to_copy.default, aten.copy_.default)
    if pretended and not moves and any(x.dim() for x in tensors if not isinstance(x, Pretended)):
        raise RuntimeError(f"{func}: tensors on two devices")
    on_cuda = isinstance(args[0], Pretended) if func is aten.copy_.default else bool(pretended)
    if kwargs.get("device") is not None:
        on_cuda = torch.device(kwargs["device"]).type == "cuda"
        kwargs = {**kwargs, "device": torch.device("cpu")}
    args, kwargs = tree_map(lambda x: x.held if isinstance(x, Pretended) else x, (args, kwargs))
    if func is aten.cudnn_batch_norm.default:
        made = (*aten.native_batch_norm.default(*args), torch.empty(0, dtype=torch.uint8))
    else:
        made = func(*args, **kwargs)
    known = {id(x.held): x for x in pretended}

    def wrapped(x):
        if not on_cuda or not isinstance(x, torch.Tensor):
            return x
        # operations in place give back what they were given
        return known[id(x)] if id(x) in known else Pretended(x)

    return tree_map(wrapped, made)


class PretendCuda(TorchDispatchMode):
    """Within it, there is a CUDA device."""

    def __init__(self):
        super().__init__()
        self.num_on_cuda = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        """Run an operation; count those on CUDA."""
        made = carried_out(func, args, kwargs or {})
        self.num_on_cuda += any(isinstance(x, Pretended) for x in tree_leaves(made))
        return made


@pytest.fixture(autouse=True)
def guards_for_cuda():
    """The pretence must refuse what CUDA refuses, or the tests below would show nothing."""
    torch._C._ensureCUDADeviceGuardSet()
    with PretendCuda() as cuda, pytest.raises(RuntimeError, match="two devices"):
        torch.ones(3) + Pretended(torch.ones(3))
    assert cuda.num_on_cuda == 0


@needs_no_gpu
@pytest.mark.parametrize("device", ["cuda", "cuda:0", "cuda:3"])
def test_a_device_that_is_not_there_is_named_with_the_reason(device):
    with pytest.raises(ConfigError, match=rf'device is "{device}" \(torch: \S.*expected a device'):
        TrajectoryModel(shipped_weights(), device=device)
    with pytest.raises(ConfigError, match=device):
        make_vec(1, traffic="ccdiff", ccdiff={"device": device})


@pytest.mark.parametrize("device", ["", "cpu:0", "cuda:", "cuda:x", "cuda:-1", "cuda:999", "gpu"])
def test_names_of_no_device_are_refused(device):
    with pytest.raises(ConfigError, match='"cuda:N"'):
        TrajectoryModel(shipped_weights(), device=device)


@needs_no_gpu
@pytest.mark.parametrize(
    "words",
    [
        "realism --methods ccdiff_one_sample --samples 1",
        "planners --planners idm --traffic ccdiff",
        "traffic --methods ccdiff --k 2",
        "scenarios --generators idm --planners idm",
    ],
)
def test_networks_of_every_benchmark_run_where_they_are_told(words, tmp_path, capsys):
    place = ["--limit", "1", "--quiet", "--device", "cuda:3", "--out", str(tmp_path / "run")]
    assert main(["bench", *words.split(), *place]) == 2
    assert 'device is "cuda:3" (torch: ' in capsys.readouterr().err


def all_on_torch(monkeypatch):
    """Compute networks by torch on the processor, too: both round by the same kernels.

    Own kernels beside torch are those of ``test_networks.py``; guidance makes more of rounding.
    """
    for module in ("models.trajectory_model", "worlds.worlds"):
        monkeypatch.setattr(f"ccdiff_env.{module}.needs_torch", lambda *_: True)


@needs_no_gpu
def test_traffic_on_cuda_is_that_of_the_processor(monkeypatch):
    all_on_torch(monkeypatch)
    options = {"criticality": 1.0, "num_samples": 2, "cfg_weight": 1.5, "ranking": "gradient"}

    def observations(device):
        ccdiff = {"device": device, "explain": True, **options}
        worlds = make_vec(2, scenes="embedded/val?limit=2", traffic="ccdiff", ccdiff=ccdiff)
        seen = [worlds.reset(seed=0)[0]]
        seen += [worlds.step(np.zeros((2, 2), np.float32))[0] for _ in range(7)]
        return np.stack(seen)

    with PretendCuda() as cuda:
        on_cuda = observations("cuda")
    assert cuda.num_on_cuda > 1000
    np.testing.assert_allclose(on_cuda, observations("cpu"), atol=2e-3)
