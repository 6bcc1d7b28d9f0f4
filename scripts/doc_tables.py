"""The tables of figures in README.md and docs/: one entry each, with its files, columns and order.

A page has `<!-- table: NAME -->` and `<!-- end -->` where a table goes; `python scripts/render_tables.py` fills it in.
runs/reproduce.sh has the commands of the files. In templates, a name is a figure of a row, and its format.
"""

from __future__ import annotations

from typing import Final

from score_tables import (
    DRAWN_ANEW,
    HELD_OUT,
    MORE,
    OPENED_LAST,
    README_SUITES,
    all_runs,
    audits,
    by_suite,
    categories,
    false_alarms,
    families,
    from_data,
    gazebo_scores,
    in_places,
    latencies,
    leaderboard_table,
    lessons,
    other_conditions,
    paper,
    reasoner_worth,
    runs_of,
    sitl_scores,
)
from table_kinds import Description, Line, across, lines_of, repeated, rows_of, titled

STEPS = {
    "step": "{step}",
    "who": "{who}",
    "t10 s": "{t10_s:.2f}",
    "t50 s": "{t50_s:.2f}",
    "t90 s": "{t90_s:.2f}",
    "overshoot": "{overshoot:.1%}",
    "stop m (yaw: rad)": "{stop:.2f}",
}
ENVIRONMENT = "`benchmarks/environment.py`"
RENDERING = ("{frames_per_s_1:,.0f} and {frames_per_s_2:,.0f} frames/s", "{ratio:.2f}", "`benchmarks/rendering.py`")
START_UP = ("{ms:.0f} ms", "{ratio:.2g} x python alone", "`benchmarks/start_up.py`")
SYSTEMS = {"system": "{system}", "Python": "{python}", "what": "{what}", "result": "{result}"}
PAST_OBSTACLES = (
    "{passed} of {n}",
    "{choice_accuracy:.0%}",
    "{collisions}, {touched}",
    "{collisions_per_100_m:.1f}",
    "{smallest_passed_m:.2f} m",
    "{spl:.2f}",
)
PILOTS_AND_BASELINES = (
    *("r1", "small", "colour_seeker_oracle", "colour_seeker"),
    *("cloned", "act", "race", "oracle", "hover"),
)

FLOWN: Final = frozenset(
    (
        *("audit_r1", "audit_race", "audit_small", "clutter", "first_score"),
        *("gates", "harnesses", "inference", "live_page", "losses", "missions", "moving"),
        *("ratios", "real_time", "reasoner_alone", "say", "serving", "swaying", "teaching", "teaching_20"),
    )
)
"""Measurements that depend on the packaged weights: pages say where those have changed since."""

