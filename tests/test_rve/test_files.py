"""Results of several files: old or new or refused by their checksums; nothing is lost that was not written."""

import json
import os
import stat

import pytest

from rve import Cell, InputError, read_table, solve_table, write_table
from rve.common import check_out_file, check_out_job, checksum, job, sidecar_path

OLD = {"a.txt": "old a", "sub/b.txt": "old b", "step_1.vtu": "old step"}
NEW = {"a.txt": "new a", "sub/b.txt": "new b", "c.png": "new c"}


def publish(folder, files, record="summary.json"):
    with job(folder, record, {"says": min(files.values())}) as staged:
        for name, text in files.items():
            (staged / name).parent.mkdir(exist_ok=True)
            (staged / name).write_text(text)


def content(folder):
    """What a user sees: every file that is not hidden, with its text."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file())
    names = {path.relative_to(folder).as_posix(): path for path in found}
    return {name: path.read_text() for name, path in names.items() if not name.startswith(".")}


def hidden(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_files_appear_together_and_the_record_lists_them(tmp_path):
    publish(tmp_path / "out", NEW)
    seen = content(tmp_path / "out")
    record = json.loads(seen.pop("summary.json"))
    assert seen == NEW
    assert record == {"says": "new a", "files": {name: checksum(tmp_path / "out" / name) for name in NEW}}
    assert not hidden(tmp_path / "out")


def test_what_a_new_job_does_not_write_is_removed_unless_it_is_the_user_s(tmp_path):
    publish(tmp_path, OLD | {"edited.vtu": "old"})
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "edited.vtu").write_text("mine too")
    publish(tmp_path, NEW)
    seen = content(tmp_path)
    del seen["summary.json"]
    assert seen == NEW | {"notes.txt": "mine", "edited.vtu": "mine too"}


def test_a_job_that_fails_leaves_nothing(tmp_path):
    def fail(folder):
        with job(folder, "summary.json", {}) as staged:
            (staged / "a.txt").write_text("half")
            raise RuntimeError

    publish(tmp_path / "there", OLD)
    before = content(tmp_path / "there")
    for folder in (tmp_path / "there", tmp_path / "made" / "deep"):
        with pytest.raises(RuntimeError):
            fail(folder)
    assert content(tmp_path / "there") == before
    assert not hidden(tmp_path / "there")
    assert not (tmp_path / "made").exists()


def test_a_record_cannot_make_a_job_remove_files_elsewhere(tmp_path):
    out = tmp_path / "out"
    publish(out, OLD)
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    record = json.loads((out / "summary.json").read_text())
    record["files"] |= {"../victim.txt": checksum(victim), str(victim): checksum(victim)}
    (out / "summary.json").write_text(json.dumps(record))
    publish(out, NEW)
    assert victim.read_text() == "mine"


def test_outputs_that_are_no_files_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    for path, words in (
        ("/dev/null", "device, pipe or socket"),
        (tmp_path / "link", "device, pipe or socket"),
        (tmp_path, "is a folder"),
        (tmp_path / "file" / "x.csv", "Not a directory"),
        (tmp_path / "nowhere" / "x.csv", "No such file"),
    ):
        with pytest.raises(InputError, match=words):
            check_out_file(path)
    for path, words in (
        (tmp_path / "file", "is a file, give a folder"),
        (tmp_path / "file" / "below", "cannot be written: Not a directory"),
    ):
        with pytest.raises(InputError, match=f"--out = {path}: {words}"):
            check_out_job(path, "summary.json")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_outputs_that_are_inputs_by_any_name_are_refused(tmp_path):
    table = tmp_path / "glove.csv"
    for path in (table, tmp_path / "glove.json"):
        path.write_text('{"r1_mm": 5.0, "b_x_mm": 11.0}')
    (tmp_path / "soft").symlink_to(table)
    os.link(table, tmp_path / "hard")
    for name in ("glove.csv", "glove.json", "soft", "hard", "../" + tmp_path.name + "/glove.csv"):
        with pytest.raises(InputError, match="would overwrite"):
            check_out_file(tmp_path / name, inputs=[None, table])
    check_out_file(tmp_path / "law.json", inputs=[table])
    publish(tmp_path / "out", NEW)
    with pytest.raises(InputError, match="would overwrite"):
        check_out_job(tmp_path / "out", "summary.json", inputs=[tmp_path / "out" / "c.png"])


@pytest.fixture
def table():
    return solve_table(Cell(), ([0.0, 10.0], [45.0, 30.0]))


def test_a_table_and_its_sidecar_belong_together(tmp_path, table):
    one, other = tmp_path / "one.csv", tmp_path / "other.csv"
    write_table(table, one)
    sidecar = json.loads(sidecar_path(one).read_text())
    assert sidecar["files"] == {"one.csv": checksum(one)}
    assert read_table(one).cell == table.cell
    assert read_table(one).origin == table.origin
    one.rename(tmp_path / "renamed.csv")
    sidecar_path(one).rename(tmp_path / "renamed.json")
    assert len(read_table(tmp_path / "renamed.csv")) == 2
    write_table(table, one)
    other.write_text(one.read_text().replace("45.0", "46.0"))
    sidecar_path(other).write_bytes(sidecar_path(one).read_bytes())
    with pytest.raises(InputError, match=r'other.csv: does not belong .*other.json.*remove "files" from other.json'):
        read_table(other)
    del sidecar["files"]  # what the sentence says, and what older versions wrote
    sidecar_path(other).write_text(json.dumps(sidecar))
    assert read_table(other).beta_deg[0] == 46.0


def test_a_table_does_not_overwrite_a_law(tmp_path, table):
    (tmp_path / "law.json").write_text('{"schema": 1}')
    with pytest.raises(InputError, match="is not that of a table"):
        write_table(table, tmp_path / "law.csv")
    with pytest.raises(InputError, match="the name of the table's sidecar"):
        write_table(table, tmp_path / "x.json")
    assert [path.name for path in tmp_path.iterdir()] == ["law.json"]
