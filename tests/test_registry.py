"""How plug-ins and their arguments are written, for all families alike."""

import re
from pathlib import Path
from typing import Literal

import pytest

from cognitivedrone import registry
from cognitivedrone.errors import PolicyError
from cognitivedrone.interfaces import Policy
from cognitivedrone.policies import POLICIES, SELF_CONTAINED, make_policy, policy_files
from cognitivedrone.reasoners import REASONERS, make_reasoner, reasoner_files
from cognitivedrone.reasoners import SELF_CONTAINED as REASONERS_ALONE

TABLE = {"own": f"{__name__}:Own", "plain": f"{__name__}:Plain"}


class Plain:
    pass


class Own:
    def __init__(
        self,
        checkpoint: Path | None = None,
        device: Literal["cpu", "cuda"] = "cpu",
        *,
        chunk: int = 1,
        scale=0.5,
        note="",
        fast: bool = False,
    ) -> None:
        self.given = (checkpoint, device, chunk, scale, note, fast)


class Breaks:
    def __init__(self, how: str = "raise") -> None:
        if how == "exit":
            raise SystemExit(0)
        raise TypeError("no weights")


DEFAULT = (None, "cpu", 1, 0.5, "", False)


@pytest.mark.parametrize("name", ["own", f"{__name__}:Own"])
@pytest.mark.parametrize(
    ("argument", "given"),
    [
        ("", DEFAULT),
        (":a/b.pt", (Path("a/b.pt"), *DEFAULT[1:])),
        (":a.pt,cuda", (Path("a.pt"), "cuda", *DEFAULT[2:])),
        (":device=cuda, a.pt , chunk=8", (Path("a.pt"), "cuda", 8, *DEFAULT[3:])),
        (":scale=2,note=x=y", (None, "cpu", 1, 2.0, "x=y", False)),
        (":fast", (*DEFAULT[:5], True)),
        (":fast=no", DEFAULT),
        (':"a,b.pt","note=c, d"', (Path("a,b.pt"), "cpu", 1, 0.5, "c, d", False)),
        (":runs/a=b/model.pt", (Path("runs/a=b/model.pt"), *DEFAULT[1:])),
        (":http://host:80/?a=b", (Path("http:/host:80/?a=b"), *DEFAULT[1:])),
    ],
)
def test_arguments_reach_the_parameters_as_their_types(name, argument, given):
    assert registry.make("policy", name + argument, TABLE).given == given


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("own:", "ends at its colon; write 'own'"),
        ("own:a.pt,cuda,more", "cannot place 'more'.*own\\[:CHECKPOINT\\]\\[,cpu|cuda\\]\\[,chunk=NUMBER\\]"),
        ("own:chunk=x", "chunk is 'x'; it is a whole number"),
        ("own:device=tpu", "device is 'tpu'; it is cpu or cuda"),
        ("own:fast=maybe", "fast is 'maybe'; it is yes or no"),
        ("own:chnk=3", "no option 'chnk'; did you mean 'chunk'"),
        ("own:chunk=", "chunk is ''|has no value"),
        ("own:chunk=1,chunk=2", "chunk is given twice"),
        ("plain:x", "'plain' takes no argument, 'x' was given"),
        (f"{__name__}:Breaks", r"cannot be made: TypeError: no weights \(.*test_registry.py, line \d+\)"),
        (f"{__name__}:Breaks:exit", "cannot be made: SystemExit: 0"),
    ],
)
def test_what_does_not_fit_is_one_sentence_with_the_way_to_write_it(text, says):
    with pytest.raises(PolicyError, match=says) as error:
        registry.make("policy", text, TABLE)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("fails:Policy", "module 'fails' cannot be imported: JSONDecodeError: Expecting property name"),
        ("bad_syntax:Policy", "SyntaxError: expected ':' (bad_syntax.py, line 2)"),
        ("imports_notalib:Policy", "'imports_notalib:Policy': imports_notalib.py imports 'notalib', which is not"),
        ("imports_it:Policy", "'imports_it:Policy': imports_notalib.py imports 'notalib', which is not installed in"),
        ("nowhere:Policy", "no module 'nowhere'; is its folder on PYTHONPATH?"),
        ("nowhere.inside:Policy", "no module 'nowhere'; is its folder on PYTHONPATH?"),
        ("nowhere.py:Policy", "no module 'nowhere'; name the module, not its file: PYTHONPATH=. ... nowhere:Policy"),
    ],
)
def test_a_module_that_fails_or_is_missing_is_told_from_one_that_it_imports(tmp_path, monkeypatch, name, says):
    (tmp_path / "fails.py").write_text("import json\njson.loads('{')\n")
    (tmp_path / "bad_syntax.py").write_text("import json\nclass Policy\n")
    (tmp_path / "imports_notalib.py").write_text("import notalib\n")
    (tmp_path / "imports_it.py").write_text("import imports_notalib\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PolicyError, match=re.escape(says)):
        make_policy(name)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("./mine.py", "policy './mine.py' is a file's name; name a class in it: PYTHONPATH=. ... mine:A or mine:B"),
        ("mine", "policy 'mine' is a file's name; name a class in it: PYTHONPATH=. ... mine:A or mine:B"),
        (
            "sub/no_class.py",
            "'sub/no_class.py' is a file's name; name a class in it: PYTHONPATH=sub ... no_class:CLASS",
        ),
        ("./gone.py", "policy './gone.py': there is no such file; your own is written gone:CLASS"),
        ("gone", "unknown policy 'gone' (your own is given as module:attribute); known: "),
    ],
)
def test_a_file_without_its_class_is_answered_with_the_form_to_write(tmp_path, monkeypatch, name, says):
    (tmp_path / "mine.py").write_text("raise SystemExit\nclass A: ...\nclass B: ...\n")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "no_class.py").write_text("x = (\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError, match=re.escape(says)):
        make_policy(name)


def test_a_run_is_identified_by_the_file_of_the_users_own_plug_in(tmp_path):
    class_text = f"{__name__}:WithFile:{tmp_path / 'a.pt'}"
    assert registry.files_of("policy", class_text, {}) == (tmp_path / "a.pt",)
    assert registry.files_of("policy", "plain", TABLE) == ()


def test_a_file_of_that_is_inherited_with_other_arguments_says_nothing():
    assert registry.files_of("policy", f"{__name__}:Bolder:0.5", {}) == ()


class WithFile:
    def __init__(self, weights: Path) -> None: ...

    @classmethod
    def file_of(cls, weights: Path) -> Path:
        return weights


class Bolder(WithFile):
    def __init__(self, limit: float = 0.5) -> None: ...


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("small", "small[:PATH][,stack=NUMBER][,avoid=yes|no]"),
        ("hover", "hover"),
        ("lerobot", "lerobot:FOLDER[,device=cuda|cpu]"),
        (
            "openvla",
            "openvla:FOLDER[,decoder=ar|parallel][,quant=none|int8|int4][,device=cuda|cpu][,unnorm_key=TEXT][,dims=TEXT][,scale=TEXT][,tokenizer=PATH][,stack=NUMBER][,compiled=yes|no]",
        ),
    ],
)
def test_usage_says_how_a_plug_in_is_written(name, written):
    assert registry.usage(name, registry.load("policy", name, POLICIES)) == written


