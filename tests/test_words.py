"""Words: what has one name keeps it. The former names come back nowhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ENDINGS = {".rs", ".py", ".pyi", ".md", ".js", ".html", ".toml"}
#: Former name -> present one, and the folders in which it was used.
FORMER = {
    r"[Rr]oll-out": ("rollout", "rust ccdiff_env docs tools examples benchmarks"),
    r"\bjump_sigma\b": ("posterior_std", "rust docs"),
    r"\bSituation\b": ("GuidanceContext", "rust docs"),
    r"\bpull_back\b": ("vjp", "rust docs"),
    r"\b(WorldGuide|GuideStep|Guide)\b": ("WorldGuidance, GuidanceStep, Guidance", "rust"),
    r"\bstrengths?\b": ("guidance_scale", "rust/models/src/guidance"),
    r"\b(Roster|Hints|Due)\b": ("PlannedAgents, RankingInputs, PreparedRequest", "rust"),
    r"\bsingled_out\b": ("select_guided", "rust docs"),
    r"\bLesson\b": ("TrainingStep", "rust"),
    r"\b(Push|Pace)\b": ("LateralPerturbation, LongitudinalPerturbation", "rust"),
    r"\bRanker::(Human|Distance)\b": ("Ranker::Listed, Ranker::DistanceCliques", "rust docs"),
    r"\bCommand\b|native\.command\b": (
        "PlanOverride, override_plan",
        "rust/sim/src rust/models/src rust/py/src ccdiff_env/envs docs",
    ),
    r"\bMotion\b": (
        "AgentMotion, LateralSpeed, Trajectories",
        "rust/sim/src/policy rust/sim/src/world rust/sim/src/dynamics rust/sim/src/metrics",
    ),
    r"\b(Eight|Turn)\b|\bwide!": ("F32x8, RowTransform, simd_dispatch!", "rust/sim/src"),
    r"\bMatch\b|\bmatches\b": ("SelectionEpisode, episodes", "ccdiff_env/envs ccdiff_env/bench"),
    r"\bRolloutPlan\(": ("TrafficPlan", "ccdiff_env docs examples tools"),
    r"\bparity_rate\b|\bParity\b": ("reference_impl_rate, ReferenceImpl", "rust"),
    r"\bPARITY\b": ("REFERENCE_IMPL", "rust"),
    r"\b(Home|Shot|Touch)\b": ("ProcessGuard, ViewOptions, ContactRow", "rust/py"),
    r"\blap\b|\bowed\b": ("on_phase_end, reset_pending", "rust/sim"),
    r"\b[Tt]ally\b": ("EpisodeStatistics", "rust docs"),
    r"\bfold_seed\b": ("normalize_seed", "ccdiff_env"),
    r"observation.*\bnum_agents\b": ("num_neighbors", "ccdiff_env docs examples"),
    r"\bplan\.(chosen|executed)\b": (
        "selected_sample, follows_plan",
        "rust ccdiff_env",
    ),
    r"ccdiff_human|[\"`]--(human|lessons)\b|\b[Ll]essons?\b": (
        "ccdiff_listed, --listed, --stages, training stages",
        "docs benchmarks examples",
    ),
    r"\bsettled\b": ("resolved", "ccdiff_env/envs"),
    r"\bCast\b": ("AgentSelection", "ccdiff_env docs"),
    r"\bStage\b|\bbystanders?\b": ("ScenarioBuilder, background actors", "tools docs"),
    r"\bweakness (curve|plot)\b": ("robustness curve", "ccdiff_env docs"),
    r"\bmildest\b": ("least aggressive", "ccdiff_env rust docs"),
    r"\bExplanation\b": ("PlanRecord", "rust ccdiff_env docs"),
    r"\b(Partners|Others|Frozen)\b|config\.(partners|others|frozen)\b": (
        "CollisionTargets, BackgroundDriver, ParkedRule",
        "rust/models/src/traffic rust/py-models/src",
    ),
    r"\b(orr|cfd)_parity\b": ("orr_reference_impl, cfd_reference_impl", "ccdiff_env docs"),
    r"\bbeen_on_road\b": ("has_been_on_road", "rust docs"),
    r"\b[Ff]ilm(s|_strip)?\b|save_film": (
        "Video, save_video, side_by_side",
        "ccdiff_env tools docs",
    ),
    r"(?<!<)(?<!</)\b[Pp]ictures?\b": (
        "image, animation, Drawing",
        "rust/render ccdiff_env/view tools",
    ),
    r"\b(Driver|LogShot)\b": ("DrawStyle, LogView", "rust/render"),
    r"\b[Gg]ames?\b|\bGAME\b": (
        "multi-agent environment, playground",
        "rust ccdiff_env docs tools examples benchmarks",
    ),
    r"\b[Cc]hoosers?\b(?!\")|\bCHOOSERS\b": (
        "adversary policy, AdversaryPolicy, ADVERSARY_POLICIES",
        "rust ccdiff_env docs examples",
    ),
    r"MapPieces|map_pieces|\b[Pp]ieces\b": ("MapSegments, segments", "rust/sim/src/observe"),
    r"\bnum_map_pieces\b": ("num_map_segments", "rust docs examples benchmarks tools"),
    r"\b[Ff]acts\b": ("captions, info", "ccdiff_env/view tools/playground"),
    r"\bBody(?!,$)\b|\b[Bb]odies\b": (
        "Footprint, footprints",
        "rust/sim/src/events rust/sim/src/state.rs",
    ),
    r"\bSTANDING_": ("STATIONARY_", "rust ccdiff_env"),
    r"\burgency_s\b|\bPlannerView\b": ("edge_time_s, PlanInput", "rust"),
    r"\.joined\b": ("is_edge, adjacency", "rust/models rust/sim ccdiff_env docs"),
    r"cross matrix": ("cross-evaluation", "ccdiff_env docs"),
    r"\btold (its )?routes\b": ("with routes", "ccdiff_env docs"),
    r"models\.Planner\b|\bstruct Planner\b": ("TrajectoryModel", "rust ccdiff_env docs benchmarks"),
    r"[rR]ollout\.figures\b|\boutcome\.figures\b|\b[fF]igures of (a|the|its) steps?\b": (
        "info, info columns",
        "rust/sim rust/py ccdiff_env docs",
    ),
    r"(?<![`\"])\b[pP]ictures?\b(?![`\"])": ("image, render_options", "ccdiff_env/envs"),
    r"\bColumn\b(?! and row)": (
        "InfoColumn, ObservationColumn",
        "rust/sim/src/world rust/sim/src/observe",
    ),
    r"\bstates\.place\(|fn place\(": ("set_pose", "rust/sim"),
    r"\blets through\b": ("keeps", "rust ccdiff_env docs"),
}


#: Folders in docs that `make docs` writes.
BUILT = {"site", "notebooks", "jupyter_execute"}


@pytest.mark.parametrize("former", FORMER)
def test_former_names_do_not_come_back(former):
    present, folders = FORMER[former]
    files = [f for folder in folders.split() for f in (ROOT / folder).rglob("*")]
    found = [
        f"{file.relative_to(ROOT)}: {line.strip()}"
        for file in files
        if file.suffix in ENDINGS and not BUILT & set(file.parts)
        for line in file.read_text(encoding="utf-8").splitlines()
        if re.search(former, line)
    ]
    assert not found, f"now {present}: {found}"
