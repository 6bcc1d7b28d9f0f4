"""Success against latency: flies the same suite with increasing inference latency."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Final

from cognitivedrone.benchmark.config import Plan, SweepPlan
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.results import Results, write_whole

PLOT_FILE: Final = "sweep.svg"
_WIDTH, _HEIGHT = 640, 360
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 20, 40, 50


Points = Sequence[tuple[float, Results]]
"""Latencies, ms, with their runs."""


def sweep(config: SweepPlan, *, progress: bool = True) -> Points:
    """Fly the suite at every latency, and update the plot after each; finished episodes are not flown again."""
    points: list[tuple[float, Results]] = []
    for ms in sorted(set(config.ms)):
        points.append((ms, run(plan_of(config, ms), progress=progress)))
        write_whole(config.out / PLOT_FILE, plot(points, config))
    return points


def plan_of(config: SweepPlan, ms: float) -> Plan:
    """The run at one latency."""
    times = {"policy": config.other_ms, "reasoner": config.other_ms, config.part: ms}
    return Plan(
        scenario=config.scenario,
        pilot=config.pilot,
        vehicle=config.vehicle,
        workers=config.workers,
        episodes=config.episodes,
        latency=",".join(f"{part}={value:g}ms" for part, value in times.items()),
        out=config.out / f"{config.part}-{ms:g}ms",
        resume=True,
        clips=0,
    )


def plot(points: Points, config: SweepPlan) -> str:
    """An SVG of success rate with 95 % interval, and choice accuracy, against latency."""
    longest = max(ms for ms, _ in points) or 1.0
    scores = [results.summary().overall for _, results in points]
    xs = [_LEFT + ms / longest * (_WIDTH - _LEFT - _RIGHT) for ms, _ in points]
    pilot = config.pilot.shown
    title = escape(f"{config.scenario.title}: {pilot.policy}, reasoner {pilot.reasoner}")
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
        'font-size="12"><rect width="100%" height="100%" fill="white"/>',
        f'<text x="{_LEFT}" y="20" font-size="14">{title}</text>',
    ]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = _y(share)
        parts.append(f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{_LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{share:.0%}</text>')
    for x, (ms, _) in zip(xs, points, strict=True):
        parts.append(f'<text x="{x:.1f}" y="{_HEIGHT - 30}" text-anchor="middle">{ms:g}</text>')
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    below = f"latency of the {config.part}, ms; vertical lines: 95 % intervals"
    parts.append(f'<text x="{middle}" y="{_HEIGHT - 10}" text-anchor="middle">{below}</text>')
    for x, score in zip(xs, scores, strict=True):
        if score.ci95 is not None:
            low, high = (_y(limit) for limit in score.ci95)
            parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{low:.1f}" y2="{high:.1f}" stroke="#1f77b4"/>')
    success = [score.rate if score.rate is not None else math.nan for score in scores]
    choice = [score.choice_accuracy if score.choice_accuracy is not None else math.nan for score in scores]
    for name, color, values, at in (
        ("success rate", "#1f77b4", success, 0),
        ("choice accuracy", "#ff7f0e", choice, 90),
    ):
        known = [(x, _y(value)) for x, value in zip(xs, values, strict=True) if math.isfinite(value)]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in known)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="2"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{color}"/>' for x, y in known]
        parts.append(f'<text x="{_WIDTH - 200 + at}" y="20" fill="{color}">{name}</text>')
    return "\n".join([*parts, "</svg>\n"])


def _y(share: float) -> float:
    return _HEIGHT - _BOTTOM - share * (_HEIGHT - _TOP - _BOTTOM)
