"""``ccdiff-env bench planners``, and what is done with its runs: leaderboard, verify, submit."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ccdiff_env.bench.arguments import (
    PLANNERS,
    add_replays,
    add_run_arguments,
    add_traffic,
    seeds_of,
)
from ccdiff_env.bench.run import Run
from ccdiff_env.scenes.arguments import place_from
from ccdiff_env.system.terminal import say, say_page

#: Traffic of ``bench planners`` without a protocol.
_USUAL_TRAFFIC = "replay,idm,ccdiff,ccdiff-0.5,ccdiff-1"


def add_planner_benchmark(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the benchmark of planners, and what is done with its runs."""
    _add_planners(kinds)
    _add_leaderboard(kinds)
    _add_verify(kinds)
    _add_submit(kinds)


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
        help="a column of nuPlan's own score, by the metrics of nuplan-devkit",
    )
    # without a default, so that the protocol can tell whether it was given
    add_traffic(parser, None, "the others, comma-separated", f" (default: {_USUAL_TRAFFIC})")
    for name, what, usual in (
        ("history", "of the log before an episode", "30, or 10 in scenes of 9.1 s"),
        ("horizon", "that an episode lasts at most", "100, or 80 in scenes of 9.1 s"),
    ):
        words = f"steps {what}; scenes that are shorter are refused (default: {usual})"
        parser.add_argument(f"--{name}-steps", type=int, metavar="N", help=words)
    parser.add_argument(
        "--protocol",
        help="what fixes scenes, traffic and seeds, planner-1.2 (default: the options choose them)",
    )
    parser.add_argument(
        "--level", help="scenes of the protocol: smoke, city, mini, val (default: smoke)"
    )
    add_replays(parser, "worst scenes of every planner")
    parser.set_defaults(run=_planners)


def _planners(args: argparse.Namespace) -> int:
    from ccdiff_env.bench import planner_report as report
    from ccdiff_env.bench.intervals import grouped
    from ccdiff_env.bench.planners import TRAFFIC, planner_jobs, window_of
    from ccdiff_env.bench.plots import plot_robustness
    from ccdiff_env.bench.protocol import PROTOCOL
    from ccdiff_env.interop.nuplan.devkit import VARIABLE, find_devkit

    fixed = PROTOCOL.fix(args)
    if args.nuplan is not None:
        os.environ[VARIABLE] = args.nuplan  # processes of jobs look there, too
    if args.nuplan_score:
        find_devkit()
    planners = list(dict.fromkeys(args.planners.split(",")))
    traffic = (_USUAL_TRAFFIC if args.traffic is None else args.traffic).split(",")
    seeds = seeds_of(args.seeds or "0,1,2")
    source = str(place_from(args))
    window = window_of(source, args.history_steps, args.horizon_steps)
    jobs = [
        job
        for seed in seeds
        for job in planner_jobs(
            source, planners, traffic, seed=seed, window=window, by_nuplan=args.nuplan_score
        )
    ]
    scenes = {k: v for job in jobs for k, v in job.made_from["scenes"].items()}
    if fixed:
        PROTOCOL.check(args.level, scenes)
    title = f"Planners in traffic, {PROTOCOL.name} {args.level}" if fixed else "Planners in traffic"
    if window is not None:
        title += ", {horizon_steps} steps after {history_steps}".format(**window)
        print(title)
    run = Run(args, "planners", seeds=seeds, window=window, **fixed)
    run.note(
        planners={job.arguments["planner"]: job.arguments["sources"]["planner"] for job in jobs},
        traffic={job.arguments["traffic"]: job.arguments["sources"]["traffic"] for job in jobs},
        scenes=scenes,
        protocol_sha256=PROTOCOL.sha256,
    )
    rows = run.episodes(jobs, "planner", "traffic")
    found: report.Results = grouped(rows, "planner", "traffic")
    worst = (report.worst_scenes(found, planner, args.replays) for planner in planners)
    pages = run.replays(row for of in worst for _, row in of)
    privileged = {job.arguments["planner"] for job in jobs if job.made_from["privileged"]}
    scores = [
        report.verdict(found, planners, traffic),
        *report.summary(found, planners, traffic, privileged),
        *report.parts_tables(found),
    ]
    files = {"figures.csv": report.figures_table(found)}
    if len(planners) > 1:
        files["pairs.csv"] = report.pairs_table(found)
    criticality = {
        name: float(TRAFFIC[name].ccdiff.get("criticality", 0.0))
        for name in traffic
        if TRAFFIC[name].driver == "ccdiff"
    }
    return run.report(
        title,
        {
            "Scores": scores,
            "Planners against one another": report.comparison(found, planners, traffic),
            "Worst scenes": report.worst_table(found, max(args.replays, 10), pages),
        },
        rows,
        files,
        plot_robustness(found, criticality, report.short_name, run.folder / "robustness"),
    )


def _add_leaderboard(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("leaderboard", help="planners of several runs in one page")
    parser.add_argument(
        "runs", nargs="+", type=Path, help="run folders of bench planners, and submissions"
    )
    parser.add_argument("--out", type=Path, default=Path("leaderboard.html"), help="page to write")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    parser.set_defaults(run=_leaderboard)


def _leaderboard(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.leaderboard import write_leaderboard

    for heading, text in write_leaderboard(args.runs, args.out).items():
        say(f"{heading}\n\n{text}")
    say_page(args.out, open_it=args.open)
    return 0


def _add_verify(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("verify", help="play episodes of a run again, and compare every bit")
    parser.add_argument("record", type=Path, help="run folder of bench planners, or submission")
    parser.add_argument(
        "--episodes",
        type=int,
        help="only so many, drawn by chance; proves nothing of the others (default: all)",
    )
    parser.add_argument(
        "--seed", type=int, help="repeats a draw of --episodes (default: another every time)"
    )
    parser.add_argument(
        "--own-code",
        action="store_true",
        help="run models of traffic that a run folder names by module or file; for runs of your "
        "own, since code in them runs (default: refused)",
    )
    parser.add_argument("--dataroot", help="folder of nuScenes (default: that of the run)")
    parser.add_argument(
        "--base-instructions",
        action="store_true",
        help="compute without vector extensions (AVX), as the oldest processor would",
    )
    parser.set_defaults(run=_verify)


def _verify(args: argparse.Namespace) -> int:
    from ccdiff_env import _native
    from ccdiff_env.bench.leaderboard import leaderboard
    from ccdiff_env.bench.provenance import processor
    from ccdiff_env.bench.record import Record
    from ccdiff_env.bench.verify import verify

    if args.base_instructions:
        _native.hold_to_base()
    record = Record.read(args.record)
    for heading, text in leaderboard([record]).items():
        say(f"{heading}\n\n{text}")
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
            f"{found.played} of {found.there} were played (--seed {found.seed}): "
            "cite a number after all"
        )
    there = record.processor
    if found.differing and there != processor():
        print(f"made on {there}, this is {processor()}: torch may round differently")
    return 1 if found.differing else 0


def _add_submit(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("submit", help="write the raw results of a run into one file")
    parser.add_argument("folder", type=Path, help="run folder of bench planners")
    parser.add_argument("--out", type=Path, default=Path("submission.zip"), help="file to write")
    parser.add_argument("--code", help="address of the planner's code (default: none, marked so)")
    parser.add_argument(
        "--training-data", help="what it was trained on, in words (default: not said)"
    )
    parser.set_defaults(run=_submit)


def _submit(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.record import submit

    submit(args.folder, args.out, code=args.code, training_data=args.training_data)
    print(args.out)
    return 0
