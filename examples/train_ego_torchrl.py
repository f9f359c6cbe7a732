"""Train a PPO ego with TorchRL: collector, advantages, clipped loss.

pip install torchrl
python examples/train_ego_torchrl.py --traffic idm --frames 100000
"""

from __future__ import annotations

import argparse
from pathlib import Path

try:
    import torch
    from tensordict.nn import TensorDictModule
    from torch import nn
    from torchrl.collectors import Collector
    from torchrl.envs import GymWrapper, RewardSum, StepCounter, TransformedEnv
    from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE
except ImportError as error:
    raise SystemExit(f"this example needs {error.name}: pip install torchrl") from error

import ccdiff_env
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "train")
    parser.add_argument("--traffic", default="idm", help="replay, idm, constant_velocity or ccdiff")
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--batch", type=int, default=2_000, help="frames per update")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/train_ego_torchrl"))
    parser.add_argument("--smoke", action="store_true", help="a short test run")
    return parser.parse_args()


def network(width: int, out: int, *end: nn.Module) -> nn.Sequential:
    layers = (nn.Linear(width, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh())
    return nn.Sequential(*layers, nn.Linear(128, out), *end)


def main() -> None:
    args = arguments()
    if args.smoke:
        args.frames, args.batch = 256, 128
    torch.manual_seed(args.seed)
    gym_env = ccdiff_env.EgoEnv(scenes=scenes_from(args), traffic=args.traffic, info="none")
    width, actions = gym_env.observation_space.shape[0], gym_env.action_space.shape[0]
    env = TransformedEnv(GymWrapper(gym_env))
    env.append_transform(RewardSum())
    env.append_transform(StepCounter())
    env.set_seed(args.seed)

    actor = ProbabilisticActor(
        TensorDictModule(
            network(width, 2 * actions, NormalParamExtractor()),
            in_keys=["observation"],
            out_keys=["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
        return_log_prob=True,
    )
    critic = ValueOperator(network(width, 1), in_keys=["observation"])
    advantage = GAE(gamma=0.98, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.001)
    optimiser = torch.optim.Adam(loss.parameters(), lr=3e-4)
    collector = Collector(
        env, actor, frames_per_batch=args.batch, total_frames=args.frames, device="cpu"
    )
    for i, data in enumerate(collector):
        for _ in range(2 if args.smoke else 8):
            with torch.no_grad():
                advantage(data)
            flat = data.reshape(-1)
            for rows in torch.randperm(len(flat)).split(256):
                parts = loss(flat[rows])
                total = parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]
                optimiser.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimiser.step()
        ended = data["next", "episode_reward"][data["next", "done"]]
        if len(ended):
            print(f"update {i}: {len(ended)} episodes, mean return {ended.mean().item():.3f}")
    collector.shutdown()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.save(actor.state_dict(), args.out / "actor.pt")
    print(f"policy in {args.out / 'actor.pt'}")


if __name__ == "__main__":
    main()
