"""``ccdiff-env bench``: arguments of the benchmarks, and their reports."""

from __future__ import annotations

import argparse

from ccdiff_env.bench.arguments import (
    PLANNERS,
    add_methods,
    add_replays,
    add_run_arguments,
    add_traffic,
    add_weights,
    counts,
    replan_steps,
)
from ccdiff_env.bench.methods import PAPER_METHODS
from ccdiff_env.bench.planner_cli import add_planner_benchmark
from ccdiff_env.bench.run import Run
from ccdiff_env.system.terminal import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks to the verb ``bench``."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="kind")
    _add_traffic(kinds)
    add_planner_benchmark(kinds)
    _add_scenarios(kinds)
    _add_realism(kinds)


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
        help="only these K with all of --t, others with the first (default: every K)",
    )
    add_weights(parser)
    add_replays(parser, "guided scenes of every guided method, realistic collisions first")
    parser.set_defaults(run=_traffic)


def _traffic(args: argparse.Namespace) -> int:
    from ccdiff_env.bench import traffic_report as report
    from ccdiff_env.bench.plots import plot_scores
    from ccdiff_env.bench.traffic import traffic_jobs

    methods = list(PAPER_METHODS) if args.methods == "all" else args.methods.split(",")
    run = Run(args, "traffic")
    jobs = traffic_jobs(
        run.source,
        methods,
        num_controlled=counts(args.k),
        replan_steps=replan_steps(args.t),
        replan_controlled=None if args.t_at is None else counts(args.t_at),
        weights=run.own_weights,
        seed=args.seed,
    )
    episodes = run.episodes(jobs, "method", "replan_steps", k="num_controlled")
    by_condition = report.conditions(episodes)
    log = next(rows for c, rows in by_condition.items() if c.num_controlled == 0)
    table = {c: report.summarise(rows, log, seed=args.seed) for c, rows in by_condition.items()}
    chosen = report.choose_examples(by_condition, args.replays)
    pages = run.replays(row for _, row in chosen)
    return run.report(
        "Traffic",
        {
            "Figures": report.tables(table),
            "Methods against one another": report.comparison(table),
            "Examples of guided traffic": report.examples_tables(chosen, pages),
        },
        episodes,
        {"figures.csv": report.figures_table(table)},
        plot_scores(report.with_scores(table), run.folder / "scores"),
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
    parser.add_argument("--planners", default=names, help=f"planners to test, {PLANNERS}")
    add_traffic(parser, "ccdiff-1", "what makes the sets")
    parser.add_argument(
        "--plans", type=int, default=128, help="ego plans tried to avoid a collision"
    )
    add_replays(parser, "first collisions of every set, and worst scenarios of every planner")
    parser.set_defaults(run=_scenarios)


def _scenarios(args: argparse.Namespace) -> int:
    from ccdiff_env.bench import cross_report as report
    from ccdiff_env.bench.cross_evaluation import (
        cross_jobs,
        generation_jobs,
        set_folders,
        write_sets,
    )
    from ccdiff_env.bench.intervals import grouped
    from ccdiff_env.bench.planner_report import worst_scenes, worst_table

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
    sets, costs = write_sets(making, made, seconds, weights=run.weights)
    run.note(digests={generator: found.digest for generator, found in sets.items()})
    for generator, found in sets.items():
        say(f"set against {generator}: {found.digest}")
    driving = cross_jobs(sets, planners, seed=args.seed)
    rows = report.cross_rows(sets, run.episodes(driving, "generator", "planner"))
    avoidable = grouped((row for row in rows if row["avoidable"]), "planner", "generator")
    worst = (worst_scenes(avoidable, planner, args.replays) for planner in planners)
    pages = run.replays(row for of in worst for _, row in of)
    return run.report(
        "Egos that traffic is made against, and planners in it",
        {
            "Cross matrix": report.tables(sets, costs, rows),
            "Worst scenarios that can be avoided": worst_table(
                avoidable, max(args.replays, 10), pages, "made against"
            ),
            "Collisions in the sets": report.collisions_tables(sets, run.folder, args.replays),
        },
        rows,
        {
            "figures.csv": report.figures_table(rows),
            "sets.csv": report.sets_table(sets, costs),
        },
    )


def _add_realism(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = kinds.add_parser(
        "realism", help="likelihood of the log under samples of traffic; calibration"
    )
    add_run_arguments(parser)
    add_methods(parser, "replay,constant_velocity,idm,ccdiff_one_sample,ccdiff")
    parser.add_argument("--samples", type=int, default=16, help="episodes per scene and method")
    add_weights(parser)
    parser.set_defaults(run=_realism)


def _realism(args: argparse.Namespace) -> int:
    from ccdiff_env.bench.intervals import figures, grouped
    from ccdiff_env.bench.likelihood import likelihood_jobs
    from ccdiff_env.bench.realism_report import COLUMNS, tables

    run = Run(args, "realism", samples=args.samples)
    jobs = likelihood_jobs(
        run.source,
        args.methods.split(","),
        num_samples=args.samples,
        weights=run.own_weights,
        seed=args.seed,
    )
    rows = run.episodes(jobs, "method")
    found = {method: of for (method,), of in grouped(rows, "method").items()}
    return run.report(
        "Realism",
        tables(found, args.samples),
        rows,
        {"figures.csv": figures(rows, ("method",), COLUMNS)},
    )
