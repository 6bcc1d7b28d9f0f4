"""The paper's figure: three systems by categories and their mean, with 95 % intervals, and the published scores."""

from __future__ import annotations

from collections.abc import Mapping

from cognitivedrone.benchmark.scores.published import PUBLISHED
from cognitivedrone.benchmark.scores.scoring import Interval, Summary
from cognitivedrone.types import CATEGORIES

WIDTH, HEIGHT, LEFT, TOP, BOTTOM, LEGEND = 720, 300, 64, 40, 40, 50
ROLES = {
    "RaceVLA": "ours: race",
    "CognitiveDrone": "ours: small",
    "CognitiveDrone-R1": "ours: small with reasoner (R1)",
}
"""Our pilots in the roles of the paper's systems."""
COLORS = {"CognitiveDrone-R1": "#3b5bdb", "CognitiveDrone": "#7f96ec", "RaceVLA": "#b9bfcd"}
PUBLISHED_COLOR = "#c2306f"

Bars = list[tuple[float, Interval]]
"""Of the categories and their mean, per unit."""


def figure(suites: Mapping[str, Mapping[str, Summary]]) -> str:
    """SVG: a chart for each suite, from the summaries of the paper's systems by their names."""
    height = HEIGHT * len(suites) + LEGEND
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif"'
        f' font-size="12"><rect width="{WIDTH}" height="{height}" fill="white"/>'
    ]
    for number, (suite, summaries) in enumerate(suites.items()):
        bars = {name: bars_of(summary) for name, summary in summaries.items()}
        parts += [f'<g transform="translate(0 {HEIGHT * number})">', *chart(suite, bars), "</g>"]
    for number, (name, role) in enumerate(ROLES.items()):
        x = LEFT + 120 * number
        parts.append(f'<rect x="{x}" y="{height - 42}" width="12" height="12" fill="{COLORS[name]}"/>')
        parts.append(f'<text x="{x + 18}" y="{height - 32}">{role}</text>')
    line = "red line: the paper's system in this role, on its own simulator and tasks"
    parts.append(f'<text x="{LEFT}" y="{height - 12}" fill="{PUBLISHED_COLOR}">{line}</text>')
    parts.append(f'<text x="{WIDTH - 4}" y="{height - 12}" text-anchor="end">black line: 95 % interval</text>')
    return "\n".join([*parts, "</svg>\n"])


def bars_of(summary: Summary) -> Bars:
    """Rates of the categories, and their mean; 0 for a category that was not flown."""
    scores = [summary.categories.get(category) for category in CATEGORIES]
    every = [(score.rate or 0.0, score.ci95 or (0.0, 1.0)) if score else (0.0, (0.0, 1.0)) for score in scores]
    mean = summary.mean_of_categories
    return [*every, (mean.rate or 0.0, mean.ci95 or (0.0, 1.0))]


def chart(title: str, bars: Mapping[str, Bars]) -> list[str]:
    """Bars with intervals, and a line across each for the published score."""
    names = [*(category.replace("_", " ") for category in CATEGORIES), "mean"]
    group = (WIDTH - LEFT) / len(names)
    middle = (y_of(0) + y_of(1)) / 2
    parts = [
        f'<text x="{LEFT}" y="22" font-weight="bold">{title}</text>',
        f'<text transform="translate(14 {middle:.0f}) rotate(-90)" text-anchor="middle">success rate</text>',
    ]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH}" y1="{y_of(share):.1f}" y2="{y_of(share):.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y_of(share) + 4:.1f}" text-anchor="end">{share:.0%}</text>')
    for place, name in enumerate(names):
        left = LEFT + place * group
        parts.append(f'<text x="{left + group / 2:.1f}" y="{HEIGHT - 20}" text-anchor="middle">{name}</text>')
        for number, published in enumerate(reversed(PUBLISHED)):
            rate, (low, high) = bars[published.name][place]
            theirs = published.overall if place == len(CATEGORIES) else published.categories[CATEGORIES[place]]
            x, wide = left + group * (0.12 + 0.26 * number), group * 0.22
            middle = x + wide / 2
            parts += [
                f'<rect x="{x:.1f}" width="{wide:.1f}" y="{y_of(rate):.1f}" height="{y_of(0) - y_of(rate):.1f}"'
                f' fill="{COLORS[published.name]}"/>',
                f'<line x1="{middle:.1f}" x2="{middle:.1f}" y1="{y_of(low):.1f}" y2="{y_of(high):.1f}" stroke="#222"/>',
                f'<line x1="{x:.1f}" x2="{x + wide:.1f}" y1="{y_of(theirs):.1f}" y2="{y_of(theirs):.1f}"'
                f' stroke="{PUBLISHED_COLOR}" stroke-width="2"/>',
            ]
    return parts


def y_of(share: float) -> float:
    """Height of a rate in a chart."""
    return HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)
