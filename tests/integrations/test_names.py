"""Names that must agree with what other packages read, checked without those packages."""

import ast
import inspect
import tomllib
from pathlib import Path

import cognitivedrone
from cognitivedrone.integrations.lerobot import LeRobotEnv
from cognitivedrone.plan import Scenario

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "lerobot_env_cognitivedrone"
SCENARIO = set(Scenario().values())


def class_in(file: Path, name: str) -> ast.ClassDef:
    (found,) = (node for node in ast.parse(file.read_text()).body if getattr(node, "name", None) == name)
    assert isinstance(found, ast.ClassDef)
    return found


def test_the_benchmark_of_vla_eval_takes_the_options_of_a_scenario():
    benchmark = class_in(Path(cognitivedrone.__file__).parent / "integrations" / "vla_eval.py", "CognitiveDrone")
    (init,) = (node for node in benchmark.body if isinstance(node, ast.FunctionDef) and node.name == "__init__")
    assert {argument.arg for argument in init.args.args} == {"self", "time_limit_s", "send_state"} | SCENARIO


def test_the_plug_in_of_lerobot_takes_the_options_of_the_environment():
    config = class_in(PLUGIN / "src" / PLUGIN.name / "__init__.py", "CognitiveDroneConfig")
    own = {
        node.target.id for node in config.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    taken = set(inspect.signature(LeRobotEnv).parameters) - {"render_mode", "options"}
    assert own - {"fps", "features", "features_map"} == taken | SCENARIO


def test_lerobot_finds_the_plug_in_by_its_name():
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())["project"]
    assert project["name"] == PLUGIN.name
    assert project["name"].startswith("lerobot_env_"), "the prefix that register_third_party_plugins looks for"
    assert (PLUGIN / "src" / project["name"] / "__init__.py").is_file()
