"""``ccdiff-env bench``: arguments of the benchmarks, and their reports."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ccdiff_env.bench.arguments import (
    METHODS,
    PLANNERS,
    Listed,
    Run,
    add_device,
    add_methods,
    add_replays,
    add_run_arguments,
    add_traffic,
    add_weights,
    counts,
    replan_steps,
)
from ccdiff_env.bench.planner_cli import add_planner_benchmark
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    scenes_from,
)
from ccdiff_env.system.files import file_name, read_text
from ccdiff_env.system.terminal import say

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks to the verb ``bench``."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="kind")
    _add_traffic(kinds)
    add_planner_benchmark(kinds)
    _add_scenarios(kinds)
    _add_learning(kinds)
    _add_speed(kinds)
    _add_realism(kinds)
    _add_reactivity(kinds)


def _add_traffic(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("traffic", help="the paper's experiments: methods x K x T")
    add_run_arguments(parser)
    parser.add_argument(
        "--methods",
        action=Listed,
        names=METHODS,
        default="constant_velocity,idm,ccdiff_unguided,ccdiff",
        help="comma-separated; all (every network of the paper's table, guided and not)",
    )
    parser.add_argument(
        "--k", default="1,2,3,4,5,10,Full", help="controlled vehicles K, comma-separated; Full: all"
    )
    parser.add_argument("--t", default="0.5", help="seconds between plans T, comma-separated")
    parser.add_argument(
        "--t-at",
        metavar="K",
        help="only these K with all of --t, others with the first (default: every K)",
    )
    parser.add_argument(
        "--listed",
        metavar="FILE",
        help="lists of vehicles (JSON) for the method ccdiff_listed (default: without it)",
    )
    add_weights(parser)
    add_replays(parser, "guided scenes of every guided method, realistic collisions first")
    parser.set_defaults(run=_traffic)


def _traffic(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.comparison import write_comparison
    from ccdiff_env.bench.correlation import write_correlations
    from ccdiff_env.bench.examples import choose_examples, examples_table
    from ccdiff_env.bench.methods import METHODS, PAPER_METHODS
    from ccdiff_env.bench.plots import plot_scores
    from ccdiff_env.bench.tables import condition_of, conditions, summarise, write_tables
    from ccdiff_env.bench.traffic import traffic_jobs
    from ccdiff_env.traffic import read_ranking

    methods = list(PAPER_METHODS) if args.methods == "all" else args.methods.split(",")
    listed = None
    settings: dict[str, Any] = {}
    if args.listed is not None:
        listed = read_ranking(args.listed)
        settings["listed"] = {name: list(ids) for name, ids in sorted(listed.items())}
        methods += [] if "ccdiff_listed" in methods else ["ccdiff_listed"]
    run = Run(args, "traffic", **settings)
    jobs = traffic_jobs(
        run.source,
        methods,
        num_controlled=counts(args.k),
        replan_steps=replan_steps(args.t),
        replan_controlled=None if args.t_at is None else counts(args.t_at),
        listed=listed,
        weights=run.own_weights,
        seed=args.seed,
    )
    by_condition = conditions(run.results(jobs))
    log = next(rows for c, rows in by_condition.items() if c.num_controlled == 0)
    table = {c: summarise(rows, log, seed=args.seed) for c, rows in by_condition.items()}
    write_tables(table, run.folder)
    write_comparison(table, methods, run.folder)
    write_correlations(by_condition, run.folder)
    plot_scores(table, run.folder / "scores.png")
    job_of = {
        (condition_of(job.name), scene): job for job in jobs for scene in job.arguments["names"]
    }
    chosen = choose_examples(by_condition, args.replays)
    pages = run.replays(
        {(c, row["scene"]): (job_of[c, row["scene"]], row["scene"]) for c, row in chosen},
        lambda key: f"{METHODS[key[0].method].label}, K = {key[0].k}: {key[1]}",
    )
    run.write("examples.md", examples_table(chosen, pages))
    return run.report(
        "Traffic",
        plots=["scores.png"],
        parts={
            "Tables": "table.md",
            "Methods against one another": "comparison.md",
            "Cliques and collisions": "correlation.md",
            "Examples of guided traffic": "examples.md",
        },
    )


def _add_scenarios(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser(
        "scenarios", help="scenario sets made against egos, and every planner in all of them"
    )
    add_run_arguments(parser)
    names = "idm,constant_velocity,replay,pdm"
    parser.add_argument(
        "--generators", default=names, help="egos that sets are made against, as --planners"
    )
    parser.add_argument("--planners", default=names, help=f"planners to test, of: {PLANNERS}")
    add_traffic(parser, "ccdiff-1", "what makes the sets, each in a folder of its own in --out")
    parser.add_argument(
        "--plans", type=int, default=128, help="ego plans tried to avoid a collision"
    )
    add_replays(parser, "first collisions of every set, and worst scenarios of every planner")
    parser.set_defaults(run=_scenarios)


def _scenarios(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.cross_evaluation import traffic_named
    from ccdiff_env.bench.cross_ranking import ranking

    kinds = args.traffic.split(",")
    if len(kinds) == 1:
        return _scenarios_of(args)
    for kind in kinds:
        traffic_named(kind)
    run = Run(
        args,
        "scenarios",
        generators=args.generators.split(","),
        planners=args.planners.split(","),
        traffic=args.traffic,
        plans=args.plans,
    )
    folders = {kind: run.folder / file_name(kind, "") for kind in dict.fromkeys(kinds)}
    for kind, folder in folders.items():
        _scenarios_of(
            argparse.Namespace(**{**vars(args), "traffic": kind, "out": folder, "open": False})
        )
    run.write("table.md", ranking(folders))
    return run.report(
        "Traffic that is made against egos, and planners in it",
        plots=[],
        parts={"Generators and planners": "table.md"},
    )


def _scenarios_of(args: argparse.Namespace) -> int:
    """Make and drive the sets of one kind of traffic."""
    from ccdiff_env.bench.cross_evaluation import (
        cross_jobs,
        generation_jobs,
        set_folders,
        write_sets,
    )
    from ccdiff_env.bench.cross_report import avoidable_rows, write_collisions, write_cross
    from ccdiff_env.bench.planner_report import short_name, worst_scenes, worst_table

    generators, planners = args.generators.split(","), args.planners.split(",")
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
        run.source, folders, traffic=args.traffic, seed=args.seed, num_plans=args.plans
    )
    made = run.results(making)
    seconds = run.processor_seconds(making)
    sets, realism = write_sets(making, made, seconds, weights=run.weights)
    run.note(digests={generator: found.digest for generator, found in sets.items()})
    for generator, found in sets.items():
        say(f"set against {generator}: {found.digest}")
    driving = cross_jobs(sets, planners, seed=args.seed)
    cells = run.rows(driving, "generator", "planner")
    write_cross(sets, realism, cells, run.folder)
    write_collisions(sets, run.folder, args.replays)
    avoidable = avoidable_rows(sets, cells)
    job_of = {
        (job.arguments["planner"], job.arguments["generator"], scene): job
        for job in driving
        for scene in job.arguments.get("files", ())
    }
    pages = run.replays(
        {
            (planner, name, row["scene"]): (job_of[planner, name, row["scene"]], row["scene"])
            for planner in planners
            for name, row in worst_scenes(avoidable, planner, args.replays)
        },
        lambda key: f"{short_name(key[0])}, made against {short_name(key[1])}: {key[2]}",
    )
    run.write("worst.md", worst_table(avoidable, max(args.replays, 10), pages, "made against"))
    return run.report(
        "Egos that traffic is made against, and planners in it",
        plots=["cross.png"],
        parts={
            "Cross matrix": "table.md",
            "Worst scenarios that can be avoided": "worst.md",
            "Collisions in the sets": "collisions.md",
        },
    )


def _add_learning(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("learning", help="egos trained in different traffic, all compared")
    add_run_arguments(parser)
    add_other_scenes(parser, "train")
    parser.add_argument(
        "--stages",
        default="replay,ccdiff,critical",
        help="traffic of training, comma-separated, of: replay, ccdiff, critical",
    )
    parser.add_argument("--seeds", type=int, default=3, help="egos per traffic")
    parser.add_argument("--steps", type=int, default=150_000, help="steps of each stage")
    parser.add_argument(
        "--base-steps", type=int, default=1_200_000, help="steps in log replay before the stages"
    )
    add_traffic(parser, "replay,ccdiff,ccdiff-1,ccdiff-2", "traffic of the evaluation")
    parser.add_argument(
        "--draws", type=int, default=3, help="times that each scene is driven in CCDiff traffic"
    )
    parser.add_argument(
        "--race",
        type=float,
        metavar="S",
        help="only this: seconds until 80 and 95 %% of the training episodes succeed, S at most "
        "(default: the comparison of traffic)",
    )
    parser.set_defaults(run=_learning)


def _learning(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.learning import OBSERVATION, learning_table, training_jobs
    from ccdiff_env.bench.planners import TRAFFIC, planner_jobs

    if args.race is not None:
        from ccdiff_env.bench.race import race, race_table

        print(race_table(race(str(other_place(args)), seed=args.seed, max_s=args.race)))
        return 0
    run = Run(args, "learning", steps=args.steps, base_steps=args.base_steps)
    base, taught = training_jobs(
        str(other_place(args)),
        args.stages.split(","),
        [args.seed + k for k in range(args.seeds)],
        steps=args.steps,
        base_steps=args.base_steps,
        folder=run.folder / "egos",
    )
    run.results(base, "training")
    run.results(taught, "training")
    planners = [str(job.arguments["path"]) for job in taught]
    traffic = args.traffic.split(",")
    tests = [
        job
        for draw in range(args.draws)
        for job in planner_jobs(
            run.source,
            [*planners, "constant_velocity", "idm", "replay"],
            [name for name in traffic if draw == 0 or TRAFFIC[name].driver == "ccdiff"],
            seed=args.seed + draw,
            options={"observation": OBSERVATION},
        )
    ]
    text = learning_table(run.rows(tests, "planner", "traffic"))
    run.write("table.md", text)
    say(text)
    return 0


def _add_speed(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("speed", help="seconds per plan against the number of vehicles")
    add_scene_arguments(parser, "test")
    parser.add_argument("--out", required=True, type=Path, help="folder of table and plot")
    parser.add_argument("--rounds", type=int, default=5, help="plans per measurement")
    parser.add_argument("--samples", type=int, default=1, help="samples per plan")
    add_device(parser)
    parser.set_defaults(run=_speed)


def _speed(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.jobs import use_one_thread
    from ccdiff_env.bench.speed import measure_speed, write_speed

    use_one_thread()
    timings = measure_speed(
        scenes_from(args),
        rounds=args.rounds,
        num_samples=args.samples,
        device=args.device,
    )
    write_speed(timings, args.out)
    say(read_text(args.out / "table.md"))
    return 0


def _add_realism(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("realism", help="likelihood of the log under samples of traffic")
    add_run_arguments(parser)
    add_methods(parser, "replay,constant_velocity,idm,ccdiff_one_sample,ccdiff")
    parser.add_argument("--samples", type=int, default=16, help="episodes per scene and method")
    add_weights(parser)
    parser.set_defaults(run=_realism)


def _realism(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.likelihood import likelihood_jobs
    from ccdiff_env.bench.likelihood_report import write_likelihoods

    run = Run(args, "realism", samples=args.samples)
    jobs = likelihood_jobs(
        run.source,
        args.methods.split(","),
        num_samples=args.samples,
        weights=run.own_weights,
        seed=args.seed,
    )
    rows = {method: found for (method,), found in run.rows(jobs, "method").items()}
    write_likelihoods(rows, run.folder, num_samples=args.samples)
    return run.report(
        "Realism", plots=["likelihoods.png"], parts={"Likelihood of the log": "table.md"}
    )


def _add_reactivity(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser("reactivity", help="an ego that leaves its log, and who copes")
    add_run_arguments(parser)
    add_traffic(parser, "replay,idm,ccdiff")
    parser.set_defaults(run=_reactivity)


def _reactivity(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.reactivity import reactivity_jobs, write_reactivity

    run = Run(args, "reactivity")
    jobs = reactivity_jobs(run.source, args.traffic.split(","), seed=args.seed)
    write_reactivity(run.rows(jobs, "traffic", "way"), run.folder)
    return run.report("Reactivity", plots=[], parts={"Who copes": "table.md"})
