"""Long runs say on the terminal what they do; elsewhere they are silent."""

import io
import threading

from homogenize.io import save_law
from homogenize.laws.net import diagonal_net
from macro_fem.job import run_scene
from macro_fem.progress import progress_line, silent

SCENE = """
[curtain]
width = 100.0
height = 100.0
areal_mass = 1.0
[mesh]
cells = 4
[support]
kind = "corners"
[load]
steps = 3
edge = {edge = "bottom", force = [0.001, 0.0]}
"""


class Terminal(io.StringIO):
    """A stream that says it is a terminal, and tells when it has been written to."""

    def __init__(self):
        super().__init__()
        self.written = threading.Event()

    def isatty(self):
        return True

    def write(self, text):
        super().write(text)
        if "half-way" in text:
            self.written.set()
        return len(text)


def test_the_line_shows_what_is_done_and_is_erased():
    terminal = Terminal()
    with progress_line(terminal, interval_s=1e-3) as say:
        say("half-way")
        assert terminal.written.wait(60.0)
    assert "half-way, " in terminal.getvalue()
    assert terminal.getvalue().endswith("\r\x1b[K")


def test_a_file_stays_clean():
    file = io.StringIO()
    with progress_line(file, interval_s=1e-3) as say:
        say("half-way")
    assert say is silent
    assert file.getvalue() == ""


def test_a_job_names_its_load_steps(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    save_law(diagonal_net(1.1), tmp_path / "law.json")
    said = []
    run_scene(tmp_path / "scene.toml", tmp_path / "law.json", tmp_path / "out", picture=False, say=said.append)
    assert [text.rpartition(", ")[2] for text in said] == [f"load step {k} of 3" for k in (1, 2, 3)]
    assert all(text.startswith("solving 64 cells") for text in said)
