"""Text files of people, from Windows, Excel and editors: read where they can mean one thing, else one sentence."""

import json
import re
from pathlib import Path

import pytest

from cognitivedrone.errors import CognitiveDroneError, TaskError
from cognitivedrone.files.texts import decoded, folded, load_json
from cognitivedrone.reasoners.prompt import load_prompt
from cognitivedrone.reasoners.replay import read_answers
from cognitivedrone.serving.access import token_of
from cognitivedrone.tasks.format import read_json
from cognitivedrone.tasks.knowledge.tables import read_rows
from cognitivedrone.text.json_text import NotJSON

PLAIN = "concept,colour,note\ncafé,brown,warm\n"
ROWS = [{"concept": "café", "colour": "brown", "note": "warm"}]
SEMICOLON = PLAIN.replace(",", ";")

TABLES: dict[str, bytes] = {
    "UTF-8": PLAIN.encode(),
    "UTF-8 with a mark": PLAIN.encode("utf-8-sig"),
    "UTF-16 with a mark, little-endian": b"\xff\xfe" + PLAIN.encode("utf-16-le"),
    "UTF-16 with a mark, big-endian": b"\xfe\xff" + PLAIN.encode("utf-16-be"),
    "UTF-16 without a mark": PLAIN.encode("utf-16-le"),
    "UTF-16 big-endian without a mark": PLAIN.encode("utf-16-be"),
    "UTF-32 with a mark": PLAIN.encode("utf-32"),
    "Windows": PLAIN.encode("cp1252"),
    "lines of Windows": PLAIN.replace("\n", "\r\n").encode(),
    "semicolons": SEMICOLON.encode(),
    "Excel's Unicode text": b"\xff\xfe" + PLAIN.replace(",", "\t").replace("\n", "\r\n").encode("utf-16-le"),
    "Excel in Germany": SEMICOLON.replace("\n", "\r\n").encode("cp1252"),
    "Excel says so": ("sep=;\r\n" + SEMICOLON).encode(),
    "Excel says so, in quotes": ('"sep=;"\r\n' + SEMICOLON).encode(),
    "capitals": PLAIN.replace("concept,colour", "Concept,COLOUR").encode(),
    "blanks around names": PLAIN.replace("concept,", " concept , ").encode(),
    "a column at the end without anything": b"concept,colour,note,\ncaf\xc3\xa9,brown,warm,\n",
    "many such columns": b"concept;colour;note;;;\r\ncaf\xc3\xa9;brown;warm;;;\r\n;;;;;\r\n",
    "lines with too many separators": b"concept,colour,note\ncaf\xc3\xa9,brown,warm,,\n",
    "an empty column between": b"concept,,colour,note\ncaf\xc3\xa9,,brown,warm\n",
    "quotes everywhere": b'"concept";"colour";"note"\r\n"caf\xc3\xa9";"brown";"warm"\r\n',
}
TASKS: dict[str, bytes] = {
    "UTF-8": b'[{"a": "caf\xc3\xa9"}]',
    "UTF-8 with a mark": '[{"a": "café"}]'.encode("utf-8-sig"),
    "UTF-16": '[{"a": "café"}]'.encode("utf-16"),
    "UTF-16 without a mark": '[{"a": "café"}]'.encode("utf-16-be"),
    "Windows": '[{"a": "café"}]'.encode("cp1252"),
    "a comment": '[ // the first\n{"a": "café"}]'.encode(),
    "a comment at the end": '[{"a": "café"}] // done'.encode(),
    "a long comment": '/* mine,\n * all */ [{"a": /* here */ "café"}]'.encode(),
    "a last comma": '[{"a": "café",},]'.encode(),
    "a last comma and a comment": '[{"a": "café", // it\n}, /* no more */ ]'.encode(),
}
REFUSED: dict[str, tuple[bytes, str]] = {
    "Windows in Russia": ("concept\nкошка\n".encode("cp1251"), "depends on where it was written; save it as UTF-8"),
    "Windows in Greece": ("concept\nγάτα\n".encode("cp1253"), "depends on where it was written; save it as UTF-8"),
    "a letter of one code page": ("concept\ncrème\n".encode("cp1252"), "byte 0xE8 means depends on where"),
    "another letter of another": ("concept\npiñata\n".encode("cp1252"), "byte 0xF1 means depends on where"),
    "DOS": ("concept\ncafé\n".encode("cp850"), "byte 0x82 means depends on where"),
    "DOS, within": ("concept\nböse\n".encode("cp850"), "depends on where it was written"),
    "half a UTF-16 letter": (b"\xff\xfeco\x00", "it begins as UTF-16-LE text, but byte 3 is none"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0", "it holds zero bytes and is no text"),
    "a name twice": (b"concept,Concept\na,b\n", "two columns 'concept'; merge them"),
    "content without a name": (b"concept,\ncat,brown\n", "column 2 has no name"),
}


def written(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("content", TABLES.values(), ids=TABLES)
def test_a_table_is_read_however_it_was_saved(tmp_path, content):
    rows = read_rows(written(tmp_path, "facts.csv", content), ("concept",), spelled=("colour",))
    assert [row.cells for row in rows] == ROWS


@pytest.mark.parametrize("content", TASKS.values(), ids=TASKS)
def test_a_task_file_is_read_however_it_was_saved(tmp_path, content):
    assert read_json(written(tmp_path, "tasks.json", content)) == [{"a": "café"}]


@pytest.mark.parametrize(("content", "says"), REFUSED.values(), ids=REFUSED)
def test_what_could_mean_two_things_is_one_sentence(tmp_path, content, says):
    with pytest.raises(TaskError, match=re.escape(says)) as found:
        read_rows(written(tmp_path, "facts.csv", content), ("concept",))
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("text", ['["http://a/b", "/* no */", ",]", "\\"//", "a,}"]', "[1, 2]", '{"a": {"b": []}}'])
def test_json_with_what_only_resembles_comments_is_itself(text):
    assert load_json(text) == json.loads(text)
    assert load_json(text + " // more") == json.loads(text)


@pytest.mark.parametrize("text", ["[1,,]", "[,]", "[ ,]", "{,}", '["a', "{'a': 1}", "[1] /", '["a //"', ""])
def test_what_is_not_json_stays_so(text):
    with pytest.raises(NotJSON):
        load_json(text)


def test_places_in_errors_are_those_of_the_file(tmp_path):
    with pytest.raises(TaskError, match="line 3 column 3"):
        read_json(written(tmp_path, "tasks.json", b"[ // one\n/* two\n*/b]"))


@pytest.mark.parametrize("part", ['\\"', "/*", ",", ", ", "/", "[ ,"])
@pytest.mark.parametrize("begin", ['"', "[", ""])
def test_no_file_takes_long(begin, part):
    with pytest.raises(ValueError, match=r"."):
        load_json(begin + part * 200_000)


def test_every_file_of_a_persons_is_read_by_it(tmp_path):
    mark = "\ufeff"
    sixteen = "0123456789abcdef"
    token = written(tmp_path, "token", f"{mark}{sixteen}\r\n".encode("utf-16-le"))
    token.chmod(0o600)
    assert token_of("localhost", token) == sixteen
    assert load_prompt(written(tmp_path, "prompt", f"{mark}Say {{instruction}}".encode())) == "Say {instruction}"
    answer = json.dumps({"task": "a", "directive": "fly through the red gate"})
    assert [*read_answers(written(tmp_path, "answers", f"{mark}{answer}\r\n".encode("utf-16-le")))] == ["a"]
    for read in (load_prompt, read_answers):
        with pytest.raises(CognitiveDroneError, match="save it as UTF-8"):
            read(written(tmp_path, "other", "кошка {instruction}".encode("cp1251")))


def test_names_are_compared_composed_without_case_and_blanks():
    assert folded("  Cafe\u0301 ") == folded("CAFÉ") == "café"
    assert folded("Straße") == "strasse"
    assert decoded("20 °C – don’t".encode("cp1252")) == "20 °C – don’t"
