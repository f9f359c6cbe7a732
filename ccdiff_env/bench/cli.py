"""``ccdiff-env bench``: arguments of the benchmarks, and their reports."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ccdiff_env.bench.methods import GRAMMAR, OTHERS, PAPER_METHODS, titled
from ccdiff_env.bench.planners import TRAFFIC, TRAFFIC_HELP
from ccdiff_env.bench.run import Run, add_weights, weights_from
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.built_in import EGO_HELP
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.windows import whole_steps
from ccdiff_env.system.settings import check_least, listed
from ccdiff_env.system.table import escaped
from ccdiff_env.system.terminal import say

#: Traffic of ``bench planners`` without a protocol.
_USUAL_TRAFFIC = "replay,idm,ccdiff,ccdiff-0.5,ccdiff-1"

#: Help of an option that names planners.
PLANNERS = f"comma-separated, of: {EGO_HELP.partition('of: ')[2]}"


def add_run_arguments(parser: argparse.ArgumentParser, *, several_seeds: bool = False) -> None:
    """Add what every resumable benchmark takes: scenes, run folder, seed or seeds."""
    add_scene_arguments(parser, "test")
    parser.add_argument("--out", required=True, type=Path, help="run folder; resumes a run in it")
    if several_seeds:
        parser.add_argument(
            "--seeds", help="seeds of the episodes, comma-separated (default: 0,1,2)"
        )
    else:
        parser.add_argument("--seed", type=int, default=0, help="seed of the episodes")
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help=f"processes; this machine has {os.cpu_count()} processors",
    )
    parser.add_argument(
        "--device",
        default="cpu",
        help="where networks of traffic run: cpu, cuda, or cuda:N (with torch)",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.add_argument("--open", action="store_true", help="open the report in the browser")


def add_traffic(
    parser: argparse.ArgumentParser, default: str | None, what: str, more: str = ""
) -> None:
    """Add who drives the others, kinds of traffic by name."""
    parser.add_argument("--traffic", default=default, help=f"{what}, of: {TRAFFIC_HELP}{more}")


def add_methods(parser: argparse.ArgumentParser, default: str, more: str = "") -> None:
    """Add which methods of traffic are compared, their weights, and what is kept of them."""
    text = f"comma-separated{more}, of: {GRAMMAR} (docs/evaluation.md, Methods)"
    parser.add_argument("--methods", default=default, help=text)
    add_weights(parser)
    parser.add_argument(
        "--keep", action="store_true", help="keep all rollouts in rollouts/ of the run folder"
    )


def _kept(args: argparse.Namespace) -> str | None:
    return str((args.out / "rollouts").resolve()) if args.keep else None


def add_replays(parser: argparse.ArgumentParser, which: str) -> None:
    """Add how many replays are made."""
    parser.add_argument(
        "--replays", type=int, default=0, metavar="N", help=f"write replay pages of the N {which}"
    )


def counts(text: str) -> list[int | None]:
    """Return values of K; ``None`` for Full."""
    return listed("--k", text, lambda k: None if k == "Full" else int(k), "numbers and Full")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks to the verb ``bench``."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="kind")
    _add_traffic(kinds)
    _add_planners(kinds)
    _add_scenarios(kinds)
    _add_realism(kinds)
    _add_verify(kinds)


def _add_traffic(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("traffic", help="the paper's experiments: methods x K x T")
    add_run_arguments(parser)
    whole = "; all (every network of the paper's table, guided and not)"
    add_methods(parser, "constant_velocity,idm,ccdiff_unguided,ccdiff", whole)
    parser.add_argument(
        "--k", default="1,2,3,4,5,10,Full", help="controlled vehicles K, comma-separated; Full: all"
    )
    parser.add_argument("--t", default="0.5", help="seconds between plans T, comma-separated")
    parser.add_argument(
        "--t-at",
        metavar="K",
        help="K for which every --t is run; others only with the first (default: every K)",
    )
    parser.add_argument(
        "--others", default=OTHERS[0], choices=OTHERS, help="driver of the other vehicles"
    )
    parser.add_argument(
        "--match",
        metavar="SCR",
        help="compare guided methods at these SCR, comma-separated, interpolated between "
        "--strengths (default: none)",
    )
    parser.add_argument(
        "--strengths",
        default="0.5,0.75,1,1.5,2,3",
        help="with --match: criticalities at which guided methods are run",
    )
    parser.set_defaults(run=_traffic)


def _traffic(args: argparse.Namespace) -> int:
    from ccdiff_env.bench import traffic_report as report
    from ccdiff_env.bench.traffic import traffic_jobs, window_of

    methods = list(PAPER_METHODS) if args.methods == "all" else titled(args.methods.split(","))
    match = listed("--match", args.match, float, "rates") if args.match else []
    strengths = listed("--strengths", args.strengths, float, "criticalities") if match else []
    if match and not all(0.0 < rate < 1.0 for rate in match):
        raise ConfigError(f"--match is {args.match!r}, expected rates between 0 and 1")
    if match and len(set(strengths)) < 2:
        raise ConfigError(f"--strengths is {args.strengths!r}, expected two at least")
    run = Run(args, "traffic")
    run.tell_window(window_of(run.source))
    jobs = traffic_jobs(
        run.source,
        methods,
        num_controlled=counts(args.k),
        replan_steps=listed(
            "--t", args.t, lambda t: whole_steps("--t", float(t), 0.1), "multiples of 0.1 s"
        ),
        replan_controlled=None if args.t_at is None else counts(args.t_at),
        weights=run.own_weights,
        seed=args.seed,
        strengths=strengths,
        keep=_kept(args),
        others=args.others,
    )
    episodes = run.episodes(jobs, "method", "replan_steps", k="num_controlled")
    played = report.conditions(episodes)
    found = report.summarise(played)
    matched, ranked = report.at_equal_scr(played, match), report.rankings(played)
    return run.report(
        "Traffic",
        {
            "Figures": report.tables(played, found),
            "Methods against one another": report.comparison(played, found),
            **({"Rankings less a random one": [ranked]} if ranked else {}),
            **({"Methods at equal SCR (new, controlled)": [matched]} if match else {}),
        },
        episodes,
        {
            "figures.csv": report.figures_table(played, found),
            **({"rankings.csv": ranked} if ranked else {}),
            **({"matched.csv": matched} if match else {}),
        },
        report.plot_at_equal_scr(matched, run.folder / "matched"),
        report.plot(found, run.folder / "front"),
        folded=True,
    )


def _add_planners(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("planners", help="planners x traffic, scored as nuPlan does")
    add_run_arguments(parser, several_seeds=True)
    parser.add_argument(
        "--planners", default="noop,constant_velocity,lane_idm,idm,pdm,replay", help=PLANNERS
    )
    parser.add_argument(
        "--nuplan",
        metavar="FOLDER",
        help="checkout of nuplan-devkit, and of planners after ':' (default: CCDIFF_NUPLAN)",
    )
    parser.add_argument(
        "--nuplan-score",
        action="store_true",
        help="add nuPlan's own score, from the metrics of nuplan-devkit",
    )
    # without a default, so that the protocol can tell whether it was given
    add_traffic(parser, None, "traffic, comma-separated", f" (default: {_USUAL_TRAFFIC})")
    for name, what, usual in (
        ("history", "of the log before an episode", "30, or 10 in scenes of 9.1 s"),
        ("horizon", "that an episode lasts at most", "100, or 80 in scenes of 9.1 s"),
    ):
        words = f"steps {what}; scenes that are shorter are refused (default: {usual})"
        parser.add_argument(f"--{name}-steps", type=int, metavar="N", help=words)
    parser.add_argument(
        "--protocol",
        help="fix scenes, traffic and rules by planner-1.4 (default: the options choose them)",
    )
    parser.add_argument(
        "--level", help="scenes of the protocol: smoke, city, mini, val (default: smoke)"
    )
    parser.add_argument(
        "--metric",
        action="append",
        metavar="MODULE:FUNCTION",
        help="functions of yours, comma-separated, from a rollout to a number: columns of all "
        "tables and tests; or avoidable, whether a collision was (default: none)",
    )
    parser.add_argument(
        "--tags",
        type=Path,
        metavar="CSV",
        help="more tags of scenes, in columns scene and tag (default: those told from log and map)",
    )
    add_weights(parser)
    add_replays(parser, "worst scenes of every planner")
    parser.set_defaults(run=_planners)


def _planners(args: argparse.Namespace) -> int:
    from ccdiff_env.bench import planner_report as report
    from ccdiff_env.bench.intervals import grouped
    from ccdiff_env.bench.planners import METRICS, metric_names, planner_jobs, window_of
    from ccdiff_env.bench.plots import plot_robustness
    from ccdiff_env.bench.protocol import PROTOCOL
    from ccdiff_env.bench.provenance import scene_hashes
    from ccdiff_env.bench.tags import tags_of
    from ccdiff_env.interop.nuplan.devkit import VARIABLE, find_devkit

    if args.nuplan is not None:
        os.environ[VARIABLE] = args.nuplan  # processes of jobs look there, too
    check_least(args, replays=0)
    fixed, weights = PROTOCOL.fix(args), weights_from(args.weights or [])
    if args.nuplan_score:
        find_devkit()
    planners = titled(args.planners.split(","))
    traffic = titled((_USUAL_TRAFFIC if args.traffic is None else args.traffic).split(","))
    asked = ",".join(args.metric).split(",") if args.metric else []
    metrics = [METRICS.get(name, name) for name in dict.fromkeys(asked)]
    own = metric_names(metrics)
    seeds = listed("--seeds", "0,1,2" if args.seeds is None else args.seeds, int, "integers")
    source = str(place_from(args))
    window = window_of(source, args.history_steps, args.horizon_steps)
    jobs = [
        job
        for seed in seeds
        for job in planner_jobs(
            source,
            planners,
            traffic,
            seed=seed,
            window=window,
            by_nuplan=args.nuplan_score,
            metrics=metrics,
            weights=weights,
        )
    ]
    scenes = scene_hashes(source)
    if fixed:
        PROTOCOL.check(args.level, scenes)
    title = f"Planners in traffic, {PROTOCOL.name} {args.level}" if fixed else "Planners in traffic"
    run = Run(args, "planners", seeds=seeds, window=window, **fixed)
    run.tell_window(window)
    run.note(
        planners={job.arguments["planner"]: job.arguments["sources"]["planner"] for job in jobs},
        traffic={job.arguments["traffic"]: job.arguments["sources"]["traffic"] for job in jobs},
        scenes=scenes,
        protocol_sha256=PROTOCOL.sha256,
    )
    rows = run.episodes(jobs, "planner", "traffic")
    tags = tags_of(source, window, args.tags)
    for row in rows:
        row["city"], row["tags"] = tags[row["scene"]][0], ", ".join(tags[row["scene"]][1:])
    found: report.Results = grouped(rows, "planner", "traffic")
    worst = (report.worst_scenes(found, planner, args.replays) for planner in planners)
    pages = run.replays(row for of in worst for _, row in of)
    privileged = {job.arguments["planner"] for job in jobs if job.made_from["privileged"]}
    scores = [
        report.verdict(found),
        *report.summary(found, privileged),
        *report.parts_tables(found, own),
    ]
    files = {"figures.csv": report.figures_table(found, own)}
    if len(planners) > 1:
        files["pairs.csv"] = report.pairs_table(found, own)
    criticality = {
        name: float(TRAFFIC[name].ccdiff.get("criticality", 0.0))
        for name in traffic
        if TRAFFIC[name].driver == "ccdiff"
    }
    return run.report(
        title,
        {
            "Scores": scores,
            "Scores by what the scene asks for": report.tags_table(found, tags),
            "Planners against one another": report.comparison(found, extra=own),
            "Worst scenes": [
                *report.worst_table(found, args.replays, pages),
                escaped(
                    f"ccdiff-env view {run.folder} --scene NAME --planner NAME shows any of them."
                ),
            ],
        },
        rows,
        files,
        plot_robustness(found, criticality, report.short_name, run.folder / "robustness"),
    )


def _add_scenarios(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser(
        "scenarios", help="scenario sets made against egos, and every planner in all of them"
    )
    add_run_arguments(parser)
    names = "idm,constant_velocity,replay,pdm"
    parser.add_argument(
        "--generators", default=names, help="egos that sets are generated against, as --planners"
    )
    parser.add_argument("--planners", default=names, help=f"planners to test, {PLANNERS}")
    add_traffic(parser, "ccdiff-1", "traffic of the sets")
    parser.add_argument(
        "--plans", type=int, default=128, help="ego plans tried to avoid a collision"
    )
    add_weights(parser)
    add_replays(parser, "worst scenarios of every planner")
    parser.set_defaults(run=_scenarios)


def _scenarios(args: argparse.Namespace) -> int:
    from ccdiff_env.bench import scenarios_report as report
    from ccdiff_env.bench.intervals import grouped
    from ccdiff_env.bench.planner_report import worst_scenes, worst_table
    from ccdiff_env.bench.scenarios import cross_jobs, generation_jobs, set_digest, set_folders
    from ccdiff_env.bench.scenes import source_title

    check_least(args, replays=0, plans=1)
    generators, planners = titled(args.generators.split(",")), titled(args.planners.split(","))
    run = Run(
        args,
        "scenarios",
        generators=generators,
        planners=planners,
        traffic=args.traffic,
        plans=args.plans,
    )
    folders = set_folders(generators, run.folder / "sets")
    making = generation_jobs(
        run.source,
        folders,
        traffic=args.traffic,
        seed=args.seed,
        num_plans=args.plans,
        weights=run.own_weights,
    )
    made = {job.arguments["generator"]: job for job in making}
    by_set = grouped(run.episodes(making, "generator"), "generator")
    sets = {generator: rows for (generator,), rows in by_set.items()}
    digests = {generator: set_digest(made[generator], rows) for generator, rows in sets.items()}
    run.note(digests=digests)
    for generator, digest in digests.items():
        print(f"set against {generator}: {digest}")
    driving = cross_jobs(sets, made, planners)
    rows = report.cross_rows(sets, run.episodes(driving, "generator", "planner"))
    avoidable = grouped((row for row in rows if row["avoidable"]), "planner", "generator")
    worst = (worst_scenes(avoidable, planner, args.replays) for planner in planners)
    pages = run.replays(row for of in worst for _, row in of)
    scenes = escaped(source_title(run.source))
    what = f"Scenes: {scenes}. Traffic: {args.traffic}, seed {args.seed}."
    return run.report(
        "Egos that traffic is made against, and planners in it",
        {
            "Cross matrix": report.tables(sets, rows, what),
            "Worst scenarios that can be avoided": worst_table(
                avoidable, args.replays, pages, "made against"
            ),
        },
        rows,
        {
            "figures.csv": report.figures_table(rows),
            "sets.csv": report.sets_table(sets),
        },
    )


def _add_realism(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser(
        "realism", help="likelihood of the log under samples of traffic; calibration"
    )
    add_run_arguments(parser)
    add_methods(parser, "replay,constant_velocity,idm,ccdiff_one_sample,ccdiff")
    parser.add_argument("--samples", type=int, default=16, help="episodes per scene and method")
    parser.set_defaults(run=_realism)


def _realism(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.intervals import figures, grouped
    from ccdiff_env.bench.likelihood import likelihood_jobs
    from ccdiff_env.bench.realism_report import COLUMNS, comparison, pairs_table, plots, tables
    from ccdiff_env.bench.traffic import window_of

    run = Run(args, "realism", samples=args.samples)
    run.tell_window(window_of(run.source))
    jobs = likelihood_jobs(
        run.source,
        titled(args.methods.split(",")),
        num_samples=args.samples,
        weights=run.own_weights,
        seed=args.seed,
        keep=_kept(args),
    )
    rows = run.episodes(jobs, "method")
    found = {method: of for (method,), of in grouped(rows, "method").items()}
    return run.report(
        "Realism",
        {**tables(found, args.samples), "Methods against one another": comparison(found)},
        rows,
        {
            "figures.csv": figures(rows, ("method", "own_weights"), COLUMNS),
            "pairs.csv": pairs_table(found),
        },
        *plots(found, run.folder),
        folded=True,
    )


def _add_verify(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("verify", help="replay the episodes of a run and compare every bit")
    parser.add_argument(
        "record", type=Path, help="run folder of bench planners, traffic or realism"
    )
    parser.add_argument(
        "--episodes",
        type=int,
        help="replay only a random sample of this size (default: all)",
    )
    parser.add_argument("--seed", type=int, help="seed of the sample (default: a random one)")
    parser.add_argument(
        "--own-code",
        action="store_true",
        help="run custom traffic that a run folder names by module or file, and thus its code: for "
        "your own runs only (default: refused)",
    )
    parser.add_argument("--dataroot", help="folder of nuScenes (default: that of the run)")
    parser.set_defaults(run=_verify)


def _verify(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.record import Record
    from ccdiff_env.bench.verify import verify
    from ccdiff_env.bench.verify_traffic import is_of_traffic, verify_traffic

    if is_of_traffic(args.record):
        for name in ("episodes", "seed", "dataroot"):
            if getattr(args, name) is not None:
                raise ConfigError(f"--{name} is for runs of bench planners: all are played here")
        found = verify_traffic(args.record, own_code=args.own_code)
    else:
        record = Record.read(args.record)
        for heading, text in record.tables():
            say(f"{escaped(heading)}\n\n{text}")
        found = verify(
            record,
            episodes=args.episodes,
            seed=args.seed,
            dataroot=args.dataroot,
            own_code=args.own_code,
        )
    for line in found.differing:
        print(line)
    same = found.played - len(found.differing)
    print(f"{same} of {found.played} episodes come out the same, bit for bit")
    if found.played < found.there:
        print(
            f"{found.played} of {found.there} were replayed (--seed {found.seed}): "
            "replay all of them before you cite the result"
        )
    return 1 if found.differing else 0
