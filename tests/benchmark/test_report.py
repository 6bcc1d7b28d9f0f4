import html
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import av
import benchmark_fakes
import numpy as np
import pytest
from benchmark_fakes import FakeRunner, text_of

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports import report
from cognitivedrone.benchmark.reports.clips import choose_clips, make_clip
from cognitivedrone.benchmark.reports.drawing import episode_map, overlay, stage_flights
from cognitivedrone.benchmark.reports.report import render_report
from cognitivedrone.benchmark.reports.tables import results_table, words
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.benchmark.runs.runner import run
from cognitivedrone.benchmark.scores.scoring import OUTCOMES
from cognitivedrone.film.movie import encode_mp4
from cognitivedrone.tasks.suites import suite_of
from cognitivedrone.types import GatePlace
from cognitivedrone.world import geometry

RUNNER = benchmark_fakes.FakeRunner


class Page(HTMLParser):
    """Checks nesting, and collects what a browser would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href", "poster", "data") and value]
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """As `config`, for what all tests share."""
    out = tmp_path_factory.mktemp("report") / "run"
    return Plan.of(policy="fake", suite="open-v1:train", episodes=20, workers=0, out=out, clips=0)


@pytest.fixture(scope="module")
def flown(plan):
    runner = FakeRunner(resolve(plan))
    return [runner.fly(episode, film=True) for episode in range(20)]


@pytest.fixture(scope="module")
def results(plan):
    return run(plan, progress=False, runner=RUNNER)


@pytest.fixture(scope="module")
def traces(flown):
    return [one.trace for one in flown]


@pytest.fixture(scope="module")
def clips(plan, flown):
    """Three."""
    tracks = suite_of(plan.scenario, plan.episodes).tracks
    return [make_clip(one, tracks[one.result.episode], one.result) for one in flown[:3]]


def test_the_page_is_whole_loads_nothing_and_is_the_same_each_time(results, traces, clips):
    text = render_report(results, traces, clips)
    assert text == render_report(results, traces, clips)
    page = Page(text)
    assert all(source.startswith("data:") for source in page.sources)
    assert "http" not in re.sub(r"data:[\w/]+;base64,[\w+/=]+", "", text)
    assert page.tags.count("video") == 3
    assert "script" not in page.tags
    assert f"{100 * results.summary().overall.rate:.1f} %" in text
    assert results.run.suite.digest in text


def test_confusions_are_shown_where_something_failed(results, traces, clips):
    summary = results.summary()
    text = render_report(results, traces, clips)
    table = text_of(results_table(results), 100)
    for category, score in summary.categories.items():
        counts = [str(count) for count in score.outcomes.values() if count]
        row = next(line for line in table.partition("endings")[2].splitlines() if words(category) in line)
        assert row.replace(words(category), "").split() == counts
    for family, score in summary.families.items():
        failed = [f"{n} {words(o)}".replace(" ", "\xa0") for o, n in score.outcomes.items() if n and o != "passed"]
        shown = re.search(rf'<tr class="family"><td>{words(family)}</td>(.*?)</tr>', text, flags=re.DOTALL)
        assert (", ".join(failed) in shown.group(1)) if failed else shown is None
    for gate, row in enumerate(summary.choices, start=1):
        line = next(line for line in table.splitlines() if line.startswith(f"gate {gate}"))
        assert line.split()[2:] == [str(count) for count in row]
        row_shown = re.search(rf"<tr><th>right: gate {gate}</th>(.*?)</tr>", text).group(1)
        assert re.findall(r">(\d+)<", row_shown) == [str(count) for count in row if count]


def test_the_outcomes_that_are_shown_are_reported(results, traces, clips):
    text = html.unescape(render_report(results, traces, clips))
    shown = re.search(r'<p class="soft outcomes">(.*?)</p>', text).group(1)
    seen = {outcome for outcome, count in results.summary().overall.outcomes.items() if count}
    assert set(re.findall(r"<strong>([\w ]+)</strong>: \w", shown)) == {words(outcome) for outcome in seen - {"passed"}}
    for outcome in seen:
        assert f'title="{report.MEANINGS[outcome]}"' in text
    assert set(report.MEANINGS) == set(OUTCOMES)
    assert 'class="soft outcomes"' not in render_report(without_failures(results), traces, clips)


def without_failures(results):
    passed = tuple(
        replace(e, stages=tuple(replace(s, outcome="passed", chosen=s.target) for s in e.stages))
        for e in results.episodes
    )
    return replace(results, episodes=passed)


def table_rows(text):
    """Cells of the table of scores, without markup, row by row."""
    table = text.partition("<h2>Scores</h2>")[2].partition("</table>")[0]
    rows = re.findall(r"<tr.*?</tr>", table, flags=re.DOTALL)
    return [[re.sub("<.*?>", "  ", cell).strip() for cell in re.findall(r"<td.*?</td>", row)] for row in rows[1:]]


def test_where_nothing_failed_a_category_is_one_row_without_a_bar(results, traces, clips):
    results = without_failures(results)
    text = render_report(results, traces, clips)
    rows = table_rows(text)
    assert len(rows) == len(results.summary().categories) == 3
    assert all("100.0 %" in row for row in rows)
    for family in results.summary().families:
        assert sum(words(family) in re.split(r", |  +", row[0]) for row in rows) == 1
    table = text.partition("<h2>Scores</h2>")[2].partition("</table>")[0]
    assert "<svg" not in table
    assert "What went wrong" not in text
    assert "endings" not in text_of(results_table(results))


def test_clips_stand_below_the_scores_failures_first_and_loop(config):
    run(config.changed(clips=12), progress=False, runner=RUNNER)
    text = (config.out / "report.html").read_text()
    assert text.index("<table") < text.index("<h2>Clips") < text.index("<video") < text.index("<h3>Passed")
    assert text.index("<h3>Passed") < text.index("What went wrong")
    assert text.index("<h3>Not passed") < text.index("<h3>Passed")
    for tag in re.findall(r"<video [^>]*>", text):
        assert {"loop", "muted", "autoplay", "playsinline"} <= set(tag.split())


def test_the_instruction_of_every_failure_is_reported(plan, results):
    listed = (plan.out / "report.html").read_text().partition("Every stage not passed")[2].partition("</table>")[0]
    tracks = suite_of(plan.scenario, plan.episodes).tracks
    failed = [e.episode for e in results.episodes if e.stages[0].outcome != "passed"]
    assert failed
    for episode in failed:
        assert tracks[episode][0].instruction in html.unescape(listed)


def test_the_paper_stands_beside_shipped_suites_alone(results, traces, clips):
    assert "77.2 %" not in render_report(results, traces, clips)
    results = replace(results, run=replace(results.run, suite=replace(results.run.suite, name="open-v1:test")))
    text = render_report(results, traces, clips).partition("Compared with the paper")[2]
    row = next(row for row in re.findall(r"<tr>.*?</tr>", text) if "human recognition" in row)
    assert re.findall(r"\d+\.\d %", row)[1:] == ["76.8 %", "45.2 %", "23.1 %"]
    own = replace(results, run=replace(results.run, suite=replace(results.run.suite, name="my_tasks.json")))
    assert "77.2 %" not in render_report(own, traces, clips)


def test_what_a_rerun_needs_is_reported(results, traces, clips):
    facts = {
        "command": "PYTHONPATH='my code' cognitivedrone bench --policy mine:Mine",
        "commit": "0123abcd-dirty",
        "policy_file": "my code/mine.py",
    }
    options = {**results.run.options, "policy_code": "feed" * 16}
    results = replace(results, run=replace(results.run, options=options))
    text = html.unescape(render_report(replace(results, platform={**results.platform, **facts}), traces, clips))
    for part in (facts["command"], "0123abcd</code> <strong>with uncommitted changes", "my code/mine.py", "feed" * 16):
        assert part in text
    old = {key: value for key, value in results.platform.items() if key != "commit"}
    assert "not run from a git checkout" in render_report(replace(results, platform=old), traces, clips)


def test_every_text_of_a_task_or_a_user_is_escaped(results, traces, clips):
    bad = "<script>alert('x')</script>"
    stage = replace(clips[0].result.stages[0], directive=bad, task_id=bad, family=bad)
    task = replace(clips[0].track[0], instruction=bad, options=(bad, bad, bad), family=bad)
    clip = replace(clips[0], track=(task,), result=replace(clips[0].result, stages=(stage,)))
    first = replace(results.episodes[0], stages=(stage,), message=bad)
    results = replace(
        results,
        run=replace(results.run, policy=bad, reasoner=bad, suite=replace(results.run.suite, name=bad)),
        renderer=bad,
        platform=dict.fromkeys(results.platform, bad),
        episodes=(first, *results.episodes[1:]),
    )
    text = render_report(results, traces, [clip])
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    Page(text)


def test_a_run_of_nothing_but_invalid_stages_has_a_page(results, traces, clips):
    episodes = tuple(
        replace(e, stages=tuple(replace(s, outcome="invalid", path_m=float("nan")) for s in e.stages))
        for e in results.episodes
    )
    traces = [replace(trace, path=np.full_like(trace.path, np.nan)) for trace in traces]
    text = render_report(replace(results, episodes=episodes), traces, [])
    Page(text)
    assert "nan" not in re.sub(r"<style>.*?</style>", "", text, flags=re.DOTALL).lower().replace("json", "")


def test_films_that_do_not_fit_are_left_out_and_reported(results, traces, clips, monkeypatch):
    monkeypatch.setattr(report, "CLIP_BUDGET", len(clips[0].video) + len(clips[0].poster) + 1)
    text = render_report(results, traces, clips)
    assert Page(text).tags.count("video") == 1
    assert "2 more did not fit" in text


def test_a_pilot_that_flies_differently_the_second_time_is_reported(config):
    run(config.changed(clips=12), progress=False, runner=benchmark_fakes.FickleRunner)
    assert "the pilot is not deterministic" in (config.out / "report.html").read_text()
    run(config.changed(clips=12, overwrite=True), progress=False, runner=RUNNER)
    assert "the pilot is not deterministic" not in (config.out / "report.html").read_text()


def test_clips_show_failures_of_every_kind_then_passes_of_every_family(flown):
    results = [one.result for one in flown]
    chosen = choose_clips(results, 12)
    by_index = {result.episode: result.stages[0] for result in results}
    failed = [episode for episode in chosen if by_index[episode].outcome != "passed"]
    passed = [episode for episode in chosen if by_index[episode].outcome == "passed"]
    assert chosen == failed + passed
    assert len(chosen) == len(set(chosen)) <= 12
    every_ending = {stage.outcome for stage in by_index.values()} - {"passed"}
    assert {by_index[episode].outcome for episode in failed} == every_ending
    families = [by_index[episode].family for episode in passed]
    assert len(families) == len(set(families))
    assert choose_clips(list(reversed(results)), 12) == chosen
    assert choose_clips(results, 0) == []
    assert len(choose_clips(results, 1)) == 1
    failures = [replace(one, stages=(replace(one.stages[0], outcome="timeout"),)) for one in results]
    assert len(choose_clips(failures, 12)) == 12


def test_a_film_plays_as_it_was_taken():
    # In their real size: of 64x96, x264 makes other bytes about once in 200 times, by what lies in freed memory.
    frames = [np.full((256, 256, 3), (10 * k, 100, 200 - 10 * k), dtype=np.uint8) for k in range(12)]
    video = encode_mp4(frames)
    assert video == encode_mp4(frames)
    with av.open(io.BytesIO(video)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert float(stream.average_rate) == 10
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(decoded) == 12
    for before, after in zip(frames, decoded, strict=True):
        assert np.abs(before.astype(int) - after.astype(int)).mean() < 8
    assert encode_mp4([]) == b""


def test_a_map_shows_each_flight_in_the_frame_of_its_stage(config):
    config = config.changed(track=True)
    runner = FakeRunner(resolve(config))
    flown = max((runner.fly(e, film=False) for e in range(4)), key=lambda one: len(one.trace.stages))
    flights = list(stage_flights(flown.result, flown.trace))
    assert len(flights) > 1
    drawn = overlay(flights)
    assert len(drawn.paths) == len(flights)
    assert [gate.number for gate in drawn.gates] == [1, 2, 3]
    # Gate 1 is to the left, and the drone flies up the page.
    assert drawn.gates[0].x1 < drawn.gates[1].x1 < drawn.gates[2].x1
    marks = {gate.number - 1: (gate.label_x, gate.label_y) for gate in drawn.gates}
    for flight, path in zip(flights, drawn.paths, strict=True):
        assert path.end_y < -2
        if flight.result.outcome in ("passed", "wrong_gate"):
            assert (
                np.hypot(path.end_x - marks[flight.result.chosen][0], path.end_y - marks[flight.result.chosen][1]) < 1.5
            )
    whole = episode_map(flown.result, flown.trace, ["a", "b", "c"])
    assert not any(gate.name for gate in whole.gates)
    assert len(whole.gates) == 3 * len(flights)
    assert sum(gate.is_target for gate in whole.gates) == len(flights)
    x, y, width, height = (float(number) for number in whole.view_box.split())
    for path in whole.paths:
        assert x < path.end_x < x + width
        assert y < path.end_y < y + height


def test_a_map_of_one_stage_names_its_gates_and_points_along_the_flight(flown):
    one = next(one for one in flown if one.result.stages[0].outcome == "passed")
    drawn = episode_map(one.result, one.trace, ["cat", "dog", "an option of a great length"])
    assert [gate.name for gate in drawn.gates] == ["cat", "dog", ""]
    assert [gate.number - 1 for gate in drawn.gates if gate.is_target] == [one.result.stages[0].target]
    (path,) = drawn.paths
    goal = drawn.gates[one.result.stages[0].target]
    # It flew up the page, to the side of its gate.
    assert abs(path.heading) < 90
    assert goal.number == 2 or (path.heading < 0) == (goal.number == 1)


def test_a_map_shows_the_way_of_a_gate_that_moves(flown):
    one = flown[0]
    places = [
        GatePlace(float(x), float(y), 0.9, float(yaw))
        for (x, y), yaw in zip(geometry.GATE_XY, geometry.GATE_YAWS, strict=True)
    ]
    stage = replace(one.trace.stages[0], layout=(places[0], replace(places[1], sway=0.5), places[2]))
    first, second, third = episode_map(one.result, replace(one.trace, stages=(stage,))).gates
    assert first.way is third.way is None
    x1, y1, x2, y2 = second.way
    assert x1 == pytest.approx(second.x1 - 0.5, abs=0.011)
    assert x2 == pytest.approx(second.x2 + 0.5, abs=0.011)
    assert y1 == y2 == second.y1