def test_every_plug_in_of_the_package_has_a_usage():
    for kind, table in (("policy", POLICIES), ("reasoner", REASONERS)):
        for name in table:
            assert registry.usage(name, registry.load(kind, name, table)).startswith(name)


CALLED: list[str] = []


def annotated(value: str = "") -> Policy:
    CALLED.append("annotated")
    return make_policy("hover")


def plain_function(value: str = "") -> None:
    CALLED.append("plain")


@pytest.mark.parametrize(
    "name",
    [
        "os:system:touch pwned",
        "os:mkdir:pwned",
        "subprocess:Popen:touch pwned",
        "subprocess:run:touch pwned",
        "shutil:rmtree:.",
        "builtins:exec:open('pwned','w')",
        "builtins:print",
        "pathlib:Path.touch:pwned",
        "cognitivedrone.reasoners.oracle:Oracle",
        f"{__name__}:plain_function:x",
        f"{__name__}:Plain",
    ],
)
@pytest.mark.parametrize("make", [make_policy, policy_files])
def test_what_is_no_policy_is_not_called(name, make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError, match=r"has no|no module") as error:
        make(name)
    assert "\n" not in str(error.value)
    assert not CALLED
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["os:system:touch pwned", "cognitivedrone.policies.baselines:Hover", "time:sleep:9"])
@pytest.mark.parametrize("make", [make_reasoner, reasoner_files])
def test_what_is_no_reasoner_is_not_called(name, make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError, match=r"has no method refine\(\)"):
        make(name)
    assert not list(tmp_path.iterdir())


def test_a_function_that_says_that_it_makes_a_policy_is_called():
    assert type(make_policy(f"{__name__}:annotated")).__name__ == "Hover"
    assert CALLED.pop() == "annotated"


@pytest.mark.parametrize("text", ["small", "hover", "race", "small:stack=2"])
def test_a_file_may_name_what_needs_nothing_else(text):
    registry.check_self_contained("policy", text, POLICIES, SELF_CONTAINED)


@pytest.mark.parametrize(
    "text",
    [
        "os:system:touch pwned", "remote:ws://10.0.0.1:9", "remote", "small:/etc/passwd", "small:path=/etc/passwd",
        "openvla:/tmp", "lerobot:x/y", "mine:Policy", "", "SMALL", " small", "small ", "small:", "none",
    ],
)  # fmt: skip
def test_a_file_may_not_name_code_files_or_servers(text):
    with pytest.raises(PolicyError):
        registry.check_self_contained("policy", text, POLICIES, SELF_CONTAINED)


@pytest.mark.parametrize("text", ["replay:/etc/passwd", "vlm", "vlm:http://10.0.0.1/v1", "remote:ws://10.0.0.1:9"])
def test_a_file_may_not_name_a_reasoner_of_other_places(text):
    with pytest.raises(PolicyError, match="name it yourself with --reasoner"):
        registry.check_self_contained("reasoner", text, REASONERS, REASONERS_ALONE)
    registry.check_self_contained("reasoner", "noisy-oracle:0.8,each", REASONERS, REASONERS_ALONE)
