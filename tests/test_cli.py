"""The command in this process: what it passes on, and what it prints."""

from __future__ import annotations

import hashlib
import json

import pytest

from cognitivedrone.cli import main


def bench(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    main(["bench", "--suite", "open-v1:smoke", "--workers", "1", "--clips", "0", *map(str, arguments)])
    return capsys.readouterr().out


def mistake(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    with pytest.raises(SystemExit) as stop:
        main(["bench", *map(str, arguments)])
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("cognitivedrone: ")
    assert said.count("\n") == 1
    return said


@pytest.mark.filterwarnings("ignore:the small model has never seen:UserWarning")
def test_a_model_file_is_flown_in_wind_and_told_of(capsys, tmp_path, tiny_model_file):
    arguments = ("--policy", f"small:{tiny_model_file}", "--episodes", 2, "--out", tmp_path)
    printed = bench(capsys, *arguments, "--wind", 1.5)
    assert "endings" in printed
    assert "gates flown at" in printed
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["options"]["wind_m_s"] == 1.5
    assert results["options"]["model"] == hashlib.sha256(tiny_model_file.read_bytes()).hexdigest()
    assert "--wind 1.5" in results["platform"]["command"]
    report = (tmp_path / "report.html").read_text()
    assert "wind 1.5 m/s" in report
    assert results["options"]["model"] in report
    assert "options.wind_m_s is 1.5 there and 0.0 here" in mistake(
        capsys, "--suite", "open-v1:smoke", *arguments, "--resume"
    )


@pytest.mark.filterwarnings("ignore:the small model has never seen:UserWarning")
def test_wind_is_felt(capsys, tmp_path, tiny_model_file):
    paths = []
    for wind in (0, 2):
        bench(
            capsys,
            *("--policy", f"small:{tiny_model_file}", "--episodes", 1),
            *("--wind", wind, "--out", tmp_path / str(wind)),
        )
        results = json.loads((tmp_path / str(wind) / "results.json").read_text())
        paths.append(results["episodes"][0]["stages"][0]["path_m"])
    assert paths[0] != paths[1]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--wind", -1), "--wind is -1.0; it is a speed in m/s"),
        (("--wind", "nan"), "--wind is nan"),
        (("--policy", "small:no/such/model.onnx"), "there is no model file no/such/model.onnx"),
        (("--policy", "small:pyproject.toml"), "not an ONNX file"),
        (("--policy", "small:"), "ends at its colon"),
        (("--policy", "oracle:x"), "'oracle' takes no argument"),
    ],
)
def test_a_mistake_is_said_in_one_sentence(capsys, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'not a model'\n")
    assert says in mistake(capsys, *arguments, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_models_are_listed(capsys):
    main(["list"])
    assert "small, race" in capsys.readouterr().out
