"""Lines for outputs that show no bar."""

import io

from rich.console import Console

from rfpp.progress import counting, progress_bars
from rfpp.progress_lines import ProgressLines


def lines_of(steps, **how) -> list[str]:
    """What is said of work of which so much is done at these times."""
    said, now = [], [0.0]
    lines = ProgressLines("steps", said.append, clock=lambda: now[0], **how)
    for seconds, done in steps:
        now[0] = seconds
        lines(done, 650)
    return said


def test_the_first_line_comes_early_and_says_how_long_it_takes():
    said = lines_of((2.0 * step, step) for step in range(12))
    assert said == ["steps 10 of 650, 0.5 a second, about 0:21:20 left"]


def test_then_one_a_minute():
    assert len(lines_of((2.0 * step, step) for step in range(132))) == 5


def test_what_was_done_before_does_not_count_as_speed():
    said = lines_of([(0.0, 600), (5.0, 610)])
    assert said == ["steps 610 of 650, 2 a second, about 0:00:20 left"]


def test_at_the_end_there_is_nothing_left_to_say():
    assert lines_of([(0.0, 0), (100.0, 650)]) == []


def test_files_get_lines_and_terminals_a_bar():
    for terminal in (False, True):
        output = io.StringIO()
        console = Console(file=output, force_terminal=terminal, width=100)
        with counting(console, "images") as (show, _):
            for done in range(13):
                show(done, 20)
        assert ("images 10 of 20" in output.getvalue()) != terminal


def test_stages_of_one_work_have_lines_of_their_own():
    output = io.StringIO()
    with progress_bars(Console(file=output, width=200)) as bar:
        for name in ("test, model", "test, baselines"):
            count = bar(name, 32)
            for _ in range(32):
                count()
    assert "test, model: 10 of 32, " in output.getvalue()
    assert "test, baselines: 10 of 32, " in output.getvalue()