TABLES: Final[dict[str, Description]] = {
    # README.md
    "headline": by_suite(("r1", "small", "race"), README_SUITES),
    # docs/audit.md
    "leaderboard": leaderboard_table,
    # docs/own_policy.md
    "cloned": by_suite(
        ("cloned", "act", "learnt", "race", "small"), ("open-v1:test", "open-v2:layouts", "open-v1:unseen")
    ),
    # docs/scores.md
    "paper": paper,
    "held-out": by_suite(PILOTS_AND_BASELINES, HELD_OUT),
    "opened-last": by_suite(("r1", "small"), OPENED_LAST),
    "in-distribution": by_suite(PILOTS_AND_BASELINES, (*DRAWN_ANEW, *MORE, "open-v1:race")),
    "seeds": by_suite(("small", "small_seed_1", "small_seed_2", "small_seed_3"), ("open-v1:test", "open-v1:unseen")),
    "conditions": other_conditions("r1", "small", "oracle"),
    "scores": all_runs,
    "speed": lines_of(
        ("what", "measured", "ratio", "printed by"),
        Line(
            "environment",
            {"what": "vector of 16"},
            (
                "vector environment, 16 worlds, 256x256 frames, full dynamics",
                "{steps_per_s:,.0f} control steps/s",
                "{ratio:.2g} x gym-pybullet-drones ([how](gymnasium.md#speed))",
                ENVIRONMENT,
            ),
        ),
        Line(
            "environment",
            {"what": "one world"},
            ("one world", "{steps_per_s:,.0f} control steps/s", "{ratio:.2g} x the same", ENVIRONMENT),
        ),
        Line(
            "environment",
            {"what": "task change"},
            ("task change, reset to first frame", "{ms:.1f} ms", "", ENVIRONMENT),
        ),
        Line("rendering", {"appearance": "plain"}, ("rendering alone, 16 worlds, 1 and 2 threads", *RENDERING)),
        Line(
            "rendering", {"appearance": "varied"}, ("rendering alone, varied appearance, 1 and 2 threads", *RENDERING)
        ),
        Line(
            "dynamics",
            {"worlds": 16},
            (
                "flight of 16 worlds alone, one control step",
                "{step_ms:.1f} ms",
                "{real_time:.0f} x real time, all worlds",
                "`benchmarks/dynamics.py`",
            ),
        ),
        Line("start_up", {"what": "import cognitivedrone"}, ("`{what}`; loads no torch", *START_UP)),
        Line("start_up", {"what": "import cognitivedrone.envs.gym"}, ("`{what}`", *START_UP)),
    ),
    "ratios": rows_of(
        "ratios",
        {
            "what": "{what}",
            "beside": "`{beside}`",
            "ratio": "{ratio:.2f}",
            "now": "{now_s:.0f} s",
            "then": "{then_s:.0f} s",
        },
    ),
    # docs/small.md
    "small-categories": categories("small", "CognitiveDrone"),
    "small-families": families("small", ("open-v1:test", "open-v1:unseen", "open-v2:words", "open-v1:hard")),
    "small-elsewhere": runs_of(
        "small",
        ["`cognitivedrone bench` with"],
        {
            "`--appearance varied`": ("open-v1:test", {"appearance": "varied"}),
            "`--wind 0.5`": ("open-v1:test", {"wind_m_s": 0.5}),
            "`--suite open-v1:track`: 20 tracks of 5 stages": ("open-v1:track", {}),
        },
    ),
    "places": in_places,
    "small-speed": lines_of(
        ("of", "median, ms", "mean, ms", "99th percentile, ms", "loading", "memory of the process", "file"),
        Line(
            "inference",
            {},
            (
                "a decision of the policy",
                "{median_ms:.1f}",
                "{mean_ms:.1f}",
                "{p99_ms:.1f}",
                "{loading_s:.2f} s",
                "{memory_mb:.0f} MB",
                "{file_mb:.1f} MB",
            ),
        ),
        Line(
            "inference",
            {},
            (
                "an answer of the reasoner beside it",
                "{answer_median_ms:.1f}",
                "{answer_mean_ms:.1f}",
                "{answer_p99_ms:.1f}",
                "",
                "",
                "",
            ),
        ),
    ),
    "reading": rows_of(
        "reading",
        {
            "drawings by": "{set}",
            "things": "{things}",
            "top 1 of all": "{top_1:.1%}",
            "choice of three": "{choice:.1%}",
            "taken for unknown": "{unknown:.1%}",
            "calibration error": "{calibration_error:.1%}",
        },
    ),
    # docs/paper.md
    "published-tasks": rows_of(
        "published_tasks", {"pilot": "{who}", "passes, per cent": "{rate:.1f}", "flown in": "{where}"}
    ),
    "published-frames": rows_of(
        "published_frames",
        {"reasoner": "{who}"}
        | {
            name: f"{{{name}}}"
            for name in ("Celebrities", "Patterns", "letters", "digits", "animals", "logos", "food", "math")
        }
        | {"all of 218": "**{total}**"},
    ),
    "race": runs_of(
        "race",
        ["`cognitivedrone bench --policy race` with"],
        {
            "`--suite open-v1:race`: 20 tracks of 5 single gates": ("open-v1:race", {}),
            "`--suite open-v1:test`: a sentence and three gates": ("open-v1:test", {}),
        },
    ),
    # docs/r1.md
    "r1": reasoner_worth,
    "say": rows_of(
        "say", {"kind": "{kind}", "as a sensible drone": "{right} of {of}", "declined or refused": "{declined}"}
    ),
    "losses": rows_of(
        "losses",
        {
            "suite": "`{suite}`",
            "tasks": "{tasks}",
            "the reasoner": "{joint:.1%}",
            "its eyes alone": "{eyes:.1%} of {of_eyes}",
            "its words alone": "{words:.1%} of {of_words}",
        },
    ),
    "false-alarms": false_alarms,
    "r1-families": families("r1", ("open-v1:test", "open-v1:unseen", "open-v2:words", "open-v1:hard")),
    "r1-latency": latencies,
    "real-time": lines_of(
        (
            "deadlines missed by more than 10 ms",
            "policy: median, p99",
            "reasoner: median, p99",
            "answers/s",
            "the loop alone",
        ),
        Line(
            "real_time",
            {},
            (
                "{missed} of {deadlines}",
                "{policy_ms:.1f} ms",
                "{reasoner_ms:.1f} ms",
                "{answers_per_s:.1f}",
                "{loop_us:.0f} us a tick",
            ),
        ),
    ),
    # docs/audit.md, docs/training.md
    "audits": audits,
    "lesson-times": lines_of(
        ("pictures", "training, min"),
        Line("teaching_20", {}, ("{pictures}", "{lesson_min:.1f}")),
        Line("teaching", {}, ("{pictures}, with sentences of tasks", "{lesson_min:.1f}")),
    ),
    "lessons": lessons,
    # docs/training.md
    "from-data": from_data,
    "training-times": rows_of(
        "training_times",
        {
            "run": "{run}",
            "recipe": "`{recipe}`",
            "steps": "{steps:,}",
            "steps/s": "{steps_per_s:.1f}",
            "time, min": "{minutes:.0f}",
            "remarks": "{remarks}",
        },
    ),
    # docs/vehicles.md, docs/gymnasium.md
    "steps": rows_of("step_responses", {**STEPS, "max tilt deg": "{max_tilt_deg:.1f}"}),
    "dynamics": rows_of(
        "dynamics",
        {
            "worlds": "{worlds}",
            "threads": "{threads}",
            "control step ms": "{step_ms:.2f}",
            "times real time, all worlds": "{real_time:.0f}",
            "over bare physics": "{over_physics:.1f}",
        },
    ),
    "environment": rows_of(
        "environment",
        {"what": "{what}", "control steps/s": "{steps_per_s:,.0f}", "date": "{date}", "ratio": "{ratio:.2g}"},
        having="steps_per_s",
    ),
    "state-speed": rows_of(
        "state_speed",
        {
            "environment": "{what}",
            "worlds": "{worlds}",
            "control steps/s": "{steps_per_s:,.0f}",
            "ratio": "{ratio:.2g}",
        },
    ),
    "ppo": rows_of("ppo", {"steps": "{steps:,}", "minutes": "{minutes:g}", "of": "{flown}", "passed": "{passed:.0%}"}),
    # docs/suites.md
    "evaluations": rows_of(
        "evaluations",
        {"evaluation": "{evaluation}", "day": "{date}", "pilot": "{pilot}"}
        | {f"`{name}`": f"{{{name}:.0%}}" for name in ("words", "pictures", "unseen", "layouts", "absent")},
    ),
    # docs/data.md
    "data-reading": rows_of(
        "data_reading",
        {
            "readers": "{readers}",
            "frames/s": "{frames_per_s:,.0f}",
            "over decoding alone, in one thread": "{over_decoding:.2f}",
            "processor time a frame": "{cpu_ms:.2f} ms",
            "a frame's size": "{kb_per_frame:.1f} KB",
            "flights": "{episodes:,}",
        },
    ),
    "collect-paper": lines_of(
        ("`cognitivedrone collect --out paper-set --workers 2`", ""),
        *(
            Line("collect_paper", {}, cells)
            for cells in (
                ("episodes, control steps", "{episodes:,}, {steps:,} ({steps_per_episode:.1f} per episode)"),
                ("wall time", "{wall_s:.0f} s, {episodes_per_s:.1f} episodes/s"),
                ("memory of all processes together", "{memory_mb:.0f} MB"),
                ("flights that did not pass", "{not_passed} of {episodes:,}"),
                (
                    "size on disk, PNG frames",
                    "{size_gb:.2f} GB: {kb_per_episode:.0f} KB per episode, {kb_per_step:.1f} KB per step",
                ),
                ("every fiftieth episode replayed", "{replayed_equal} of {replayed} to the last bit"),
            )
        ),
    ),
    "collection": rows_of(
        "collection",
        {
            "workers": "{workers}",
            "episodes/s": "{episodes_per_s:.1f}",
            "8,062 episodes, min": "{minutes_8062:.1f}",
            "memory MB": "{memory_mb:.0f}",
            "flights that passed": "{passed:.1%}",
        },
    ),
    "faults": rows_of(
        "faults",
        {
            "fault": "{fault}",
            "tried": "{tried}",
            "found": "{found} of {tried}",
            "same end state": "{mended} of {tried}",
            "stray files": "{stray}",
        },
    ),
    "exports": rows_of(
        "exports",
        {
            "command": "`{command}`",
            "time": "{time_s:.0f} s",
            "size": "{size_gb:.1f} GB",
            "read back": "{read_episodes:,} episodes, {read_steps:,} steps",
        },
    ),
    # docs/install.md, docs/gymnasium.md, docs/own_policy.md
    "systems": rows_of("systems", SYSTEMS | {"wall time": "{wall_s:.0f} s"}),
    "systems-earlier": rows_of("systems_earlier", SYSTEMS),
    "systems-arm64": rows_of("systems_arm64", SYSTEMS | {"wall time, emulated": "{wall_s:.0f} s"}),
    "first-score": rows_of(
        "first_score",
        {
            "Python": "{python}",
            "clone": "{clone_s:.1f}",
            "install": "{install_s:.1f}",
            "bench": "{bench_s:.1f}",
            "total": "{total_s:.1f}",
        },
    ),
    "harnesses": rows_of(
        "harnesses",
        {
            "what was run": "{what}",
            "versions": "{versions}",
            "flights": "{flights}",
            "equal": "{equal}",
            "passed": "{passed}",
            "remarks": "{remarks}",
        },
    ),
    "serving": rows_of(
        "serving",
        {
            "policy": "`{policy}`",
            "clients at 10 Hz": "{clients}",
            "round trip over the policy's own time: median, p99": "{beyond_ms:.1f} ms",
            "of that in the server, median": "{server_ms:.2f} ms",
            "the server's processor time a request": "{cpu_ms:.2f} ms",
        },
        having="policy",
    ),
    "serving-sessions": rows_of(
        "serving",
        {"`small`, 16 sessions": "{way}", "frames/s": "{frames_per_s:.0f}", "ratio": "{ratio:.2f}"},
        having="way",
    ),
    "serving-load": rows_of(
        "serving_load",
        {
            "clients as fast as they can": "{clients}",
            "time": "{minutes:.0f} min",
            "requests": "{requests:,}",
            "requests/s": "{per_s:.0f}",
            "memory, and growth after the first tenth": "{memory_mb:.0f} MB, {grown:+.1%}",
        },
    ),
    # docs/suites.md
    "missions": rows_of(
        "missions",
        {
            "pilot": "{pilot}",
            "generated missions, whole": "{generated_whole} of {generated_missions}",
            "their sub-goals": "{generated_done} of {generated_sub_goals}",
            "typed missions, whole": "{typed_whole} of {typed_missions}",
            "their sub-goals ": "{typed_done} of {typed_sub_goals}",
            "went wrong: mind, flying": "{mind}, {flying}",
            "collisions per 100 m": "{collisions_per_100_m:.1f}",
        },
    ),
    **{
        suite: lines_of(
            (
                "pilot",
                "passed",
                "right gate",
                "collisions, with obstacles",
                "a 100 m",
                "smallest clearance, passed",
                "SPL",
            ),
            *(
                Line(suite, {"pilot": name}, (f"`{name}`", *PAST_OBSTACLES))
                for name in ("oracle", "small_gold", "small", "r1")
            ),
        )
        for suite in ("clutter", "moving", "gates")
    },
    "swaying": rows_of(
        "swaying",
        {
            "pilot": "`{pilot}`",
            "passed": "{passed} of {n}",
            "right gate": "{choice_accuracy:.0%}",
            "of those, through it": "{pass_given_choice:.0%}",
            "otherwise": "{ended}",
        },
    ),
    # docs/play.md
    "live-page": rows_of(
        "live_page",
        {
            "flights": "{what}",
            "deadlines missed": "{late_steps} of {steps}",
            "frames of the chase view": "{chase_frames_per_s:.1f} /s",
            "first frame, after the command": "{first_frame_s:.1f} s",
        },
    ),
    "mission-end": rows_of(
        "mission_end",
        {
            "`--suite`": "`{suite}`",
            "pilot": "`{pilot}`",
            "gates passed": "{passed} in {flights} flights",
            "noticed within 1.5 s": "{noticed}",
            "after: median, longest": "{median_s:.2f} s, {longest_s:.2f} s",
            "noticed where no gate was passed": "{wrong}",
        },
    ),
    "sitl-faults": rows_of(
        "sitl_faults",
        {
            "case": "{name}",
            "stopped": "{stopped_s:.1f}",
            "mode changed": "{mode_s:.1f}",
            "motors stopped": "{down_s:.1f}",
            "how it ended": "{end}",
        },
    ),
    "sitl-core": repeated({"sitl_core_46": "4.6.3", "sitl_core_47": "4.7-dev"}),
    # docs/vehicles.md
    "sitl-scores": sitl_scores,
    "sitl-steps": rows_of("sitl_step_responses", STEPS),
    "sitl-speed": rows_of("sitl_speed", {"": "{what}", "times real time": "{real_time:.1f}"}),
    # docs/gazebo.md
    "gazebo-scores": gazebo_scores,
    # docs/openvla.md
    "openvla-memory": across(
        "openvla_memory", "", "`{quant}`", {"memory, computed from the tensors' shapes": "{memory_gb:.1f} GB"}
    ),
    "gpu-step": titled("openvla_gpu", "One control step"),
    "gpu-lora": titled("openvla_gpu", "LoRA"),
    "lora-memory": across(
        "openvla_memory",
        "`--micro-batch`",
        "{micro_batch}",
        {"activations kept": "{kept_gb:.1f} GB", "activations recomputed": "{recomputed_gb:.1f} GB"},
    ),
}
