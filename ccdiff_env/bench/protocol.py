"""The protocol of planners: what a file of the package fixes, so that numbers can be compared."""

from __future__ import annotations

import argparse
import json
import secrets
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError, UnknownNameError
from ccdiff_env.models import shipped_weights
from ccdiff_env.planners.built_in import Seat, ego_driver
from ccdiff_env.record.episode import world_of_seat
from ccdiff_env.scenes import splits
from ccdiff_env.scenes.sources import Place, parse
from ccdiff_env.system.files import read_bytes
from ccdiff_env.system.settings import kept_settings, listed, sha256
from ccdiff_env.traffic.options import DYNAMICS

_FILE = Path(__file__).resolve().parents[1] / "data" / "planner-1.4.json"
#: Arguments that the protocol fixes, beside the scenes and the number of seeds.
_FIXED = ("traffic", "limit", "weights")


@dataclass(frozen=True)
class Protocol:
    """What the file of a protocol says, and the file's hash."""

    fields: Mapping[str, Any]
    sha256: str

    @classmethod
    def read(cls, path: Path) -> Protocol:
        """Read a file of the package."""
        data = read_bytes(path)
        return cls(json.loads(data), sha256(data))

    @property
    def name(self) -> str:
        """Name with version, as ``--protocol`` takes it."""
        return str(self.fields["name"])

    @property
    def panel(self) -> tuple[str, ...]:
        """Names of the traffic that planners are tested in."""
        return tuple(self.fields["traffic"])

    @property
    def dynamics(self) -> tuple[str, ...]:
        """Names of the models of motion that planners may choose."""
        return tuple(self.fields["dynamics"])

    @property
    def levels(self) -> tuple[str, ...]:
        """Names of the choices of scenes."""
        return tuple(self.fields["levels"])

    def world(self, seat: Seat | None, who: str, dt_s: float) -> WorldConfig:
        """Return the world of an episode, see :func:`.world_of_seat`."""
        world = WorldConfig.from_json(json.dumps(self.fields["world"]))
        return world_of_seat(world, seat, who, fixed_by=self.name, dt_s=dt_s)

    def fix(self, args: argparse.Namespace) -> dict[str, Any]:
        """Fill in the arguments that a level fixes, where ``--protocol`` is given.

        Seeds are drawn by the system's randomness when a run begins, so that nobody can play its
        episodes beforehand; ``--seeds`` repeats a draw. Returns settings of the run: ``protocol``,
        its name, and ``level``. Refuses an argument that is fixed, and other data.
        """
        if args.protocol is None:
            if args.level is not None:
                raise ConfigError(f"--level is for --protocol {self.name}")
            return {}
        args.level = args.level or self.levels[0]
        for what, name, known in (
            ("protocol", args.protocol, (self.name,)),
            ("level", args.level, self.levels),
        ):
            if name not in known:
                raise UnknownNameError(f"no {what} {name!r}, there is {', '.join(known)}")
        level = self.fields["levels"][args.level]
        given = [name for name in _FIXED if getattr(args, name) is not None]
        if given:
            raise ConfigError(f"--{given[0]}: {self.name} fixes it, leave it out")
        place = None if args.scenes is None else parse(args.scenes)
        data = None if "embedded" in level else Place("nuscenes", place.path if place else None)
        if place != data:
            wants = "no --scenes" if data is None else "--scenes nuscenes:FOLDER"
            raise ConfigError(f"--level {args.level} of {self.name} takes {wants}")
        args.scenes = f"embedded/{level.get('embedded')}"
        if data is not None:
            args.scenes = str(replace(data, version=level["version"], split=level["split"]))
        args.traffic = ",".join(self.panel)
        if args.seeds is None:
            begun = kept_settings(args.out / "run.json", {}).get("seeds")
            drawn = begun or [secrets.randbits(31) for _ in range(level["num_seeds"])]
            args.seeds = ",".join(map(str, drawn))
        elif (n := len(listed("--seeds", args.seeds, int, "integers"))) != level["num_seeds"]:
            raise ConfigError(
                f"--seeds has {n}, {self.name} {args.level} takes {level['num_seeds']}"
            )
        for planner in args.planners.split(","):
            seat = ego_driver(planner)[1]
            allowed = tuple(DYNAMICS[name] for name in self.dynamics)
            if seat is not None and not isinstance(seat.config.action.dynamics, allowed):
                raise ConfigError(
                    f"{planner} moves by {type(seat.config.action.dynamics).__name__}, {self.name} "
                    f"allows {', '.join(self.dynamics)}"
                )
        return {"protocol": self.name, "level": args.level}

    def check(self, level: str, hashes: Mapping[str, str]) -> None:
        """Refuse scenes, by their content hashes, or weights that are not those of a level."""
        expected = self.fields["levels"][level].get("hashes")
        if expected is not None:
            for name in dict.fromkeys([*expected, *hashes]):
                if hashes.get(name) != expected.get(name):
                    raise DatasetError(
                        f"scene {name!r} has hash {hashes.get(name)}, {self.name} fixes "
                        f"{expected.get(name)}"
                    )
        for network, fixed in self.fields["weights"].items():
            found = sha256(read_bytes(shipped_weights(network)))
            if found != fixed:
                raise DatasetError(
                    f"weights of {network} have SHA-256 {found}, {self.name} fixes {fixed}"
                )

    def level_of(
        self,
        sha256: str,
        scenes: Mapping[str, str],
        traffic: Iterable[str],
        seeds: Sequence[int],
        dynamics: Collection[str] = (),
    ) -> str | None:
        """Return the level that results are of in words, with what is missing of its scenes.

        ``None`` where they are of no level: figures compare with a protocol's only where all that
        it fixes is the same.
        """
        if sha256 != self.sha256 or set(traffic) != set(self.panel):
            return None
        if not {*dynamics} <= {*self.dynamics}:
            return None
        for name, level in self.fields["levels"].items():
            if len(seeds) != level["num_seeds"]:
                continue
            if "hashes" in level:
                if dict(scenes) == level["hashes"]:
                    return f"{self.name} {name}"
                continue
            listed = [scene for part in level["split"].split("+") for scene in splits()[part]]
            if scenes and set(scenes) <= set(listed):
                few = "" if len(scenes) == len(listed) else f", {len(scenes)} of {len(listed)}"
                return f"{self.name} {name}{few} scenes"
        return None


#: The protocol of this release: also runs that choose scenes, traffic or seeds of their own keep
#: its world and its score.
PROTOCOL = Protocol.read(_FILE)
